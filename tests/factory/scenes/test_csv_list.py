"""The reader of CSV lists, and the units of depth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.scenes import Scenes, open_reader
from simnfnd.factory.settings import build
from tests.factory.scenes.scene_files import DEPTH, PINHOLE, RGB, reader, write

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
