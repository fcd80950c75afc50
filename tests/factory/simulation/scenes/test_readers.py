"""Readers of recordings: CSV lists, FLSea on real frames and small trees, and their files."""

from __future__ import annotations

import functools
import io
import os
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from simnfnd.factory.common.array_types import Array
from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics, checked
from simnfnd.factory.simulation.scenes import Scenes, open_reader
from simnfnd.factory.simulation.scenes.base import Reader
from simnfnd.factory.simulation.scenes.flsea import BUILT_IN, SCENES
from simnfnd.factory.simulation.scenes.frame_files import image_size, read_depth, read_rgb
from simnfnd.factory.simulation.scenes.poses import trajectory
from tests.project_files import ROOT
from tests.render_scenes import FLSEA

PINHOLE = [20.0, 20.0, 11.5, 7.5]
KEYS = {"flsea": "root", "csv_list": "file"}

RGB = np.arange(16 * 24 * 3, dtype=np.uint8).reshape(16, 24, 3)
DEPTH = np.linspace(0.5, 6, 16 * 24, dtype=np.float32).reshape(16, 24)


def reader(kind: str, root: Path, **values: object) -> Reader:
    location = {KEYS[kind]: str(root)}
    settings: Any = build(Scenes, {"kind": kind, **location, **values}, "scenes")
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
        with pytest.raises(FactoryError, match=rf"scenes\.{KEYS[kind]}: "):
            build(Scenes, {"kind": kind, KEYS[kind]: unset, **extra}, "scenes")


@pytest.mark.parametrize("kind", ["flsea", "csv_list", "seabed"])
def test_yaml_lists_every_key_with_the_default(kind: str) -> None:
    values = yaml.safe_load((ROOT / f"conf/scenes/{kind}.yaml").read_text())
    defaults = {key: value for key, value in values.items() if value != "???"}
    required: dict[str, object] = {} if kind == "seabed" else {KEYS[kind]: "x"}
    required |= {"intrinsics": PINHOLE} if kind == "csv_list" else {}
    settings: Any = build(Scenes, {"kind": kind, **required}, "scenes")
    assert set(values) == set(settings.__dataclass_fields__)
    assert build(Scenes, {**defaults, **required}, "scenes") == settings


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
    actual = listed.discover()
    assert [ref.name for ref in actual.frames] == ["list/2", "list/a-1", "south/1"]
    assert actual.skipped == {"listed twice": 1}
    first, north, south = map(listed.load, actual.frames)
    np.testing.assert_allclose(first.depth_m, DEPTH, atol=1 / 256)
    np.testing.assert_array_equal(north.depth_m, np.where(DEPTH < 1, 0, DEPTH))
    np.testing.assert_array_equal(south.depth_m, np.where(DEPTH > 5, 0, DEPTH))
    assert first.intrinsics.cx == 11.5
    floor_m = float(DEPTH[2, 3])
    nearest = reader("csv_list", path, **values, invalid_below_m=floor_m)
    masked = nearest.load(actual.frames[2]).depth_m
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


# --- units of depth ------------------------------------------------------------------------------


def test_long_names_fit_the_table(tmp_path: Path) -> None:
    names = [f"{'dive' * 40}{number}" for number in (1, 2)]
    (tmp_path / f"{names[0]}.png").touch()
    lines = [f"{name}.png,{name}.npy,{names[0]}\n" for name in names]
    (tmp_path / "list.csv").write_text("".join(lines))
    values = {"kind": "csv_list", "file": f"{tmp_path}/list.csv", "intrinsics": [9, 9, 4, 4]}
    settings: Any = build(Scenes, values, "scenes")
    frames = open_reader(settings).discover().frames
    assert len({ref.frame for ref in frames}) == 2
    assert max(len(ref.frame) for ref in frames) <= 96
    assert max(len(ref.scene) for ref in frames) <= 96


def test_float_millimetres_are_named_and_depth_scale_corrects_them(tmp_path: Path) -> None:
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
    actual = reader("flsea", tmp_path).discover()
    assert [ref.name for ref in actual.frames] == [
        "canyons/flatiron/9",
        "canyons/u_canyon/1",
        "canyons/u_canyon/2",
        "red_sea/sub_pier/5",
    ]
    assert actual.skipped == {"depth map without an image": 1, "image without a depth map": 1}
    assert actual.notes[0] == "FLSea: 3 of 12 scenes"
    assert "horse_canyon, tiny_canyon, big_dice_loop" in actual.notes[1]
    assert "u_canyon" not in actual.notes[1]
    for ref in actual.frames:
        frame = reader("flsea", tmp_path).load(pickle.loads(pickle.dumps(ref)))
        np.testing.assert_array_equal(frame.rgb, RGB)
        np.testing.assert_array_equal(frame.depth_m, DEPTH)


@pytest.mark.parametrize("start", ["", "canyons", "canyons/u_canyon", "canyons/u_canyon/u_canyon"])
def test_flsea_root_may_be_any_level(tmp_path: Path, start: str) -> None:
    flsea_frame(tmp_path / "canyons/u_canyon/u_canyon", "1")
    flsea = reader("flsea", tmp_path / start)
    actual = flsea.discover()
    assert [ref.name for ref in actual.frames] == ["canyons/u_canyon/1"]
    # The built-in calibration is for 968x608, the image has 24x16 pixels.
    camera = flsea.load(actual.frames[0]).intrinsics
    known = BUILT_IN["canyons"]
    assert (camera.fx, camera.fy) == pytest.approx((known.fx * 24 / 968, known.fy * 16 / 608))
    assert camera.distortion == known.distortion


def test_flsea_selects_scenes_by_name(tmp_path: Path) -> None:
    for scene in ("canyons/u_canyon", "canyons/flatiron", "red_sea/sub_pier"):
        flsea_frame(tmp_path / scene, "1")
    chosen = ["sub_pier", "u_canyon", "pier_path"]
    flsea = reader("flsea", tmp_path, scenes=chosen)
    assert names(flsea) == ["canyons/u_canyon/1", "red_sea/sub_pier/1"]
    assert flsea.discover().notes[1].endswith("left out: pier_path")
    with pytest.raises(FactoryError, match="pier_path"):
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
    actual = flsea.discover()
    assert len(actual.frames) == 6
    assert {ref.location for ref in actual.frames} == {"canyons", "red_sea"}
    for ref in actual.frames:
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


@settings(max_examples=20)
@given(st.sampled_from(sorted(samples())), st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_refused_and_never_half_read(
    tmp_path_factory: pytest.TempPathFactory, name: str, fraction: float
) -> None:
    data, expected = samples()[name]
    path = tmp_path_factory.mktemp("cut") / name
    path.write_bytes(data[: int(len(data) * fraction)])
    try:
        actual = read_file(path)
    except FrameError as error:
        actual = None
        fault = str(error)
    if actual is None:
        assert fault.startswith(str(path))
        assert "\n" not in fault
    else:  # only bytes after the last pixel were missing
        np.testing.assert_allclose(actual, expected, rtol=1e-7)


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


# --- formats of depth, marks for no measurement, orientation and size of images


def listed_frame(folder: Path, depth_file: Path, rgb: Array = RGB, **keys: object) -> Any:
    """The frame of a list of one image and one depth file."""
    write(folder / "colour.png", rgb)
    (folder / "list.csv").write_text(f"colour.png,{depth_file.name},s\n")
    listed = reader("csv_list", folder / "list.csv", **{"intrinsics": PINHOLE, **keys})
    return listed.load(listed.discover().frames[0])


def write_tiff(path: Path, array: Array, endian: Any = "<") -> Path:
    """An uncompressed TIFF of one strip, of whatever numbers the array has."""
    data = array.astype(array.dtype.newbyteorder(endian)).tobytes()
    height, width = array.shape[:2]
    channels = array.shape[2] if array.ndim == 3 else 1
    bits = 8 * array.dtype.itemsize
    kind = {"u": 1, "i": 2, "f": 3, "c": 6}[array.dtype.kind]
    tags = [(256, width), (257, height), (258, bits), (259, 1), (262, 1), (273, 8),
            (277, channels), (278, height), (279, len(data)), (339, kind)]  # fmt: skip
    directory = struct.pack(f"{endian}H", len(tags))
    directory += b"".join(struct.pack(f"{endian}HHII", tag, 4, 1, value) for tag, value in tags)
    head = (b"II*\0" if endian == "<" else b"MM\0*") + struct.pack(f"{endian}I", 8 + len(data))
    path.write_bytes(head + data + directory + bytes(4))
    return path


@pytest.mark.parametrize("endian", ["<", ">"])
def test_tiff_of_64_bit_floats_is_read(tmp_path: Path, endian: str) -> None:
    path = write_tiff(tmp_path / "depth.tif", DEPTH.astype(np.float64), endian)
    np.testing.assert_allclose(read_depth(path), DEPTH, rtol=1e-6)


def test_npy_of_one_channel_is_read(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", DEPTH[..., None].astype(np.float16))
    np.testing.assert_allclose(read_depth(tmp_path / "depth.npy"), DEPTH, rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("d.exr", b"\x76\x2f\x31\x01\x02\0\0\0" + bytes(90)),
        ("d.npz", b"PK\x03\x04" + bytes(90)),
        ("d.h5", b"\x89HDF\r\n\x1a\n" + bytes(90)),
        ("d.bin", b"24&16&1&" + bytes(90)),
    ],
)
def test_of_a_foreign_format_those_that_are_read_are_named(
    tmp_path: Path, name: str, content: bytes
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FrameError, match=r"no format that is read.*PNG or TIFF.*\.npy"):
        read_depth(tmp_path / name)
    half = write_tiff(tmp_path / "half.tif", DEPTH.astype(np.float16))
    with pytest.raises(FrameError, match=r"no format that is read.*32- or 64-bit floats"):
        read_depth(half)


MARKS = {
    "uint16": (np.rint(DEPTH * 1000).astype(np.uint16), 65535, None),
    "uint16 of another scale": (np.rint(DEPTH * 5000).astype(np.uint16), 65535, 5000.0),
    "int32": (np.rint(DEPTH * 1000).astype(np.int32), 2**31 - 1, None),
    "scaled to metres": (DEPTH, 65.535, None),
    "half floats": (DEPTH.astype(np.float16), 65504, None),
    "a sky": (DEPTH, 1e10, None),
}


@pytest.mark.parametrize("kind", MARKS)
def test_a_mark_for_no_measurement_is_no_wall(tmp_path: Path, kind: str) -> None:
    depth, mark, scale = MARKS[kind]
    depth = depth.copy()
    depth[:3] = mark
    np.save(tmp_path / "depth.npy", depth)
    keys: dict[str, Any] = {"depth_scale": scale}
    with pytest.raises(FrameError, match=r"19 % .*scenes\.invalid_above_m=") as caught:
        listed_frame(tmp_path, tmp_path / "depth.npy", **keys)
    limit_m = float(str(caught.value).partition("invalid_above_m=")[2].split()[0])
    frame = listed_frame(tmp_path, tmp_path / "depth.npy", **keys, invalid_above_m=limit_m)
    assert np.array_equal(frame.valid, np.arange(16)[:, None] >= 3 + 0 * DEPTH)


def test_single_far_pixels_and_flat_walls_are_read(tmp_path: Path) -> None:
    depth = np.full((16, 24), 3000, np.uint16)
    depth[2, 3] = 65535
    np.save(tmp_path / "depth.npy", depth)
    assert listed_frame(tmp_path, tmp_path / "depth.npy").depth_m[2, 3] == np.float32(65.535)
    np.save(tmp_path / "depth.npy", np.full((16, 24), 3, np.float32))
    assert (listed_frame(tmp_path, tmp_path / "depth.npy").depth_m == 3).all()


def test_a_map_of_negative_depths_is_told(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", -DEPTH)
    with pytest.raises(FrameError, match=r"384 depths are negative"):
        listed_frame(tmp_path, tmp_path / "depth.npy")


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_images_are_turned_upright(tmp_path: Path, orientation: int, suffix: str) -> None:
    upright = np.repeat(np.repeat(RGB[::8, ::8] // 2 + 60, 8, axis=0), 8, axis=1)
    turns: dict[int, Any] = {
              1: lambda a: a, 2: np.fliplr, 3: lambda a: np.rot90(a, 2), 4: np.flipud,
              5: lambda a: a.transpose(1, 0, 2), 6: np.rot90,
              7: lambda a: np.rot90(a, 2).transpose(1, 0, 2),
              8: lambda a: np.rot90(a, -1)}  # fmt: skip
    undone = turns[orientation](upright)
    exif = Image.Exif()
    exif[274] = orientation
    path = tmp_path / f"image.{suffix}"
    options: dict[str, Any] = {
        "jpg": {"quality": 100, "subsampling": 0},
        "webp": {"lossless": True},
    }
    image = Image.fromarray(np.ascontiguousarray(undone))
    image.save(path, exif=exif, **options.get(suffix, {}))
    assert np.abs(read_rgb(path).astype(int) - upright).max() <= 4
    assert image_size(path) == (24, 16)


@pytest.mark.parametrize(
    "intrinsics",
    [
        *([40, 40, 23.5, 15.5], [10, 10, 5.5, 3.5], [20 / 24, 20 / 16, 0.5, 0.5]),
        *([20, 20, 11.5, 16], [20, 20, -3, 7.5]),
    ],
)
def test_intrinsics_of_another_size_are_refused(tmp_path: Path, intrinsics: list[float]) -> None:
    np.save(tmp_path / "depth.npy", DEPTH)
    with pytest.raises(FactoryError, match=r"^scenes\.intrinsics: principal point .*24x16"):
        listed_frame(tmp_path, tmp_path / "depth.npy", intrinsics=intrinsics)


@settings(max_examples=50)
@given(st.floats(0.31, 0.79), st.floats(0.31, 0.79))
def test_intrinsics_near_the_middle_are_taken(across: float, down: float) -> None:
    assert Intrinsics(500, 480, across * 640, down * 480).misfit(640, 480) is None


@pytest.mark.parametrize("focal", [0.0, -140.0, float("nan"), float("inf")])
def test_a_focal_length_is_a_positive_number(focal: float) -> None:
    frame = Frame(FrameRef("", "", "one"), RGB, DEPTH, Intrinsics(focal, 20, 11.5, 7.5))
    with pytest.raises(FrameError, match="focal lengths"):
        checked(frame)


def test_images_of_two_sizes_need_two_lists(tmp_path: Path) -> None:
    write(tmp_path / "1.png", RGB)
    write(tmp_path / "2.png", RGB[::2, ::2])
    np.save(tmp_path / "1.npy", DEPTH)
    np.save(tmp_path / "2.npy", DEPTH[::2, ::2])
    (tmp_path / "list.csv").write_text("1.png,1.npy\n2.png,2.npy\n")
    with pytest.raises(FactoryError, match=r"24x16 .*1\.png.*12x8 .*2\.png.*list"):
        reader("csv_list", tmp_path / "list.csv", intrinsics=PINHOLE).discover()


def test_two_frames_are_equal_only_if_their_files_are(tmp_path: Path) -> None:
    rows = ["a/b-1.png,1.npy", "a-b/1.png,2.npy", "a-b/1.jpg,3.npy", "a-b/1.png,4.npy",
            "./a-b/1.png,2.npy", "b/1.png,1.npy"]  # fmt: skip
    (tmp_path / "list.csv").write_text("\n".join(rows))
    write(tmp_path / "b/1.png", RGB)
    actual = reader("csv_list", tmp_path / "list.csv", intrinsics=PINHOLE).discover()
    assert len({ref.name for ref in actual.frames}) == 5
    assert len({ref.paths for ref in actual.frames}) == 5
    assert actual.skipped == {"listed twice": 1}


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
