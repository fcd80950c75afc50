"""The reader of FLSea on real frames and on small trees."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.scenes.flsea import BUILT_IN, SCENES
from tests.factory.scenes.scene_files import (
    DEPTH,
    RGB,
    Array,
    flsea_frame,
    names,
    reader,
    write,
)
from tests.project_files import ROOT

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
