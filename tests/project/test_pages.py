"""Every command of README.md, of the tutorials, of the how-to pages, and of --help runs, smaller.

All run in one folder, so that a page may use what an earlier one made: README.md as its reader runs
it, the others in this process.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.verbs import VERBS
from tests.factory.production.cli_frames import ground, write_frame
from tests.project.page_steps import PAGES, SMALL_SEABED, Step, run, steps
from tests.project_files import ROOT

SHARED = ROOT.parent / "shared" / "data"
# Run by .ci/run, or by `make demo` of README.md, or by users who install it.
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With the examples, some of the recording at a third of its size, and two frames of others."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "examples/didson").mkdir(parents=True)
    for script in (ROOT / "examples").glob("*.py"):
        (folder / "examples" / script.name).symlink_to(script)
    video = cv2.VideoCapture(str(ROOT / "examples/didson/lamprey.avi"))
    frames: list[np.ndarray] = []
    while len(frames) < 10 and (actual := video.read())[0]:
        frames.append(cv2.resize(actual[1], None, fx=0.3, fy=0.3, interpolation=cv2.INTER_AREA))
    codec = cv2.VideoWriter.fourcc(*"FFV1")
    size = frames[0].shape[1::-1]
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
@pytest.mark.parametrize(
    "step", IN_ORDER, ids=[f"{step.page.stem}-{step.line}" for step in IN_ORDER]
)
def test_step_runs(step: Step, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name in ("flsea-vi", "mdd"):
        if name in step.text and not (folder / name).exists():
            pytest.skip(f"needs {name}")
    if step.page.name == "README.md" and step.kind == "sh":
        code, said = as_the_reader(step, folder)
    else:
        code = run(step, folder)
        said = "".join(capfd.readouterr())
    assert code == 0, f"{step.page}:{step.line}: {step.text}\n{said[-4000:]}"


@pytest.mark.slow
def test_both_profiles_of_the_demo_show_the_same_frames(folder: Path) -> None:
    """README.md has made it."""
    tables = []
    for name in ("demo", "demo-physical"):
        with h5py.File(folder / "outputs" / name / "train/shard-00000.h5") as shard:
            tables.append(shard["meta"]["scene", "frame"])
    np.testing.assert_array_equal(*tables)
    # A row a profile, a column a frame.
    rows, columns, _ = cv2.imread(str(folder / "outputs/demo-profiles.png")).shape
    assert columns > rows > 500


def as_the_reader(step: Step, folder: Path) -> tuple[int, str]:
    """Exit code and output of a command of README.md in a process of its own."""
    command = step.text.split()
    prefix = Path(sys.prefix)
    if command[0] == "make":
        small = f"scenes.frames_per_location=2 dataset.dir={folder}/outputs/demo"
        command += ["-C", str(ROOT), f"VENV={prefix}", f"ARGS={' '.join(SMALL_SEABED)} {small}"]
        # The environment that runs this test is the one to use: -o keeps make from renewing it.
        for name in ("core", "installed"):
            command += ["-o", str(prefix / f".simnfnd-{name}")]
    else:
        command[0] = str(prefix / "bin" / Path(command[0]).name)
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    return done.returncode, done.stdout


# --- every example of every --help: the cheap ones really, the others until they start -----------

QUICK = ("render=analytic", "scheduler=serial", "dataset.preview_pairs=0", "frames.total=2")
# What an example of a verb that really runs is made small with.
REAL: dict[str, tuple[str, ...]] = {
    "demo": (*QUICK, *SMALL_SEABED),
    **dict.fromkeys(("make", "plan", "cache pack"), QUICK),
    **dict.fromkeys(("cache stats", "status", "inspect"), ()),
    **dict.fromkeys(("validate", "merge", "preview", "export"), ()),
    "stream": ("--count", "2"),
}
ABSENT = ("dive.aris", "simnfnd view", "examples/platform.csv")
# Take long, and have tests of their own; or a page has them, too, whose test runs them.
LONG = ("export-weights simnfnd", "evaluate paper", "make -m noise.background.density=0.1,0.5")
ELSEWHERE = {"simnfnd demo", *(example.text for page in PAGES for example in STEPS[page])}


ALL = [
    example
    for example in dict.fromkeys(example for verb in VERBS.values() for example in verb.examples)
    if not any(part in example for part in LONG)
    and (example not in ELSEWHERE or "flsea" in example)
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the examples read."""
    folder = tmp_path_factory.mktemp("examples")
    for number in range(2):
        write_frame(folder / "flsea-vi", f"1623304454176560{number}", ground())
        write_frame(folder / "flsea-vi", f"1623304454176560{number}", ground(), "red_sea/sub_pier")
        write_frame(folder / "dive", f"1623304454176560{number}", ground(480, 640), "a/b")
    images = folder / "dive/a/b"
    listed = [
        f"{images}/imgs/1623304454176560{n}.tiff,"
        f"{images}/depth/1623304454176560{n}_SeaErra_abs_depth.tif"
        for n in range(2)
    ]
    (folder / "frames.csv").write_text("\n".join(listed) + "\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "argv", ["simnfnd"])
        demo = ("experiment=demo", *QUICK, *SMALL_SEABED)
        for name, first in (("a", 0), ("b", 7)):
            words = (*demo, f"scenes.first_location={first}", f"dataset.dir=outputs/{name}")
            assert main(["make", *words]) == 0
        shutil.copytree("outputs/a", "outputs/demo")
        labelled = (*demo, "dataset.layers=[segmentation]", "dataset.dir=outputs/labelled")
        assert main(["make", *labelled]) == 0
        assert main(["cache", "pack", *demo, "--out", "views.pack"]) == 0
    return folder


def run_example(example: str, *more: str) -> int:
    words = shlex.split(example)[1:]
    if "seabed" in example or "scenes" not in example or "experiment=demo" in example:
        own = {word.partition("=")[0] for word in words}
        more = (
            *more,
            *(word for word in SMALL_SEABED if more and word.partition("=")[0] not in own),
        )
    try:
        return main([*words, *more])
    except SystemExit as ended:
        return int(ended.code or 0)


@pytest.mark.slow
@pytest.mark.parametrize("example", ALL)
def test_an_example_of_a_help_does_what_it_says(
    example: str, place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd
) -> None:
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    said = shlex.split(example)
    verb = " ".join(said[1:3]) if said[1] == "cache" else said[1]
    if verb in REAL and not any(part in example for part in ABSENT):
        monkeypatch.chdir(place)
        # Words after `--cfg job` would be another option's.
        code = run_example(example, *(() if "--cfg" in example else REAL[verb]))
        message = capfd.readouterr()
        assert code == 0, message.err
    else:
        # Nothing of what it reads is here: one line says so, and no word of it is unknown.
        monkeypatch.chdir(tmp_path)
        code = run_example(example)
        message = capfd.readouterr()
        assert code == 2, message.err
        (error,) = (line for line in message.err.splitlines() if line.startswith("error: "))
        assert not any(part in error for part in ("unrecognized", "no such key"))
    assert "Traceback" not in message.err
