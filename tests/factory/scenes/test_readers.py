"""Readers of recordings: CSV lists, FLSea on real frames and small trees, and their files."""

from __future__ import annotations

import functools
import io
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.scenes import Scenes, open_reader
from simnfnd.factory.scenes.base import Reader
from simnfnd.factory.scenes.flsea import BUILT_IN, SCENES
from simnfnd.factory.scenes.frame_files import read_depth, read_rgb
from simnfnd.factory.scenes.mesh import trajectory
from simnfnd.factory.settings import build
from tests.project_files import ROOT
from tests.render_scenes import FLSEA

PINHOLE = [20.0, 20.0, 11.5, 7.5]
KEYS = {"flsea": "root", "csv_list": "file"}

Array = npt.NDArray[Any]
RGB = np.arange(16 * 24 * 3, dtype=np.uint8).reshape(16, 24, 3)
DEPTH = np.linspace(0.5, 6, 16 * 24, dtype=np.float32).reshape(16, 24)


def reader(kind: str, root: Path, **values: object) -> Reader:
    where = {KEYS[kind]: str(root)}
    settings: Any = build(Scenes, {"kind": kind, **where, **values}, "scenes")
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


@pytest.mark.parametrize("kind", ["flsea", "csv_list"])
def test_missing_and_empty_roots_get_one_line(tmp_path: Path, kind: str) -> None:
    extra = {"intrinsics": PINHOLE} if kind == "csv_list" else {}
    (tmp_path / "empty").mkdir()
    for root in (tmp_path / "absent", tmp_path / "empty", tmp_path / "empty/file.csv"):
        if root.suffix:
            root.write_text("# nothing\n")
        with pytest.raises(FactoryError) as caught:
            reader(kind, root, **extra).discover()
        assert str(caught.value).startswith(f"scenes.{KEYS[kind]}={root}: ")
        assert "\n" not in str(caught.value)
        assert not isinstance(caught.value, FrameError)
    for unset in ("", "???"):
        with pytest.raises(FactoryError, match=rf"scenes\.{KEYS[kind]}: a path is required"):
            build(Scenes, {"kind": kind, KEYS[kind]: unset, **extra}, "scenes")


@pytest.mark.parametrize("kind", ["flsea", "csv_list", "seabed"])
def test_yaml_lists_every_key_with_the_default(kind: str) -> None:
    values = yaml.safe_load((ROOT / f"conf/scenes/{kind}.yaml").read_text())
    given = {key: value for key, value in values.items() if value != "???"}
    required: dict[str, object] = {} if kind == "seabed" else {KEYS[kind]: "x"}
    required |= {"intrinsics": PINHOLE} if kind == "csv_list" else {}
    settings: Any = build(Scenes, {"kind": kind, **required}, "scenes")
    assert set(values) == set(settings.__dataclass_fields__)
    assert build(Scenes, {**given, **required}, "scenes") == settings


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


@pytest.mark.parametrize(
    ("content", "said"),
    [
        *((f"rgb,depth\n1.png,1.tif\n{line}\n".encode(), r"list\.csv:3: ")
          for line in ("only.png", "a,b,c,d", ",b", "a,b,north/south", '"a')),
        (b"x/1.png,x/1.tif\n", "relative to the CSV file"),
        (b"\xff\xfe\x00\x80", "not a text file"),
    ],
)  # fmt: skip
def test_damaged_csv_lists(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "list.csv").write_bytes(content)
    with pytest.raises(FactoryError, match=said):
        reader("csv_list", tmp_path / "list.csv", intrinsics=PINHOLE).discover()


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"intrinsics": [0, 2, 3, 4]},
        {"intrinsics": PINHOLE, "depth_scale": 0},
        {"intrinsics": PINHOLE, "depth_scael": 1},
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

    def loaded(**keys: object) -> Array:
        keys |= {"kind": "csv_list", "file": str(tmp_path / "list.csv"), "intrinsics": PINHOLE}
        listed: Reader = open_reader(build(Scenes, keys))
        return listed.load(listed.discover().frames[0]).depth_m

    with pytest.raises(FrameError, match=r"depth \d,\d+ m: millimetres\? set scenes.depth_sc"):
        loaded()
    np.testing.assert_allclose(loaded(depth_scale=1000), DEPTH, rtol=1e-5)
    with pytest.raises(FrameError, match="divided twice"):
        loaded(depth_scale=1e6)


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


@pytest.mark.parametrize("start", ["", "canyons", "canyons/u_canyon", "canyons/u_canyon/u_canyon"])
def test_flsea_root_may_be_any_level(tmp_path: Path, start: str) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon/u_canyon", "1")
    flsea = reader("flsea", tmp_path / start)
    found = flsea.discover()
    assert [ref.name for ref in found.frames] == ["canyons/u_canyon/1"]
    # The built-in calibration is for 968x608, the image has 24x16 pixels.
    camera, known = flsea.load(found.frames[0]).intrinsics, BUILT_IN["canyons"]
    assert (camera.fx, camera.fy) == pytest.approx((known.fx * 24 / 968, known.fy * 16 / 608))
    assert camera.distortion == known.distortion


def test_flsea_selects_scenes_by_name(tmp_path: Path) -> None:
    for scene in ("canyons/u_canyon", "canyons/flatiron", "red_sea/sub_pier"):
        flsea_frame(tmp_path / scene, "1")
    chosen = ["sub_pier", "u_canyon", "pier_path"]
    flsea = reader("flsea", tmp_path, scenes=chosen)
    assert names(flsea) == ["canyons/u_canyon/1", "red_sea/sub_pier/1"]
    assert flsea.discover().notes[1].endswith("left out: pier_path")
    with pytest.raises(FactoryError, match=r"no FLSea scene pier_path here"):
        reader("flsea", tmp_path, scenes=["pier_path"]).discover()
    assert len(SCENES) == 12


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (np.nan, "3 NaN, 0 infinite, 0 negative"),
        (np.inf, "0 NaN, 3 infinite, 0 negative"),
        (-1, "0 NaN, 0 infinite, 3 negative"),
        ("all invalid", "0 valid pixels"),
        ("mismatch", "depth is 24x15 but colour is 24x16"),
    ],
)
def test_a_bad_frame_is_told_with_its_file(tmp_path: Path, kind: float | str, message: str) -> None:
    depth = np.zeros_like(DEPTH) if kind == "all invalid" else DEPTH.copy()
    if not isinstance(kind, str):
        depth[3, 4:7] = kind
    flsea_frame(tmp_path / "canyons/u_canyon", "1", depth=depth[: 15 if kind == "mismatch" else 16])
    flsea = reader("flsea", tmp_path)
    with pytest.raises(FrameError, match=message) as caught:
        flsea.load(flsea.discover().frames[0])
    assert "1_SeaErra_abs_depth.tif" in str(caught.value)
    assert "\n" not in str(caught.value)
    if not isinstance(kind, str):
        masked = reader("flsea", tmp_path, bad_depth="mask")
        frame = masked.load(masked.discover().frames[0])
        assert (~frame.valid).sum() == 3
        assert np.isfinite(frame.depth_m).all()


@pytest.mark.skipif(not FLSEA.is_dir(), reason="FLSea frames are not here")
def test_real_flsea_frames() -> None:
    flsea = reader("flsea", FLSEA)
    found = flsea.discover()
    assert len(found.frames) == 6
    assert {ref.location for ref in found.frames} == {"canyons", "red_sea"}
    for ref in found.frames:
        frame = flsea.load(ref)
        assert frame.rgb.shape == (608, 968, 3)
        assert frame.intrinsics.fx == BUILT_IN[ref.location].fx
        assert 0.3 < frame.valid.mean() < 0.95
        assert frame.depth_m[frame.valid].min() > 0.3
        assert frame.depth_m.max() < 25
        assert frame.intrinsics == BUILT_IN[ref.location]


# --- Images, depth maps, calibration and trajectories as files: golden values and damage ---


def encoded(array: Array, kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, kind, **options)
    return buffer.getvalue()


@functools.cache
def samples() -> dict[str, tuple[bytes, Array]]:
    rng = np.random.default_rng(7)
    depth = rng.uniform(0.5, 9, (24, 30)).astype(np.float32)
    rgb = rng.integers(0, 256, (24, 30, 3), dtype=np.uint8)
    millimetres = np.round(depth * 1000).astype(np.uint16)
    return {
        "depth-lzw.tif": (encoded(depth, "TIFF", compression="tiff_lzw"), depth),
        "depth-raw.tif": (encoded(depth, "TIFF"), depth),
        "depth-16.png": (encoded(millimetres, "PNG"), millimetres / np.float32(1000)),
        "rgb-lzw.tiff": (encoded(rgb, "TIFF", compression="tiff_lzw"), rgb),
        "rgb.png": (encoded(rgb, "PNG"), rgb),
    }


def read_file(path: Path) -> Array:
    return read_depth(path, None) if path.name.startswith("depth") else read_rgb(path)


@pytest.mark.parametrize("name", sorted(samples()))
def test_what_was_written_is_read(name: str, tmp_path: Path) -> None:
    data, expected = samples()[name]
    (tmp_path / name).write_bytes(data)
    found = read_file(tmp_path / name)
    assert found.dtype == (np.float32 if name.startswith("depth") else np.uint8)
    np.testing.assert_allclose(found, expected, rtol=1e-7)


@settings(max_examples=20)
@given(st.sampled_from(sorted(samples())), st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_refused_and_never_half_read(
    tmp_path_factory: pytest.TempPathFactory, name: str, fraction: float
) -> None:
    data, expected = samples()[name]
    path = tmp_path_factory.mktemp("cut") / name
    path.write_bytes(data[: int(len(data) * fraction)])
    try:
        found = read_file(path)
    except FrameError as error:
        found, fault = None, str(error)
    if found is None:
        assert fault.startswith(str(path))
        assert "\n" not in fault
    else:  # only bytes after the last pixel were missing
        np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_a_damaged_tiff_writes_nothing_to_stderr(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(samples()["depth-lzw.tif"][0])
    data[200:260] = b"\xff" * 60
    (tmp_path / "depth.tif").write_bytes(data)
    with pytest.raises(FrameError, match="truncated or damaged"):
        read_depth(tmp_path / "depth.tif", 1000.0)
    assert capfd.readouterr().err == ""
    os.write(2, b"still here\n")
    assert capfd.readouterr().err == "still here\n"


def test_depth_units_follow_the_type(tmp_path: Path) -> None:
    for shape, kind in (((4, 5, 3), np.float32), ((4, 5), np.uint8), ((4, 5), np.complex64)):
        np.save(tmp_path / "none.npy", np.zeros(shape, kind))
        with pytest.raises(FrameError, match=r"one channel|holds no distances"):
            read_depth(tmp_path / "none.npy", 1000.0)
    np.save(tmp_path / "whole.npy", np.array([[2500, 0]], np.int32))
    np.save(tmp_path / "double.npy", np.array([[2.5, 1e300]]))
    np.testing.assert_array_equal(read_depth(tmp_path / "whole.npy", None), [[2.5, 0]])
    np.testing.assert_array_equal(read_depth(tmp_path / "double.npy", None), [[2.5, np.inf]])
    np.testing.assert_array_equal(read_depth(tmp_path / "double.npy", 5.0), [[0.5, np.inf]])


def test_colour_is_rgb_whatever_the_file(tmp_path: Path) -> None:
    grey = np.arange(20, dtype=np.uint8).reshape(4, 5)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    np.testing.assert_array_equal(read_rgb(tmp_path / "grey.png"), np.dstack([grey] * 3))
    Image.fromarray(grey.astype(np.uint16) * 256).save(tmp_path / "deep.png")
    with pytest.raises(FrameError, match="8-bit"):
        read_rgb(tmp_path / "deep.png")
    with pytest.raises(FrameError, match="no such file"):
        read_rgb(tmp_path / "absent.png")


def test_tum_poses_against_scipy(tmp_path: Path) -> None:
    turns = np.random.default_rng(3).normal(size=(5, 4))
    lines = [f"{i / 10} {i} 2 3 {' '.join(map(repr, q.tolist()))}" for i, q in enumerate(turns)]
    path = tmp_path / "groundtruth.txt"
    path.write_text("\n".join(["# time tx ty tz qx qy qz qw", *lines]))
    times, poses = trajectory(path)
    np.testing.assert_allclose(times, np.arange(5) / 10)
    expected = Rotation.from_quat(turns).as_matrix()
    np.testing.assert_allclose(np.array(poses)[:, :3, :3], expected, atol=1e-12)
    np.testing.assert_array_equal(np.array(poses)[:, :3, 3], [[i, 2, 3] for i in range(5)])


@pytest.mark.parametrize(
    "line", ["1 2 3", "1 2 3 4 0 0 0 0", "1 2 3 4 0 0 0 x", "nan 2 3 4 0 0 0 1"]
)
def test_a_damaged_trajectory_names_file_and_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text(f"0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(FactoryError, match=r"groundtruth\.txt:2: expected"):
        trajectory(path)
