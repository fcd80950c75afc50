"""Every command of README.md, of the tutorials and of the how-to pages runs, smaller.

All run in one folder, so that a page may use what an earlier one made: README.md as its reader runs
it, the others in this process.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from tests.project.page_steps import PAGES, SMALL_SEABED, Step, fences, run, steps
from tests.project_files import ROOT

SHARED = ROOT.parent / "shared" / "data"
# Run by .ci/run, or by `make demo` of README.md, or by nobody but who installs.
NOT_HERE = ("make setup", "make test", "simnfnd demo", ". .venv/bin/activate", "pip install")
STEPS = {page: steps(page) for page in PAGES}
# A command that several pages have runs once.
RUN_HERE = {
    step.text.removeprefix(".venv/bin/"): step
    for page in reversed(PAGES)
    for step in reversed(STEPS[page])
    if not step.text.startswith(NOT_HERE)
}
IN_ORDER = sorted(RUN_HERE.values(), key=lambda step: (PAGES.index(step.page), step.line))
NAMES = [page.relative_to(ROOT).as_posix() for page in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_no_command_hides_and_each_says_how_long_it_takes(page: Path) -> None:
    assert {language for language, _, _ in fences(page)} <= {"sh", "python", "text", "yaml"}
    silent = [one.text for one in STEPS[page] if one.kind == "sh" and not one.time_s]
    assert [text for text in silent if not text.startswith(NOT_HERE)] == []


def test_what_runs_elsewhere_really_does() -> None:
    ci = (ROOT / ".ci/run").read_text(encoding="utf-8")
    assert all(line in ci for line in ("make setup", "make test"))
    assert "/bin/simnfnd demo $(ARGS)" in (ROOT / "Makefile").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the examples, a third of the recording's size, and two frames of what lies elsewhere."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "examples/didson").mkdir(parents=True)
    for script in (ROOT / "examples").glob("*.py"):
        (folder / "examples" / script.name).symlink_to(script)
    video = cv2.VideoCapture(str(ROOT / "examples/didson/lamprey.avi"))
    frames = []
    while (found := video.read())[0]:
        frames.append(cv2.resize(found[1], None, fx=0.3, fy=0.3, interpolation=cv2.INTER_AREA))
    codec, size = cv2.VideoWriter.fourcc(*"FFV1"), frames[0].shape[1::-1]
    out = cv2.VideoWriter(str(folder / "examples/didson/lamprey.avi"), codec, 10, size)
    for frame in frames:
        out.write(frame)
    out.release()
    if (SHARED / "flsea-vi").is_dir():
        (folder / "flsea-vi").symlink_to(SHARED / "flsea-vi")
    if (mdd := SHARED / "mdd").is_dir():
        for name in ("Images", "Masks"):
            (folder / "mdd" / name).mkdir(parents=True)
            for file in sorted((mdd / name).iterdir())[:2]:
                shutil.copy(file, folder / "mdd" / name)
        shutil.copy(mdd / "fan_geometry.csv", folder / "mdd")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("step", IN_ORDER, ids=[f"{one.page.stem}-{one.line}" for one in IN_ORDER])
def test_step_runs(step: Step, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name in ("flsea-vi", "mdd"):
        if name in step.text and not (folder / name).exists():
            pytest.skip(f"needs {name}")
    if step.page.name == "README.md" and step.kind == "sh":
        code, said = as_the_reader(step, folder)
    else:
        code, said = run(step, folder), "".join(capfd.readouterr())
    assert code == 0, f"{step.page}:{step.line}: {step.text}\n{said[-4000:]}"


def test_both_profiles_of_the_demo_show_the_same_frames(folder: Path) -> None:
    """README.md has made it."""
    tables = []
    for name in ("demo", "demo-physical"):
        with h5py.File(folder / "outputs" / name / "train/shard-00000.h5") as shard:
            tables.append(shard["meta"]["scene", "frame"])
    np.testing.assert_array_equal(*tables)
    # Frames below each other, both profiles of a frame in one row.
    rows, columns, _ = cv2.imread(str(folder / "outputs/demo-profiles.png")).shape
    assert columns > rows > 500


def as_the_reader(step: Step, folder: Path) -> tuple[int, str]:
    """Exit code and output of a command of README.md in a process of its own."""
    command, prefix = step.text.split(), Path(sys.prefix)
    if command[0] == "make":
        small = (
            *SMALL_SEABED,
            "scenes.frames_per_location=2",
            f"dataset.dir={folder}/outputs/demo",
        )
        command += ["-C", str(ROOT), f"VENV={prefix}", f"ARGS={' '.join(small)}"]
        # The environment that runs this test is the one to use: -o keeps make from renewing it.
        for name in ("core", "installed"):
            command += ["-o", str(prefix / f".simnfnd-{name}")]
    else:
        command[0] = str(prefix / "bin" / Path(command[0]).name)
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout
