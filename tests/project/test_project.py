"""Rules, declarations, benchmarks and the scripts of `make setup`: what a checkout must hold."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from benchmarks import __main__ as benchmarks
from benchmarks.shared import Options
from simnfnd import __version__
from tests.project_files import ROOT, files, module_name, modules, project
from tools.release_check import problems

# Slow or heavy to import: only inside the function that needs them.
HEAVY = (
    "bpy", "open3d", "torch", "matplotlib", "pyarrow", "webdataset",
    "huggingface_hub", "rosbags",
)  # fmt: skip


def requirements() -> list[Requirement]:
    declared = project()["project"]
    lists = [declared["dependencies"], *declared["optional-dependencies"].values()]
    actual = [Requirement(line) for lines in lists for line in lines]
    return [
        requirement for requirement in actual if requirement.name != declared["name"]
    ]  # an extra made of extras


@cache
def pins() -> dict[str, Version]:
    actual: dict[str, Version] = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            pin = Requirement(line)
            (only,) = pin.specifier
            assert only.operator == "==", line
            actual[canonicalize_name(pin.name)] = Version(only.version)
    return actual


def test_every_dependency_is_pinned_within_its_bounds() -> None:
    for requirement in requirements():
        pinned = pins().get(canonicalize_name(requirement.name))
        assert pinned is not None, f"constraints.txt has no {requirement.name}"
        assert requirement.specifier.contains(pinned), requirement


def test_everything_that_the_dependencies_need_is_pinned() -> None:
    # CUDA builds of torch need libraries that the CPU build of the list does not.
    cuda = ("nvidia-", "cuda-", "triton")
    waiting = [
        requirement
        for requirement in requirements()
        if requirement.marker is None or requirement.marker.evaluate()
    ]
    observed: set[tuple[str, str]] = set()
    loose = set()
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name.startswith(cuda):
            continue
        if name not in pins():
            loose.add(name)
        for extra in {"", *requirement.extras} - {
            extra for done, extra in observed if done == name
        }:
            observed.add((name, extra))
            try:
                lines = metadata.requires(name) or []
            except metadata.PackageNotFoundError:
                continue  # an extra that is not installed here
            needed = [Requirement(line) for line in lines]
            waiting += [r for r in needed if not r.marker or r.marker.evaluate({"extra": extra})]
    assert not loose, f"constraints.txt lacks {sorted(loose)}: run `make constraints`"


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    # Assembled, so that this file does not hold what it forbids.
    places = "|".join(("work", "root", "tmp", "home", "opt", "Users", "mnt"))
    pattern = re.compile(rf"(?<![\w/.~}}\]-])/(?:{places})/[\w.-]")
    actual = []
    for path in files():
        try:
            text = (ROOT / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        actual += [
            f"{path}:{number}: {line.strip()[:80]}"
            for number, line in enumerate(text.splitlines(), start=1)
            if pattern.search(line)
        ]
    assert actual == []


@pytest.mark.slow
def test_no_module_of_the_factory_imports_anything_heavy() -> None:
    names = [module_name(path) for path in modules("factory")]
    code = (
        "import importlib, sys\n"
        f"for name in {names!r}:\n"
        "    importlib.import_module(name)\n"
        f"    heavy = [h for h in {HEAVY!r} if h in sys.modules]\n"
        "    if heavy:\n"
        "        sys.exit(f'{name} imports {heavy} at module level')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr.strip()


# --- a release ----------------------------------------------------------------------------------


def test_citation_and_changelog_know_the_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert citation["license"] == project()["project"]["license"]
    (paper,) = citation["references"]
    assert paper["doi"] == "10.3390/rs16152815"
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    first = re.findall(r"^## (.+)$", changelog, flags=re.MULTILINE)[0]
    assert first == "Unreleased" or first.startswith(f"{__version__}, ")


def test_the_image_has_what_the_wheels_load_and_the_install_reads() -> None:
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    script = (ROOT / "tools" / "debian_packages.sh").read_text(encoding="utf-8")
    for name in ("for_bpy", "for_open3d"):
        (packages,) = re.findall(rf"^{name}=\((.+)\)$", script, flags=re.MULTILINE)
        assert set(packages.split()) <= set(text.split())
    copied = {
        word for line in re.findall(r"^COPY (.+)$", text, re.MULTILINE) for word in line.split()
    }
    links = {path.name for path in (ROOT / "simnfnd").iterdir() if path.is_symlink()}
    wanted = {"pyproject.toml", "setup.py", "constraints.txt", "simnfnd", *links}
    wanted |= {project()["project"]["readme"], *project()["project"]["license-files"]}
    assert wanted <= copied
    assert 'ENTRYPOINT ["simnfnd"]' in text
    assert 'CMD ["demo"]' in text


def test_what_is_not_ready_is_named(tmp_path: Path) -> None:
    texts = {
        "factory/__init__.py": '__version__ = "1.2.3"\n',
        "CITATION.cff": "version: 1.2.3\ndate-released: 2026-01-02\n",
        "CHANGELOG.md": "# Log\n\n## Unreleased\n\n## 1.2.3, 2026-01-02\n\nNew.\n",
    }
    (tmp_path / "factory").mkdir()
    for name, text in texts.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    who = ["-c", "user.name=T", "-c", "user.email=t@t"]
    for words in (["init", "--quiet"], ["add", "."], [*who, "commit", "--quiet", "-m", "All"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    assert list(problems(tmp_path)) == [], "it is ready"
    for file, old, new, said in (
        ("CITATION.cff", "version: 1.2.3", "version: 1.2.2", "version is 1.2.2"),
        ("CHANGELOG.md", "## 1.2.3, 2026-01-02", "## 1.2.3", "no heading"),
        ("CHANGELOG.md", "## Unreleased\n", "## Unreleased\n\n- One.\n", "under Unreleased"),
    ):
        (tmp_path / file).write_text(texts[file].replace(old, new, 1), encoding="utf-8")
        actual = list(problems(tmp_path))
        assert any(said in line for line in actual)
        assert any("not committed" in line for line in actual)
        (tmp_path / file).write_text(texts[file], encoding="utf-8")


# --- the scripts of `make setup`, on machines made of fake commands -------------------------------

BASH = shutil.which("bash") or "bash"
LIBRARIES = [
    *("libx11-6", "libxrender1", "libxfixes3", "libxi6", "libxkbcommon0", "libsm6", "libgl1"),
    *("libegl1", "libusb-1.0-0"),
]
COMMANDS = {
    "apt-get": 'echo "apt-get $*" >> "${0%/*}/log"',
    "python3.11": f'exec "{sys.executable}" "$@"',
}


def run(
    folder: Path, commands: dict[str, str], script: str, *words: str
) -> subprocess.CompletedProcess[str]:
    """Run a script of tools; `commands`, as name -> shell body, are all that is on its PATH."""
    for tool in ("dirname", "grep", "bash", "cat"):
        if not (folder / tool).exists():
            (folder / tool).symlink_to(shutil.which(tool) or tool)
    for name, body in commands.items():
        (folder / name).write_text(f"#!{BASH}\n{body}\n", encoding="utf-8")
        (folder / name).chmod(0o755)
    return subprocess.run(
        [BASH, str(ROOT / "tools" / script), *words],
        env={"PATH": str(folder), "VENV": str(folder / "no-venv")},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_without_root_the_exact_line_is_printed(tmp_path: Path) -> None:
    present = " ".join(name for name in LIBRARIES if name not in ("libgl1", "libusb-1.0-0"))
    # The last argument is the name asked for.
    query = (
        f'for p in {present}; do [[ ${{@: -1}} == "$p" ]] && echo installed && exit; done; exit 1'
    )
    commands = {**COMMANDS, "dpkg-query": query, "id": "echo 1000"}
    said = run(tmp_path, commands, "debian_packages.sh")
    assert said.returncode == 2
    line = "    sudo apt-get install -y --no-install-recommends libgl1 libusb-1.0-0"
    assert said.stderr.splitlines()[1] == line
    assert not (tmp_path / "log").exists()


def test_root_installs_after_an_update(tmp_path: Path) -> None:
    commands = {**COMMANDS, "dpkg-query": "exit 1", "id": "echo 0"}
    assert run(tmp_path, commands, "debian_packages.sh").returncode == 0
    assert run(tmp_path, commands, "debian_packages.sh", "tests").returncode == 0
    update, install, _, more = (tmp_path / "log").read_text(encoding="utf-8").splitlines()
    assert update.startswith("apt-get update")
    assert install.split()[-len(LIBRARIES) :] == LIBRARIES
    assert "chromium" not in install
    assert "chromium" in more, "for the test of the report"


def test_no_python_311_is_one_clear_line(tmp_path: Path) -> None:
    said = run(tmp_path, {"python3": "exit 1"}, "find_python.sh")
    assert (said.returncode, said.stderr.count("\n")) == (2, 1)
    assert "PYTHON311=" in said.stderr


# --- `python -m benchmarks` finds, runs and reports; one that fails is not hidden ----------------

GOOD = """
from benchmarks.shared import Section, Table
def measure(options):
    rows = (("theirs", 1.0, 20.123456), ("ours | fast", 123.456, 0.16))
    return Section((Table(("pair", "times less", "CPU s"), rows, f"quick: {options.quick}"),))
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of benchmarks, of which two fail, in the working directory."""
    package = tmp_path / "measured"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "bench_good.py").write_text(GOOD, encoding="utf-8")
    (package / "bench_bad.py").write_text("def measure(options): 1 / 0\n", encoding="utf-8")
    (package / "bench_wrong.py").write_text(
        "from benchmarks.shared import Section\n"
        "def measure(options): return Section(failed='one shard differs')\n",
        encoding="utf-8",
    )
    (package / "helper.py").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    find = benchmarks.discover
    monkeypatch.setattr(benchmarks, "discover", lambda: find(package))
    return tmp_path


def test_all_run_and_the_failed_ones_are_named(
    folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert benchmarks.main([]) == 1
    printed = capfd.readouterr()
    assert printed.out.index("## bad") < printed.out.index("## good")
    assert printed.err.splitlines()[-1] == "error: failed: bad, wrong"
    text = (folder / "outputs/benchmarks/report.md").read_text()
    assert "**Failed: ended with exit code 1**" in text
    assert "**Failed: one shard differs**" in text
    assert "| ours \\| fast | 123 | 0.16 |" in text
    document = json.loads((folder / "outputs/benchmarks/report.json").read_text())
    assert document["sections"]["good"]["tables"][0]["rows"][0] == ["theirs", 1.0, 20.123456]


@pytest.mark.slow
def test_quick_runs() -> None:
    assert {"command", "denoise", "stages"} <= set(benchmarks.discover())
    section = benchmarks.run("stages", Options(quick=True))
    assert section.failed == ""
    assert all(table.rows for table in section.tables)
