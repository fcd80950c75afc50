"""What all readers have in common; CSV lists; FLSea on real frames and on small trees."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.scenes import Scenes, open_reader
from simnfnd.factory.scenes.flsea import BUILT_IN, SCENES
from simnfnd.factory.settings import build
from tests.factory.scenes.scene_files import (
    DEPTH,
    PINHOLE,
    RGB,
    Array,
    flsea_frame,
    names,
    reader,
    write,
)
from tests.project_files import ROOT


@pytest.mark.parametrize("kind", ["flsea", "csv_list"])
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


def test_what_cannot_be_read_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("imgs/1.tiff", "depth/1_abs_depth.tif"):
        write(tmp_path / "canyons/u_canyon" / name, RGB)

    def closed(folder: Any = ".") -> Any:
        if str(folder).endswith("depth"):
            raise PermissionError(13, "Permission denied", str(folder))
        return scan(folder)

    scan = os.scandir
    monkeypatch.setattr("os.scandir", closed)
    with pytest.raises(FactoryError, match=r"^scenes\.root: .*/depth cannot be read"):
        reader("flsea", tmp_path).discover()


def test_a_pipe_in_a_list_is_a_bad_frame(tmp_path: Path) -> None:
    (tmp_path / "frames.csv").write_text("1.png,1.tif\n")
    os.mkfifo(tmp_path / "1.png")
    csv_list = reader("csv_list", tmp_path / "frames.csv", intrinsics=PINHOLE)
    with pytest.raises(FactoryError, match="none of the 1 frames"):
        csv_list.discover()
    write(tmp_path / "1.tif", DEPTH)
    with pytest.raises(FrameError, match=r"1\.png: no regular file"):
        csv_list.load(csv_list.discover().frames[0])


@pytest.mark.parametrize("kind", ["flsea", "csv_list"])
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


# --- units of depth ------------------------------------------------------------------------------


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


FLSEA = ROOT / "../shared/data/flsea-vi"


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


@pytest.mark.parametrize("inner", ["", "u_canyon"])
@pytest.mark.parametrize("start", ["", "canyons", "canyons/u_canyon", "canyons/u_canyon/."])
def test_flsea_root_may_be_any_level(tmp_path: Path, start: str, inner: str) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon" / inner, "1")
    for root in {start, start + "/" + inner if start.endswith("u_canyon") else start}:
        flsea = reader("flsea", tmp_path / root)
        found = flsea.discover()
        assert [ref.name for ref in found.frames] == ["canyons/u_canyon/1"]
        # The built-in calibration is for 968x608, the image has 24x16 pixels.
        camera, known = flsea.load(found.frames[0]).intrinsics, BUILT_IN["canyons"]
        assert camera.fx == pytest.approx(known.fx * 24 / 968)
        assert camera.fy == pytest.approx(known.fy * 16 / 608)
        assert camera.distortion == known.distortion


def test_flsea_undistorts_where_the_lens_is_known(tmp_path: Path) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon", "1")
    flsea_frame(tmp_path / "red_sea/sub_pier", "1")
    flsea = reader("flsea", tmp_path, undistort=True)
    found = flsea.discover()
    assert all(flsea.load(ref).intrinsics.distortion == () for ref in found.frames)
    assert found.notes[2:] == ("red_sea: lens distortion unknown, images are not undistorted",)


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
