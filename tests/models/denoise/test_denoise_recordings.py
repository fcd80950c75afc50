"""`simnfnd denoise` on recordings of sonars, and on images whose fan it finds itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.files import space
from simnfnd.models.recordings import open_recording
from tests.models.denoise.untrained import Halving, main, results_in
from tests.models.recordings.fan_images import fan, preset
from tests.models.recordings.recording_files import (
    pings,
    write_aris,
    write_array,
    write_ddf,
    write_oculus,
    write_stack,
)


def test_an_aris_recording_becomes_one(tmp_path: Path, halving: Halving) -> None:
    samples = pings(3, 40, 48)
    write_aris(tmp_path / "a.aris", samples)
    out = tmp_path / "out"
    assert main([str(tmp_path / "a.aris"), "--out", str(out), "--compare"]) == 0
    with open_recording(out / "a.aris") as after, open_recording(tmp_path / "a.aris") as before:
        assert len(after) == 3
        for old, new in zip(before, after, strict=True):
            assert np.abs(new.samples - old.samples / 2).max() <= 0.5
            assert (new.beams, new.time_s, new.pose) == (old.beams, old.time_s, old.pose)
    geometry = halving.geometries[0]
    assert geometry is not None
    assert (geometry.layout, geometry.range_bins, len(geometry.beam_azimuths_rad)) == (
        "polar",
        40,
        48,
    )
    assert geometry.range_min_m == pytest.approx(2.0, abs=0.01)
    assert (out / "compare" / "a.aris.png").is_file()
    assert results_in(out) == ["a.aris", "compare"]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_stacks_and_arrays_become_the_same(tmp_path: Path, halving: Halving, dtype: Any) -> None:
    """All of their frames, grey or in colours; tables beside them are left alone."""
    full = 1 if dtype is np.uint8 else 257 if dtype is np.uint16 else 1 / 255
    samples = (pings(3, 41, 48) * float(full)).astype(dtype)
    coloured = np.stack(list(samples), axis=-1)
    arrays = {"one": samples[0], "several": samples, "colours": coloured, "first": samples[:1]}
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    np.save(tmp_path / "poses.npy", np.zeros((3, 4, 4)))
    write_stack(tmp_path / "a.tif", samples)
    write_stack(tmp_path / "page.tif", samples[:1])
    out = tmp_path / "out"
    assert main([str(tmp_path), "--out", str(out), "--compare"]) == 0
    assert {Path(name).stem for name in results_in(out)} == {*arrays, "a", "page", "compare"}
    for name, array in arrays.items():
        actual = np.load(out / f"{name}.npy")
        assert (actual.dtype, actual.shape) == (dtype, array.shape)
        assert np.abs(actual - array / 2.0).max() <= 0.5
    with open_recording(out / "a.tif") as after:
        pages = np.array([frame.samples for frame in after])
    assert pages.dtype == dtype
    assert np.abs(pages - samples / 2.0).max() <= 0.5
    assert (out / "compare" / "a.tif.png").is_file()


@pytest.mark.parametrize("name", ["a.npz", "b.mat"])
def test_arrays_in_files_of_several(tmp_path: Path, halving: Halving, name: str) -> None:
    """The images come back as a .npy file."""
    samples = pings(5, 41, 48)
    folder = tmp_path / "in"
    folder.mkdir()
    write_array(folder / name, samples, poses=np.zeros((5, 4, 4)))
    write_array(folder / f"z{name}", np.zeros((5, 4, 4)))
    out = tmp_path / "out"
    assert main([str(folder), "--out", str(out)]) == 0
    assert results_in(out) == [f"{name[0]}.npy"]
    actual = np.load(out / f"{name[0]}.npy")
    assert np.abs(actual - samples / 2.0).max() <= 0.5


def test_a_webp_image_is_written_without_loss(tmp_path: Path, halving: Halving) -> None:
    image = pings(1, 41, 48)[0]
    assert cv2.imwrite(str(tmp_path / "a.webp"), image, [cv2.IMWRITE_WEBP_QUALITY, 101])
    assert main([str(tmp_path / "a.webp"), "--out", str(tmp_path / "out")]) == 0
    actual = cv2.imread(str(tmp_path / "out" / "a.webp"), cv2.IMREAD_GRAYSCALE)
    assert np.abs(actual - image / 2.0).max() <= 0.5


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pings_become_fans_and_samples(tmp_path: Path, halving: Halving, dtype: Any) -> None:
    samples = pings(2, 60, 32).astype(dtype)
    write_oculus(tmp_path / "a.raw", samples)
    write_ddf(tmp_path / "b.ddf", pings(2, 60, 48))
    out = tmp_path / "out"
    assert main([str(tmp_path), "--out", str(out)]) == 0
    names = ["000000.png", "000000_polar.png", "000001.png", "000001_polar.png"]
    for name in ("a.raw", "b.ddf"):
        assert sorted(path.name for path in (out / name).iterdir()) == names
    polar = cv2.imread(str(out / "a.raw" / "000001_polar.png"), cv2.IMREAD_UNCHANGED)
    assert polar is not None
    assert polar.dtype == dtype
    assert np.abs(polar - samples[1] / 2).max() <= 0.5
    shown = cv2.imread(str(out / "a.raw" / "000001.png"), cv2.IMREAD_UNCHANGED)
    assert shown is not None
    assert shown.dtype == dtype
    assert shown.shape[0] >= 60
    assert not shown[0, 0]
    assert len(halving.geometries) == 4


def test_fans_are_found_unless_told_not_to(
    tmp_path: Path, halving: Halving, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "in"
    (folder / "deep").mkdir(parents=True)
    grey, true = fan(preset("didson_hf", 300, 500), 0.2, False)
    for name in ("a.png", "b.png", "deep/c.png"):
        assert cv2.imwrite(str(folder / name), grey)
    assert cv2.imwrite(str(folder / "plain.png"), np.full((50, 60), 80, np.uint8))
    arguments = [str(folder), "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert f"geometry: fan found in 2 of 3 images ({folder})" in said
    assert f"geometry: fan found in 1 of 1 images ({folder / 'deep' / 'c.png'})" in said
    actual = [message for message in halving.geometries if message is not None]
    assert len(actual) == 3
    assert actual[0].apex_y_px == pytest.approx(true.apex_y_px, abs=2)
    halving.geometries.clear()
    assert main([*arguments, "--geometry", "none"]) == 0
    assert halving.geometries == [None] * 4
    assert "geometry" not in capsys.readouterr().out
    assert main([*arguments, "--geometry", "polar", "--opening", "120"]) == 0
    assert "--opening" not in capsys.readouterr().out
    (opening_rad,) = {g.sector_rad for g in halving.geometries if g is not None}
    assert opening_rad == pytest.approx(np.deg2rad(120))
    assert main([*arguments, "--geometry", "polar"]) == 0
    assert "30 degrees; --opening" in capsys.readouterr().out
    assert {geometry.layout for geometry in halving.geometries if geometry is not None} == {"polar"}


def test_damaged_recordings_are_skipped(
    tmp_path: Path, halving: Halving, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    write_aris(folder / "a.aris", pings(2, 20, 48))
    whole = (folder / "a.aris").read_bytes()
    (folder / "b.aris").write_bytes(whole[:-9])
    (folder / "c.aris").write_bytes(whole[:1500])
    (folder / "d.aris").write_bytes(whole.replace(b"DDF\5", b"DDF\5", 1)[:-1000] + bytes(1000))
    out = tmp_path / "out"
    assert main([str(folder), "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "warning: " in said
    assert "b.aris: ends within frame 1" in said
    assert "skipped: " in said
    assert "c.aris" in said
    assert results_in(out) == ["a.aris", "b.aris", "d.aris"]


def test_what_a_killed_run_left_of_pings_goes_with_the_next(
    tmp_path: Path, halving: Halving
) -> None:
    write_ddf(tmp_path / "a.ddf", pings(2, 40, 48))
    folder = tmp_path / "out" / "a.ddf"
    folder.mkdir(parents=True)
    half = f".000001.png.{space()}-99999999-0123456789abcdef.tmp"
    for name in ("000007.png", "000007_polar.png", half, "notes.txt"):
        (folder / name).touch()
    assert main([str(tmp_path / "a.ddf"), "--out", str(tmp_path / "out")]) == 0
    images = [f"00000{number}{kind}.png" for number in range(2) for kind in ("", "_polar")]
    assert sorted(path.name for path in folder.iterdir()) == sorted([*images, "notes.txt"])
