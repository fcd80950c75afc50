"""Recordings beside which something may not be read, or is no file: left out, and told."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.cli.generate import job_of
from simnfnd.factory.errors import FrameError
from simnfnd.factory.scenes import frames_of, open_reader
from simnfnd.factory.scenes.redwood import redwood_poses
from tests.factory.scenes.scene_files import (
    DEPTH,
    PINHOLE,
    RGB,
    flsea_frame,
    names,
    reader,
    tum_recording,
    write,
)


@pytest.fixture
def open_to_nobody() -> Iterator[Path]:
    """A folder in which permissions count while the test runs, whoever runs it."""
    folder = Path(tempfile.mkdtemp(prefix="simnfnd-closed-"))
    folder.chmod(0o755)
    root = os.geteuid() == 0
    yield folder
    if root:
        os.seteuid(0)
    for path, _, _ in os.walk(folder):
        os.chmod(path, 0o755)
    shutil.rmtree(folder)


def as_nobody() -> None:
    """Root may read everything: go on as somebody who may not."""
    if os.geteuid() == 0:
        try:
            os.seteuid(65534)
        except OSError as error:
            pytest.skip(f"cannot go on as another user ({error})")


def redwood_recording(folder: Path) -> None:
    write(folder / "color/1.png", RGB)
    write(folder / "depth/1.png", (DEPTH * 1000).astype(np.uint16))
    (folder / "trajectory.log").write_text("1 1 2\n1 0 0 4\n0 1 0 5\n0 0 1 6\n0 0 0 1\n")


CLOSED = [
    ("flsea", "canyons/u_canyon/imgs"),
    ("flsea", "canyons"),
    ("flsea", "canyons/calibration"),
    ("redwood", "loft/color"),
    ("redwood", "loft/trajectory.log"),
    ("tum", "fr1_desk"),
    ("tum", "fr1_desk/depth.txt"),
]


@pytest.mark.parametrize(("kind", "closed"), CLOSED)
def test_what_may_not_be_read_is_left_out(open_to_nobody: Path, kind: str, closed: str) -> None:
    root = open_to_nobody
    if kind == "flsea":
        for scene in ("canyons/u_canyon", "canyons/flatiron", "red_sea/sub_pier"):
            flsea_frame(root / scene, "1")
        (root / "canyons/calibration").mkdir()
    for name in ("loft", "attic"):
        if kind == "redwood":
            redwood_recording(root / name)
        elif kind == "tum":
            tum_recording(root / f"fr1_{name.replace('loft', 'desk')}", ["1"], ["1"])
    every = set(names(reader(kind, root)))
    path = root / closed
    path.chmod(0)
    redwood_poses.cache_clear()
    as_nobody()
    found = reader(kind, root).discover()
    above = closed in ("canyons", "canyons/calibration")
    lost = {name for name in every if name.startswith("canyons/" if above else path_of(closed))}
    assert lost
    assert {ref.name for ref in found.frames} == every - lost
    assert found.skipped == {"whole folder or list that cannot be read": 1}
    (warning,) = found.warnings
    assert warning.startswith(f"scenes.root: {path} cannot be read (Permission denied); ")
    assert "\n" not in warning
    assert not any("not found here" in note and "u_canyon" in note for note in found.notes) or above


def path_of(closed: str) -> str:
    """What the names of the frames begin with that lie in a recording, given something in it."""
    parts = closed.split("/")
    return "/".join(parts[: 2 if parts[0] == "canyons" else 1]) + "/"


def test_listed_images_that_may_not_be_read_are_bad_frames(open_to_nobody: Path) -> None:
    for name in ("fr1_a", "fr1_b"):
        tum_recording(open_to_nobody / name, ["1"], ["1"])
    tum = reader("tum", open_to_nobody)
    refs = tum.discover().frames
    (open_to_nobody / "fr1_a/rgb").chmod(0)
    as_nobody()
    assert tum.discover().frames == refs
    with pytest.raises(FrameError, match=r"rgb/1\.png: cannot be read \(Permission denied\)"):
        tum.load(refs[0])
    tum.load(refs[1])


def test_a_link_into_a_closed_folder_is_a_bad_frame(open_to_nobody: Path) -> None:
    scene = open_to_nobody / "canyons/u_canyon"
    flsea_frame(scene, "1")
    flsea_frame(scene, "2")
    (open_to_nobody / "vault").mkdir()
    (scene / "imgs/2.tiff").rename(open_to_nobody / "vault/2.tiff")
    (scene / "imgs/2.tiff").symlink_to("../../../vault/2.tiff")
    (scene / "imgs/3.tiff").symlink_to("nowhere.tiff")
    write(scene / "depth/3_abs_depth.tif", DEPTH)
    (open_to_nobody / "vault").chmod(0)
    flsea = reader("flsea", open_to_nobody)
    flsea.load(flsea.discover().frames[0])
    as_nobody()
    found = flsea.discover()
    assert [ref.frame for ref in found.frames] == ["1", "2"]
    with pytest.raises(FrameError, match=r"2\.tiff: cannot be read \(Permission denied\)"):
        flsea.load(found.frames[1])


@pytest.mark.parametrize("name", ["rgb/1.png", "depth/1.npy"])
def test_pipes_and_devices_in_a_list_are_bad_frames(tmp_path: Path, name: str) -> None:
    tum_recording(tmp_path, ["1"], ["1"])
    rgb, depth = ("rgb/1.png", name) if name.startswith("depth") else (name, "depth/1.png")
    (tmp_path / "frames.csv").write_text(f"{rgb},{depth}\n")
    (tmp_path / name).unlink(missing_ok=True)
    if name == "rgb/1.png":
        os.mkfifo(tmp_path / name)
    else:
        (tmp_path / name).symlink_to("/dev/zero")
    csv_list = reader("csv_list", tmp_path / "frames.csv", intrinsics=PINHOLE)
    with pytest.raises(FrameError, match=rf"{name}: no regular file"):
        csv_list.load(csv_list.discover().frames[0])


def test_a_run_says_what_it_leaves_out(
    open_to_nobody: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = open_to_nobody
    for scene in ("canyons/u_canyon", "canyons/flatiron", "red_sea/sub_pier"):
        flsea_frame(root / scene, "1")
    (root / "canyons/u_canyon/imgs").chmod(0)
    config = compose_config(["scenes=flsea", f"scenes.root={root}", "cache.enabled=false"])
    as_nobody()
    job = job_of(config, [])
    told = capsys.readouterr()
    what = f"scenes.root: {root}/canyons/u_canyon/imgs cannot be read (Permission denied); "
    assert f"warning: {what}" in told.err
    assert "scenes: 1 skipped: whole folder or list that cannot be read" in told.out
    assert any(line.startswith(what) for line in job.warnings)  # said again at the end
    assert job.skipped == {"whole folder or list that cannot be read": 1}
    assert len(frames_of(open_reader(config.scenes))) == 2
    assert capsys.readouterr().err.startswith(f"warning: {what}")
