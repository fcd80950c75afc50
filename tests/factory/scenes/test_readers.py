"""The readers of FLSea, TUM, Redwood and CSV lists on real frames and on small trees."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.scenes import Scenes, open_reader
from simnfnd.factory.scenes.base import Reader
from simnfnd.factory.scenes.flsea import BUILT_IN, SCENES
from simnfnd.factory.scenes.tum import associated
from simnfnd.factory.settings import build
from tests.factory.scenes.test_files import KALIBR_IMUCAM
from tests.project_files import ROOT

FLSEA = ROOT / "../shared/data/flsea-vi"
REDWOOD = ROOT / "../shared/data/redwood"
PINHOLE = [20.0, 20.0, 11.5, 7.5]

Array = npt.NDArray[Any]
RGB = np.arange(16 * 24 * 3, dtype=np.uint8).reshape(16, 24, 3)
DEPTH = np.linspace(0.5, 6, 16 * 24, dtype=np.float32).reshape(16, 24)


def reader(kind: str, root: Path, **values: object) -> Reader:
    settings: Any = build(Scenes, {"kind": kind, "root": str(root), **values}, "scenes")
    return open_reader(settings)


def write(path: Path, array: Array) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    options = {"compression": "tiff_lzw"} if path.suffix.startswith(".tif") else {}
    Image.fromarray(array).save(path, **options)
    return path


def flsea_frame(
    scene: Path, stamp: str, depth: Array | None = DEPTH, ending: str = "_SeaErra_abs_depth"
) -> None:
    write(scene / "imgs" / f"{stamp}.tiff", RGB)
    if depth is not None:
        write(scene / "depth" / f"{stamp}{ending}.tif", depth)


def names(reader: Reader) -> list[str]:
    return [ref.name for ref in reader.discover().frames]


# --- FLSea ---------------------------------------------------------------------------------------


def test_flsea_finds_every_layout(tmp_path: Path) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon", "2")
    flsea_frame(tmp_path / "canyons/u_canyon", "1", ending="_abs_depth")
    flsea_frame(tmp_path / "canyons/flatiron/flatiron", "9")
    flsea_frame(tmp_path / "red_sea/sub_pier", "5")
    flsea_frame(tmp_path / "red_sea/sub_pier", "6", depth=None)
    write(tmp_path / "red_sea/sub_pier/depth/7_SeaErra_abs_depth.tif", DEPTH)
    (tmp_path / "canyons/u_canyon/imgs/._1.tiff").write_bytes(b"Mac")
    (tmp_path / "canyons/u_canyon/notes.txt").write_text("dive")
    found = reader("flsea", tmp_path).discover()
    assert [ref.name for ref in found.frames] == [
        "canyons/flatiron/9",
        "canyons/u_canyon/1",
        "canyons/u_canyon/2",
        "red_sea/sub_pier/5",
    ]
    assert found.skipped == {"depth map without an image": 1, "image without a depth map": 1}
    assert found.notes[0] == "FLSea: 3 of 12 scenes"
    assert "horse_canyon, tiny_canyon, big_dice_loop" in found.notes[1]
    assert "u_canyon" not in found.notes[1]
    for ref in found.frames:
        frame = reader("flsea", tmp_path).load(pickle.loads(pickle.dumps(ref)))
        np.testing.assert_array_equal(frame.rgb, RGB)
        np.testing.assert_array_equal(frame.depth_m, DEPTH)


def test_flsea_prefers_the_newer_depth_name(tmp_path: Path) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon", "1")
    flsea_frame(tmp_path / "canyons/u_canyon", "1", depth=DEPTH * 2, ending="_abs_depth")
    flsea = reader("flsea", tmp_path)
    np.testing.assert_array_equal(flsea.load(flsea.discover().frames[0]).depth_m, DEPTH)


@pytest.mark.parametrize("inner", ["", "u_canyon"])
@pytest.mark.parametrize("start", ["", "canyons", "canyons/u_canyon", "canyons/u_canyon/."])
def test_flsea_root_may_be_any_level(tmp_path: Path, start: str, inner: str) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon" / inner, "1")
    (tmp_path / "canyons/calibration").mkdir()
    calibration = tmp_path / "canyons/calibration/a-kalibr-results-imucam.txt"
    calibration.write_text(KALIBR_IMUCAM)
    for root in {start, start + "/" + inner if start.endswith("u_canyon") else start}:
        flsea = reader("flsea", tmp_path / root)
        found = flsea.discover()
        assert [ref.name for ref in found.frames] == ["canyons/u_canyon/1"]
        assert found.notes[-1] == f"canyons: intrinsics {calibration.name}"
        # The Kalibr file is for 968x608, the image has 24x16 pixels.
        camera = flsea.load(found.frames[0]).intrinsics
        assert camera.fx == pytest.approx(1296.5 * 24 / 968)
        assert camera.fy == pytest.approx(1300.25 * 16 / 608)
        assert camera.distortion == (-0.125, 0.0625, -0.0045, 0.0007)


def test_flsea_calibration_belongs_to_its_location(tmp_path: Path) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon", "1")
    flsea_frame(tmp_path / "red_sea/sub_pier", "1")
    (tmp_path / "red_sea/calibration").mkdir()
    (tmp_path / "red_sea/calibration/x-kalibr-results-imucam.txt").write_text(KALIBR_IMUCAM)
    flsea = reader("flsea", tmp_path, undistort=True)
    canyon, pier = map(flsea.load, flsea.discover().frames)
    assert canyon.intrinsics.fx == pytest.approx(BUILT_IN["canyons"].fx * 24 / 968)
    assert pier.intrinsics.fx == pytest.approx(1296.5 * 24 / 968)
    assert canyon.intrinsics.distortion == pier.intrinsics.distortion == ()
    (tmp_path / "red_sea/calibration/x-kalibr-results-imucam.txt").unlink()
    assert "distortion unknown" in reader("flsea", tmp_path, undistort=True).discover().notes[-1]


def test_flsea_selects_scenes_by_name(tmp_path: Path) -> None:
    for scene in ("canyons/u_canyon", "canyons/flatiron", "red_sea/sub_pier"):
        flsea_frame(tmp_path / scene, "1")
    chosen = ["sub_pier", "u_canyon", "pier_path"]
    flsea = reader("flsea", tmp_path, scenes=chosen)
    assert names(flsea) == ["canyons/u_canyon/1", "red_sea/sub_pier/1"]
    assert flsea.discover().notes[1].endswith("left out: pier_path")
    with pytest.raises(FactoryError, match=r"no FLSea scene pier_path here"):
        reader("flsea", tmp_path, scenes=["pier_path"]).discover()
    with pytest.raises(FactoryError, match=r"scenes\.scenes: unknown scene 'canyon'") as caught:
        reader("flsea", tmp_path, scenes=["canyon"])
    assert all(scene in str(caught.value) for scene in SCENES)
    assert len(SCENES) == 12


def damaged_depth(kind: str) -> Array:
    depth = DEPTH.copy()
    depth[3, 4:7] = {"nan": np.nan, "negative": -1, "infinite": np.inf}.get(kind, 0)
    return {"all invalid": np.zeros_like(depth), "mismatch": depth[:-1]}.get(kind, depth)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("nan", "3 NaN, 0 infinite, 0 negative"),
        ("infinite", "0 NaN, 3 infinite, 0 negative"),
        ("negative", "0 NaN, 0 infinite, 3 negative"),
        ("all invalid", "0 valid pixels"),
        ("mismatch", "depth is 24x15 but colour is 24x16"),
    ],
)
def test_a_bad_frame_is_told_with_its_file(tmp_path: Path, kind: str, message: str) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon", "1", depth=damaged_depth(kind))
    flsea = reader("flsea", tmp_path, undistort=True)
    with pytest.raises(FrameError, match=message) as caught:
        flsea.load(flsea.discover().frames[0])
    assert "1_SeaErra_abs_depth.tif" in str(caught.value)
    assert "\n" not in str(caught.value)
    if kind in ("nan", "infinite", "negative"):
        masked = reader("flsea", tmp_path, bad_depth="mask")
        frame = masked.load(masked.discover().frames[0])
        assert (~frame.valid).sum() == 3
        assert np.isfinite(frame.depth_m).all()


def test_range_depth_keeps_every_distance(tmp_path: Path) -> None:
    flsea_frame(tmp_path / "red_sea/sub_pier", "1", depth=np.full_like(DEPTH, 5.0))
    flsea = reader("flsea", tmp_path, depth_kind="range")
    frame = flsea.load(flsea.discover().frames[0])
    camera, (v, u) = frame.intrinsics, np.mgrid[:16, :24]
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1
    )
    distances = np.linalg.norm(rays * frame.depth_m[..., None], axis=-1)
    np.testing.assert_allclose(distances, 5.0, rtol=1e-6)
    assert np.ptp(frame.depth_m) > 0.1


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


def test_flsea_without_any_depth_says_what_it_saw(tmp_path: Path) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon", "1", depth=None)
    with pytest.raises(FactoryError, match=r"no frame in u_canyon \(1 x image without a depth map"):
        reader("flsea", tmp_path).discover()


def test_links_in_a_circle_are_no_images(tmp_path: Path) -> None:
    scene = tmp_path / "canyons/u_canyon"
    flsea_frame(scene, "1")
    (scene / "imgs/2.tiff").symlink_to("2.tiff")
    (scene / "depth/3_abs_depth.tif").symlink_to("4_abs_depth.tif")
    (scene / "depth/4_abs_depth.tif").symlink_to("3_abs_depth.tif")
    assert names(reader("flsea", tmp_path)) == ["canyons/u_canyon/1"]
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(FactoryError, match=f"^scenes.root={tmp_path}/circle: no such folder"):
        reader("flsea", tmp_path / "circle").discover()


@pytest.mark.parametrize("kind", ["flsea", "redwood"])
def test_a_folder_that_may_not_be_read_gets_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    closed = tmp_path / ("canyons/u_canyon/imgs" if kind == "flsea" else "loft/color")
    write(closed / "1.png", RGB)
    (closed.parent / "depth").mkdir()
    scan = os.scandir

    def refused(path: Any) -> Any:
        # Permissions mean nothing to root, as whom these tests may run.
        if Path(path) == closed:
            raise PermissionError(13, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", refused)
    with pytest.raises(FactoryError, match=rf"^scenes.root: {closed} cannot be read") as caught:
        reader(kind, tmp_path).discover()
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not FLSEA.is_dir(), reason="FLSea frames are not here")
@pytest.mark.parametrize("undistort", [False, True])
def test_real_flsea_frames(undistort: bool) -> None:
    flsea = reader("flsea", FLSEA, undistort=undistort)
    found = flsea.discover()
    scenes = [(ref.location, ref.scene) for ref in found.frames]
    assert scenes == [
        *[("canyons", "u_canyon")] * 3,
        ("red_sea", "coral_table_loop"),
        *[("red_sea", "sub_pier")] * 2,
    ]
    for ref in found.frames:
        frame = flsea.load(ref)
        assert frame.rgb.shape == (608, 968, 3)
        assert frame.intrinsics.fx == BUILT_IN[ref.location].fx
        assert 0.3 < frame.valid.mean() < 0.95
        assert frame.depth_m[frame.valid].min() > 0.3
        assert frame.depth_m.max() < 25
        expected = BUILT_IN[ref.location].distortion
        assert frame.intrinsics.distortion == (() if undistort else expected)


# --- TUM -----------------------------------------------------------------------------------------


def tum_recording(folder: Path, rgb_s: list[str], depth_s: list[str]) -> Path:
    for kind, times in (("rgb", rgb_s), ("depth", depth_s)):
        for i, time in enumerate(times):
            stored = RGB if kind == "rgb" else (DEPTH * 5000 + i).astype(np.uint16)
            write(folder / kind / f"{time}.png", stored)
        lines = [f"{time} {kind}/{time}.png" for time in times]
        (folder / f"{kind}.txt").write_text("# timestamp filename\n" + "\n".join(lines) + "\n")
    return folder


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


def test_association_gives_ties_to_the_earlier() -> None:
    assert associated([0.0, 1.0], [0.5], 0.5) == [(0, 0)]
    assert associated([0.5], [1.0, 0.0], 0.5) == [(0, 1)]
    assert associated([0.0, 1.0], [0.5], 0.25) == []


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


# --- CSV lists -----------------------------------------------------------------------------------


def test_csv_list_reads_every_depth_kind(tmp_path: Path) -> None:
    write(tmp_path / "a/1.png", RGB)
    write(tmp_path / "a/2.png", RGB)
    write(tmp_path / "b/1.png", RGB)
    write(tmp_path / "a/1.tif", np.where(DEPTH < 1, -1, DEPTH) * np.float32(256))
    write(tmp_path / "a/2.png.png", (DEPTH * 256).astype(np.uint16))
    np.save(tmp_path / "b/1.npy", np.where(DEPTH > 5, 1e4, DEPTH) * np.float32(256))
    path = tmp_path / "list.csv"
    path.write_text(
        "\ufeffrgb, depth, scene\n# comment\n\n"
        f'b/1.png,b/1.npy,south\na/1.png,a/1.tif,\n{tmp_path}/a/2.png,"a/2.png.png"\n'
        "a/1.png,a/1.tif\n"
    )
    values = {"intrinsics": PINHOLE, "depth_scale": 256, "invalid_above_m": 100}
    listed = reader("csv_list", path, **values)
    found = listed.discover()
    assert [ref.name for ref in found.frames] == ["list/2", "list/a-1", "south/1"]
    assert found.skipped == {"listed twice": 1}
    two, one, south = map(listed.load, found.frames)
    np.testing.assert_allclose(two.depth_m, DEPTH, atol=1 / 256)
    np.testing.assert_array_equal(one.depth_m, np.where(DEPTH < 1, 0, DEPTH))
    np.testing.assert_array_equal(south.depth_m, np.where(DEPTH > 5, 0, DEPTH))
    assert two.intrinsics.cx == 11.5
    floor_m = float(DEPTH[2, 3])
    nearest = reader("csv_list", path, **values, invalid_below_m=floor_m)
    masked = nearest.load(found.frames[2]).depth_m
    np.testing.assert_array_equal(masked > 0, np.greater(DEPTH, floor_m) & (DEPTH <= 5))
    strict = reader("csv_list", path, **values, invalid_below_m=None)
    with pytest.raises(FrameError, match=r"negative.*1\.tif"):
        strict.load(strict.discover().frames[1])


def test_csv_list_tells_stems_apart(tmp_path: Path) -> None:
    for folder in ("dive1", "dive2"):
        write(tmp_path / folder / "1.png", RGB)
        write(tmp_path / folder / "1.tif", DEPTH)
    path = tmp_path / "list.csv"
    path.write_text("./dive1/1.png,dive1/1.tif\ndive2/1.png,dive2/1.tif\n")
    assert names(reader("csv_list", path, intrinsics=PINHOLE)) == ["list/dive1-1", "list/dive2-1"]


@pytest.mark.parametrize("line", ["only.png", "a,b,c,d", ",b", "a.png,", "a,b,north/south", '"a'])
def test_csv_list_damaged_lines(tmp_path: Path, line: str) -> None:
    path = tmp_path / "list.csv"
    path.write_text(f"rgb,depth\n1.png,1.tif\n{line}\n")
    with pytest.raises(FactoryError, match=r"list\.csv:3: "):
        reader("csv_list", path, intrinsics=PINHOLE).discover()


def test_csv_list_that_lists_nothing_on_disk_or_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text("x/1.png,x/1.tif\n")
    with pytest.raises(FactoryError, match="relative to the CSV file"):
        reader("csv_list", path, intrinsics=PINHOLE).discover()
    path.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(FactoryError, match="not a text file"):
        reader("csv_list", path, intrinsics=PINHOLE).discover()


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"intrinsics": [1, 2, 3]},
        {"intrinsics": [0, 2, 3, 4]},
        {"intrinsics": "???"},
        {"intrinsics": PINHOLE, "distortion": [0.1]},
        {"intrinsics": PINHOLE, "depth_scale": 0},
        {"intrinsics": PINHOLE, "depth_scael": 1},
        {"intrinsics": PINHOLE, "depth_kind": "disparity"},
    ],
)
def test_csv_list_refuses_bad_keys_by_name(tmp_path: Path, values: dict[str, object]) -> None:
    key = list(values)[-1] if values else "intrinsics"
    with pytest.raises(FactoryError, match=rf"^scenes\.{key}") as caught:
        reader("csv_list", tmp_path, **values)
    assert "csv_list." not in str(caught.value)


# --- the union -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["flsea", "tum", "redwood", "csv_list"])
def test_yaml_lists_every_key_with_the_default(kind: str) -> None:
    values = yaml.safe_load((ROOT / f"conf/scenes/{kind}.yaml").read_text())
    given = {key: value for key, value in values.items() if value != "???"}
    required = {"root": "x", **({"intrinsics": PINHOLE} if kind == "csv_list" else {})}
    settings: Any = build(Scenes, {"kind": kind, **required}, "scenes")
    assert set(values) == set(settings.__dataclass_fields__)
    assert build(Scenes, {**given, **required}, "scenes") == settings


def test_unknown_kinds_are_refused() -> None:
    with pytest.raises(FactoryError, match=r"^scenes: .*'kitti'.*'flsea'"):
        build(Scenes, {"kind": "kitti"}, "scenes")


def test_configuration_alone_loads_no_heavy_library() -> None:
    code = (
        "import sys, json, simnfnd.factory.scenes\n"
        "heavy = {'open3d', 'bpy', 'torch', 'matplotlib'}\n"
        "print(json.dumps(sorted(heavy & set(sys.modules))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == []


# --- units of depth ------------------------------------------------------------------------------


@pytest.mark.parametrize("stored", [DEPTH, (DEPTH * 1000).astype(np.uint16)])
def test_depth_without_a_scale_is_metres_or_integer_millimetres(tmp_path: Path, stored) -> None:
    write(tmp_path / "1.png", RGB)
    write(tmp_path / "1.tif", stored)
    (tmp_path / "list.csv").write_text("1.png,1.tif\n")
    listed = reader("csv_list", tmp_path / "list.csv", intrinsics=PINHOLE)
    (frame,) = map(listed.load, listed.discover().frames)
    np.testing.assert_allclose(frame.depth_m, DEPTH, atol=1e-3)


def test_float_millimetres_are_named_and_depth_scale_mends_them(tmp_path: Path) -> None:
    write(tmp_path / "1.png", RGB)
    write(tmp_path / "1.tif", DEPTH * np.float32(1000))
    (tmp_path / "list.csv").write_text("1.png,1.tif\n")
    listed = reader("csv_list", tmp_path / "list.csv", intrinsics=PINHOLE)
    (ref,) = listed.discover().frames
    with pytest.raises(
        FrameError, match=r"median depth \d,\d+ m: millimetres\? set scenes.depth_sc"
    ):
        listed.load(ref)
    mended = reader("csv_list", tmp_path / "list.csv", intrinsics=PINHOLE, depth_scale=1000)
    np.testing.assert_allclose(mended.load(ref).depth_m, DEPTH, rtol=1e-5)
    twice = reader("csv_list", tmp_path / "list.csv", intrinsics=PINHOLE, depth_scale=1e6)
    with pytest.raises(FrameError, match="divided twice"):
        twice.load(ref)


def test_the_list_of_frames_is_a_file(tmp_path: Path) -> None:
    write(tmp_path / "1.png", RGB)
    write(tmp_path / "1.tif", DEPTH)
    path = tmp_path / "list.csv"
    path.write_text("1.png,1.tif\n")
    named: Any = build(Scenes, {"kind": "csv_list", "file": str(path), "intrinsics": PINHOLE})
    assert len(open_reader(named).discover().frames) == 1
    with pytest.raises(FactoryError, match=r"scenes.file=frames.csv"):
        build(Scenes, {"kind": "csv_list", "intrinsics": PINHOLE})
