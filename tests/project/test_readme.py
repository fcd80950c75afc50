"""Every command of README.md, of the tutorials and of the how-to pages runs, smaller.

The tables say with what sizes: that of README.md here, the others in page_tables.py.  All run in
one folder, so that a page may use what an earlier one made: README.md as its reader runs it, the
others in this process.
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
def test_step_runs(step: Step, how: Run, sandbox: Path, capfd) -> None:
    if lacking := readme_steps.missing(how, sandbox):
        pytest.skip(f"needs {lacking}")
    if step.page == "README.md":
        done = readme_steps.run(step, how, sandbox, TIMEOUT_S)
        code, said = done.returncode, done.stdout
    else:
        code, said = readme_steps.here(step, how, sandbox), "".join(capfd.readouterr())
    assert code == 0, f"{step.page}:{step.line}: {step.text}\n{said[-4000:]}"
