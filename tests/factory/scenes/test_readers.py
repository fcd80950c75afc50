"""The readers of TUM and Redwood, and what all readers have in common."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.scenes import Scenes
from simnfnd.factory.scenes.tum import associated
from simnfnd.factory.settings import build
from tests.factory.scenes.scene_files import (
    DEPTH,
    PINHOLE,
    RGB,
    names,
    reader,
    tum_recording,
    write,
)
from tests.project_files import ROOT

REDWOOD = ROOT / "../shared/data/redwood"


@pytest.mark.parametrize("kind", ["flsea", "tum", "redwood", "csv_list"])
def test_missing_and_empty_roots_get_one_line(tmp_path: Path, kind: str) -> None:
    extra = {"intrinsics": PINHOLE} if kind == "csv_list" else {}
    (tmp_path / "empty").mkdir()
    for root in (tmp_path / "absent", tmp_path / "empty", tmp_path / "empty/file.csv"):
        if root.suffix:
            root.write_text("# nothing\n")
        with pytest.raises(FactoryError) as caught:
            reader(kind, root, **extra).discover()
        assert str(caught.value).startswith(f"scenes.root={root}: ")
        assert "\n" not in str(caught.value)
        assert not isinstance(caught.value, FrameError)
    for unset in ("", "???"):
        with pytest.raises(FactoryError, match=r"scenes\.root: a path is required"):
            build(Scenes, {"kind": kind, "root": unset, **extra}, "scenes")


@pytest.mark.parametrize("kind", ["flsea", "redwood"])
def test_what_cannot_be_read_is_one_line(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / ("canyons/u_canyon" if kind == "flsea" else "loft")
    for name in ("imgs/1.tiff", "depth/1_abs_depth.tif", "color/1.png"):
        write(place / name, RGB)

    def closed(folder: Path) -> None:
        raise PermissionError(13, "Permission denied", str(folder))

    monkeypatch.setattr("os.scandir", closed)
    with pytest.raises(FactoryError, match=r"^scenes\.root: .*/(depth|color) cannot be read"):
        reader(kind, tmp_path).discover()


def test_a_pipe_in_a_list_is_a_bad_frame(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("1.png,1.tif\n")
    os.mkfifo(tmp_path / "1.png")
    csv_list = reader("csv_list", tmp_path / "frames.csv", intrinsics=PINHOLE)
    with pytest.raises(FactoryError, match="none of the 1 frames"):
        csv_list.discover()
    write(tmp_path / "1.tif", DEPTH)
    with pytest.raises(FrameError, match=r"1\.png: no regular file"):
        csv_list.load(csv_list.discover().frames[0])


# --- TUM -----------------------------------------------------------------------------------------


def test_tum_pairs_scales_and_poses(tmp_path: Path) -> None:
    folder = tum_recording(
        tmp_path / "rgbd_dataset_freiburg1_desk",
        ["10.00", "10.02", "10.06", "10.50"],
        ["10.008", "10.065", "10.20"],
    )
    (folder / "groundtruth.txt").write_text("10.001 1 2 3 0 0 1 1\n10.3 0 0 0 0 0 0 1\n")
    tum = reader("tum", tmp_path)
    found = tum.discover()
    # Both 10.00 and 10.02 are near 10.008: the nearer gets it.
    assert [ref.frame for ref in found.frames] == ["10.00", "10.06"]
    assert [Path(ref.paths[1]).stem for ref in found.frames] == ["10.008", "10.065"]
    assert found.skipped == {
        "depth map without an image close in time": 1,
        "image without a depth map close in time": 2,
    }
    first, second = map(tum.load, found.frames)
    np.testing.assert_allclose(first.depth_m, DEPTH, atol=1 / 5000)
    np.testing.assert_allclose(second.depth_m, DEPTH + 1 / 5000, atol=1 / 5000)
    assert first.world_from_camera is not None
    np.testing.assert_allclose(
        first.world_from_camera,
        [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
        atol=1e-15,
    )
    assert second.world_from_camera is None
    # Published for 640x480, the images here are 24x16.
    assert first.intrinsics.fx == pytest.approx(517.3 * 24 / 640)
    assert first.intrinsics.fy == pytest.approx(516.5 * 16 / 480)
    assert names(reader("tum", folder)) == [ref.name for ref in found.frames]
    assert len(reader("tum", tmp_path, max_time_difference_s=0.006).discover().frames) == 1


def test_tum_needs_to_know_the_camera(tmp_path: Path) -> None:
    tum_recording(tmp_path / "my_kinect", ["1"], ["1"])
    with pytest.raises(FactoryError, match=r"my_kinect.*set scenes\.intrinsics"):
        reader("tum", tmp_path).discover()
    tum = reader("tum", tmp_path, intrinsics=PINHOLE)
    assert tum.load(tum.discover().frames[0]).intrinsics.fx == 20.0
    for fr, fx in (("fr2_xyz", 520.9), ("freiburg3_cabinet", 535.4)):
        tum = reader("tum", tum_recording(tmp_path / fr, ["1"], ["1"]))
        assert tum.load(tum.discover().frames[0]).intrinsics.fx == pytest.approx(fx * 24 / 640)


def test_tum_damaged_lists_and_missing_images(tmp_path: Path) -> None:
    folder = tum_recording(tmp_path / "fr1", ["1", "2"], ["1", "2"])
    (folder / "rgb/2.png").unlink()
    tum = reader("tum", tmp_path)
    refs = tum.discover().frames
    with pytest.raises(FrameError, match=r"2\.png: no such file"):
        tum.load(refs[1])
    (folder / "rgb.txt").write_text("1 rgb/a.png\n2 rgb/b.png\n")
    (folder / "depth.txt").write_text("1 depth/a.png\n2 depth/b.png\n")
    with pytest.raises(FactoryError, match="none of the 2 frames"):
        tum.discover()
    (folder / "rgb.txt").write_text("1 rgb/1.png\nnoon rgb/2.png\n")
    with pytest.raises(FactoryError, match=r"rgb\.txt:2: expected `time file`"):
        tum.discover()


TIMES = st.lists(st.integers(0, 60), max_size=12, unique=True).map(lambda ts: [t / 10 for t in ts])


@given(TIMES, TIMES, st.integers(0, 8))
def test_association_is_one_to_one_close_and_complete(
    first: list[float], second: list[float], tenths: int
) -> None:
    limit = tenths / 10 + 1e-9
    pairs = associated(first, second, limit)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    assert all(abs(first[i] - second[j]) <= limit for i, j in pairs)
    # Greedy and complete: whoever is left alone has only partners that found someone no further.
    gap_first = {i: abs(first[i] - second[j]) for i, j in pairs}
    gap_second = {j: abs(first[i] - second[j]) for i, j in pairs}
    for i in range(len(first)):
        for j in range(len(second)):
            gap = abs(first[i] - second[j])
            if gap <= limit and (i, j) not in pairs:
                assert min(gap_first.get(i, 99), gap_second.get(j, 99)) <= gap


# --- Redwood -------------------------------------------------------------------------------------


def test_redwood_pairs_by_number(tmp_path: Path) -> None:
    for recording in ("loft", "attic"):
        for number in (0, 1, 3):
            write(tmp_path / recording / f"color/{number:05d}.jpg", RGB)
        for number in (0, 1, 2):
            millimetres = (DEPTH * 1000).astype(np.uint16)
            write(tmp_path / recording / f"depth/{number:05d}-{number * 33:09d}.png", millimetres)
    (tmp_path / "loft/trajectory.log").write_text("1 1 2\n1 0 0 4\n0 1 0 5\n0 0 1 6\n0 0 0 1\n")
    redwood = reader("redwood", tmp_path)
    found = redwood.discover()
    assert [ref.name for ref in found.frames] == [
        "attic/00000",
        "attic/00001",
        "loft/00000",
        "loft/00001",
    ]
    assert found.skipped == {"depth map without an image": 2, "image without a depth map": 2}
    assert found.notes == ("attic: no trajectory.log, frames have no pose",)
    frames = [redwood.load(ref) for ref in found.frames]
    assert [frame.world_from_camera is None for frame in frames] == [True, True, True, False]
    np.testing.assert_allclose(frames[0].depth_m, DEPTH, atol=1e-3)


@pytest.mark.skipif(not REDWOOD.is_dir(), reason="Redwood frames are not here")
def test_real_redwood_frames_agree_with_each_other() -> None:
    redwood = reader("redwood", REDWOOD)
    frames = [redwood.load(ref) for ref in redwood.discover().frames]
    assert [frame.ref.name for frame in frames] == [f"redwood/0000{i}" for i in range(5)]
    # Points of the last frame, moved by the poses, land on the first frame's depth: depth unit,
    # intrinsics and the direction of the poses are right together, or this fails.
    first, last = frames[0], frames[4]
    assert first.world_from_camera is not None
    assert last.world_from_camera is not None
    k, (v, u) = last.intrinsics, np.mgrid[:480:4, :640:4]
    z = last.depth_m[v, u].astype(np.float64)
    points = np.stack([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z, np.ones_like(z)])[:, z > 0]
    x, y, z, _ = np.linalg.inv(first.world_from_camera) @ last.world_from_camera @ points
    columns, rows = np.rint(x / z * k.fx + k.cx), np.rint(y / z * k.fy + k.cy)
    inside = (columns >= 0) & (columns < 640) & (rows >= 0) & (rows < 480)
    seen = first.depth_m[rows[inside].astype(int), columns[inside].astype(int)]
    error = np.abs(seen - z[inside])[seen > 0]
    assert inside.mean() > 0.8
    assert np.median(error) < 0.01


# --- the union -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["flsea", "tum", "redwood", "csv_list"])
def test_yaml_lists_every_key_with_the_default(kind: str) -> None:
    values = yaml.safe_load((ROOT / f"conf/scenes/{kind}.yaml").read_text())
    given = {key: value for key, value in values.items() if value != "???"}
    required = {"root": "x", **({"intrinsics": PINHOLE} if kind == "csv_list" else {})}
    settings: Any = build(Scenes, {"kind": kind, **required}, "scenes")
    assert set(values) == set(settings.__dataclass_fields__)
    assert build(Scenes, {**given, **required}, "scenes") == settings


def test_configuration_alone_loads_no_heavy_library() -> None:
    code = (
        "import sys, json, simnfnd.factory.scenes\n"
        "heavy = {'open3d', 'bpy', 'torch', 'matplotlib'}\n"
        "print(json.dumps(sorted(heavy & set(sys.modules))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == []
