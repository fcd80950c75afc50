"""Rules that a machine can check, and the declarations that an install and a release need."""

from __future__ import annotations

import re
import subprocess
import sys
from functools import cache
from importlib import metadata
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from simnfnd import __version__
from tests.project_files import ROOT, files, module_name, modules, project
from tools.release_check import problems

# Slow or heavy to import: only inside the function that needs them.
HEAVY = (
    "bpy", "open3d", "torch", "matplotlib", "hdf5plugin", "pyarrow", "webdataset",
    "huggingface_hub", "rosbags",
)  # fmt: skip


def requirements() -> list[Requirement]:
    declared = project()["project"]
    lists = [declared["dependencies"], *declared["optional-dependencies"].values()]
    found = [Requirement(line) for lines in lists for line in lines]
    return [one for one in found if one.name != declared["name"]]  # an extra made of extras


@cache
def pins() -> dict[str, Version]:
    found: dict[str, Version] = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            pin = Requirement(line)
            (only,) = pin.specifier
            assert only.operator == "==", line
            found[canonicalize_name(pin.name)] = Version(only.version)
    return found


def test_every_dependency_is_pinned_within_its_bounds() -> None:
    for one in requirements():
        pinned = pins().get(canonicalize_name(one.name))
        assert pinned is not None, f"constraints.txt has no {one.name}"
        assert one.specifier.contains(pinned), one


def test_everything_that_the_dependencies_need_is_pinned() -> None:
    # CUDA builds of torch need libraries that the CPU build of the list does not.
    cuda = ("nvidia-", "cuda-", "triton")
    waiting = [one for one in requirements() if one.marker is None or one.marker.evaluate()]
    seen: set[tuple[str, str]] = set()
    loose = set()
    while waiting:
        one = waiting.pop()
        name = canonicalize_name(one.name)
        if name.startswith(cuda):
            continue
        if name not in pins():
            loose.add(name)
        for extra in {"", *one.extras} - {extra for done, extra in seen if done == name}:
            seen.add((name, extra))
            try:
                lines = metadata.requires(name) or []
            except metadata.PackageNotFoundError:
                continue  # an extra that is not installed here
            needed = [Requirement(line) for line in lines]
            waiting += [r for r in needed if not r.marker or r.marker.evaluate({"extra": extra})]
    assert not loose, f"constraints.txt lacks {sorted(loose)}: run `make constraints`"


def test_the_two_versions_that_may_not_move() -> None:
    text = (ROOT / "constraints.txt").read_text(encoding="utf-8")
    assert "+" not in "".join(line for line in text.splitlines() if not line.startswith("#"))
    # The one that the index of the tests has as a CPU build: any other one brings gigabytes of
    # CUDA libraries.
    assert pins()["torch"] == Version("2.13.0"), "no CPU build of another torch is at hand"
    assert pins()["numpy"] < Version("2"), "bpy cannot load numpy 2"


def test_no_file_names_a_place_on_somebodys_machine() -> None:
    # Assembled, so that this file does not hold what it forbids.
    places = "|".join(("work", "root", "tmp", "home", "opt", "Users", "mnt"))
    pattern = re.compile(rf"(?<![\w/.~}}\]-])/(?:{places})/[\w.-]")
    found = []
    for path in files():
        try:
            text = (ROOT / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        found += [
            f"{path}:{number}: {line.strip()[:80]}"
            for number, line in enumerate(text.splitlines(), start=1)
            if pattern.search(line)
        ]
    assert found == []


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


def test_an_experiment_begins_with_the_command_that_runs_it() -> None:
    for path in (one for one in files() if one.match("conf/experiment/*.yaml")):
        lines = (ROOT / path).read_text(encoding="utf-8").splitlines()
        # Hydra's own header may stand first.
        first = next(line for line in lines if not line.startswith("# @"))
        pattern = rf"# simnfnd (make|train) .*\bexperiment=\S*\b{path.stem}\b"
        assert re.match(pattern, first), (path, first)


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
    wanted = {"pyproject.toml", "constraints.txt", "simnfnd", *links}
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
        found = list(problems(tmp_path))
        assert any(said in line for line in found)
        assert any("not committed" in line for line in found)
        (tmp_path / file).write_text(texts[file], encoding="utf-8")
