"""Every command of README.md, of the tutorials and of the how-to pages runs, smaller.

The tables say with what sizes: that of README.md here, the others in page_tables.py.  All run in
one folder, so that a page may use what an earlier one made.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.project import page_tables, readme_steps
from tests.project.page_tables import SMALL
from tests.project.readme_steps import Elsewhere, How, NotRun, Run, Step
from tests.project_files import ROOT

# README command -> how it is run here, in README order.
TABLE: dict[str, How] = {
    "make demo": Run(
        (*SMALL, "scenes.frames_per_location=2", "dataset.dir={sandbox}/outputs/demo")
    ),
    ".venv/bin/simnfnd denoise examples/didson/lamprey.avi --out outputs/lamprey --compare": Run(
        instead=((".venv/bin/", ""),)
    ),
}
PAGES: dict[str, dict[str, How]] = {"README.md": TABLE, **page_tables.PAGES}
STEPS = {
    page: readme_steps.steps((ROOT / page).read_text(encoding="utf-8"), page) for page in PAGES
}

TIMEOUT_S = 300.0


@pytest.mark.parametrize("page", PAGES)
def test_page_and_table_agree(page: str) -> None:
    assert STEPS[page], f"{page} tells nobody what to do: no ```sh block"
    assert readme_steps.untold(STEPS[page], PAGES[page]) == []


def test_every_tutorial_and_how_to_page_is_run() -> None:
    folders = [ROOT / "docs" / name for name in ("tutorials", "how-to")]
    pages = {file.relative_to(ROOT).as_posix() for folder in folders for file in folder.iterdir()}
    assert pages - {"docs/tutorials/index.md"} == set(PAGES) - {"README.md"}


@pytest.mark.parametrize("page", PAGES)
def test_no_block_hides_commands(page: str) -> None:
    blocks = readme_steps.fences((ROOT / page).read_text(encoding="utf-8"))
    assert {language for language, _, _ in blocks} <= readme_steps.LANGUAGES


@pytest.mark.parametrize("page", PAGES)
def test_every_command_says_how_long_it_takes(page: str) -> None:
    silent = [
        f"{page}:{step.line}: {step.key}"
        for step in STEPS[page]
        if step.kind == "sh" and not step.time_s and isinstance(PAGES[page][step.key], Run)
    ]
    assert silent == []


def test_steps_run_elsewhere_really_are() -> None:
    for table in PAGES.values():
        for key, how in table.items():
            if isinstance(how, Elsewhere):
                text = (ROOT / how.file).read_text(encoding="utf-8")
                assert how.text in text, f"`{key}`: {how.file} has no `{how.text}`"


@pytest.fixture(scope="module")
def sandbox(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("readme")
    page_tables.small_recording(folder / "examples" / "didson" / "lamprey.avi")
    mdd = readme_steps.SHARED / "data" / "mdd"
    if mdd.is_dir():
        # Two of its pictures.
        for name in ("Images", "Masks"):
            (folder / "mdd" / name).mkdir(parents=True)
            for file in sorted((mdd / name).iterdir())[:2]:
                shutil.copy(file, folder / "mdd" / name)
        shutil.copy(mdd / "fan_geometry.csv", folder / "mdd")
    return folder


def how_to_run(step: Step) -> How:
    otherwise = Run() if step.kind == "python" else NotRun("not in the table")
    return PAGES[step.page].get(step.key, otherwise)


# The others are answered for by the tests above, and are no test that passes here.
RUN_HERE = [
    (step, how)
    for page in PAGES
    for step in STEPS[page]
    if isinstance(how := how_to_run(step), Run)
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "how"), RUN_HERE, ids=[f"{Path(step.page).stem}-{step.line}" for step, _ in RUN_HERE]
)
def test_step_runs(step: Step, how: Run, sandbox: Path) -> None:
    if lacking := readme_steps.missing(how, sandbox):
        pytest.skip(f"needs {lacking}")
    done = readme_steps.run(step, how, sandbox, TIMEOUT_S)
    assert done.returncode == 0, f"{step.page}:{step.line}: {step.text}\n{done.stdout[-4000:]}"


# The machinery above, on a text of our own.

SAMPLE = """# Title
```sh
make setup            # once, 2 min
# a comment
echo one \\
    two
```
words
  ```python
  import sys

  print(sys.argv)
  ```
```text
not a command
```
```sh
cat there.txt
```
"""


def test_steps_are_found_in_order() -> None:
    found = readme_steps.steps(SAMPLE)
    assert [(step.kind, step.key, step.line) for step in found] == [
        ("sh", "make setup", 3),
        ("sh", "echo one two", 5),
        ("python", "import sys", 10),
        ("sh", "cat there.txt", 18),
    ]
    assert [step.time_s for step in found] == [120, None, None, None]
    assert found[2].text == "import sys\n\nprint(sys.argv)"


@pytest.mark.parametrize(
    ("text", "said"),
    [("```sh\nls\n", "never closed"), ("```sh\nls \\\n```\n", "goes on after")],
)
def test_broken_blocks_are_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        readme_steps.steps(text)


def test_table_and_text_must_agree() -> None:
    found = readme_steps.steps(SAMPLE)
    table: dict[str, How] = {
        "make setup": Elsewhere(".ci/run", "make setup"),
        "echo one two": Run(),
        "gone": NotRun("an example"),
    }
    said = readme_steps.untold(found, table)
    assert len(said) == 2
    assert "README.md:18: `cat there.txt`" in said[0]
    assert "`gone`" in said[1]


def test_a_step_runs_in_the_sandbox(tmp_path: Path) -> None:
    write = Step("sh", "echo big > out.txt", 1)
    how = Run(instead=(("big", "small"),))
    assert readme_steps.run(write, how, tmp_path, 30).returncode == 0
    assert (tmp_path / "out.txt").read_text(encoding="utf-8") == "small\n"
    read = Step("python", "print(open('out.txt').read())", 2)
    assert "small" in readme_steps.run(read, Run(), tmp_path, 30).stdout


def test_a_failing_step_is_seen(tmp_path: Path) -> None:
    assert readme_steps.run(Step("sh", "false | cat", 1), Run(), tmp_path, 30).returncode == 1
    with pytest.raises(ValueError, match="which is not there"):
        readme_steps.command(Step("sh", "ls", 7), Run(instead=(("x", "y"),)), tmp_path)


def test_make_gets_its_arguments_and_this_environment(tmp_path: Path) -> None:
    words = readme_steps.command(
        Step("sh", "make demo", 1), Run(("dataset.dir={sandbox}/demo", "frames=2")), tmp_path
    )
    assert words[0] == "make"
    assert words[-1] == f"ARGS=dataset.dir={tmp_path}/demo frames=2"
    assert "demo" in words
    assert not any("pip" in word for word in words)


def test_what_a_step_needs(tmp_path: Path) -> None:
    assert readme_steps.missing(Run(needs="{sandbox}/no"), tmp_path) == f"{tmp_path}/no"
    assert readme_steps.missing(Run(needs="{root}/pyproject.toml"), tmp_path) is None
