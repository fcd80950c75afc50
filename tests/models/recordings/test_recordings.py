"""Readers of recordings: every format from small files that the tests write, and from real ones."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.models.recordings import is_recording, kind_of, open_recording
from simnfnd.models.recordings.base import Beams
from simnfnd.models.recordings.images import read_image
from simnfnd.models.recordings.sonar_files import ArisFile, beam_centres_deg
from simnfnd.models.recordings.views import fan_of, frame_image, grey_of, polar_geometry
from tests.models.recordings.recording_files import (
    DATA,
    pings,
    write_aris,
    write_ddf,
    write_log,
    write_oculus,
    write_stack,
    write_video,
)


@pytest.mark.parametrize("beams", [48, 96, 64, 128])
def test_aris(tmp_path: Path, beams: int) -> None:
    samples = pings(3, 20, beams)
    with open_recording(write_aris(tmp_path / "a.aris", samples)) as recording:
        assert len(recording) == 3
        assert not recording.warning
        assert [frame.number for frame in recording] == [0, 1, 2]
        frame = recording[2]
        with pytest.raises(IndexError):
            recording[3]
    assert np.array_equal(frame.samples, samples[2])
    assert frame.beams is not None
    # 2667 us there and back at 1500 m/s, then 20 samples of 20 us.
    assert frame.beams.range_min_m == pytest.approx(2667e-6 * 750)
    assert frame.beams.range_max_m == pytest.approx((2667 + 400) * 1e-6 * 750)
    assert np.all(np.diff(frame.beams.azimuths_rad) > 0)
    assert math.degrees(frame.beams.azimuths_rad[-1]) == pytest.approx(14.3, abs=0.8)
    assert frame.time_s == pytest.approx(1_700_000_000.2)
    assert (frame.pose.heading_deg, frame.pose.depth_m, frame.pose.pan_deg) == (123.0, 4.5, 15.0)
    assert frame.device.name == ("ARIS 3000" if beams in (64, 128) else "ARIS 1800")
    assert (frame.device.sound_speed_m_s, frame.device.gain_db) == (1500.0, 20.0)
    assert frame.device.serial_number == 1234


def test_beam_tables_are_those_of_the_sdk() -> None:
    for name, centres in beam_centres_deg().items():
        assert len(centres) == int(name.split("_")[1])
        assert all(left < right for left, right in pairwise(centres))
    folder = DATA / "aris-sdk"
    if folder.is_dir():
        text = (folder / "BeamWidths_ARIS3000_128.h").read_text()
        rows = [line.split(",") for line in text.splitlines() if line.startswith("DEFINE")]
        assert [float(row[1]) for row in rows] == list(beam_centres_deg()["3000_128"])


def test_aris_with_samples_in_the_order_of_the_device(tmp_path: Path) -> None:
    recording = open_recording(write_aris(tmp_path / "a.aris", pings(1, 9, 48), offset_516=0))
    with pytest.raises(FrameError, match="order of the device"):
        recording[0]


def test_aris_with_other_samples(tmp_path: Path) -> None:
    samples = pings(3, 20, 64)
    source = ArisFile(write_aris(tmp_path / "a.aris", samples))
    source.rewrite([255 - frame for frame in samples], tmp_path / "b.aris")
    again = open_recording(tmp_path / "b.aris")
    assert [np.array_equal(frame.samples, 255 - samples[frame.number]) for frame in again] == [
        True
    ] * 3
    assert again[1].beams == source[1].beams
    assert again[1].time_s == source[1].time_s
    before = (tmp_path / "a.aris").read_bytes()
    after = (tmp_path / "b.aris").read_bytes()
    assert before[:2048] == after[:2048]
    assert len(before) == len(after)
    source.rewrite(samples, tmp_path / "c.aris")
    assert (tmp_path / "c.aris").read_bytes() == before
    for wrong in (samples[:2], samples.astype(np.uint16), samples[:, :5]):
        with pytest.raises(ValueError, match=r"shorter|samples are"):
            source.rewrite(wrong, tmp_path / "d.aris")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.aris", "b.aris", "c.aris"]


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("reverse", [False, True])
def test_ddf(tmp_path: Path, version: int, reverse: bool) -> None:
    samples = pings(2, 512, 96)
    path = write_ddf(tmp_path / "a.ddf", samples, version=version, reverse=reverse)
    with open_recording(path) as recording:
        assert len(recording) == 2
        frame = recording[1]
    assert np.array_equal(frame.samples, samples[1])
    assert frame.beams is not None
    assert np.all(np.diff(frame.beams.azimuths_rad) > 0)
    # The maker's sector is 28.8 degrees wide, its 96 beams 0.3 each.
    assert math.degrees(frame.beams.azimuths_rad[-1]) == pytest.approx(14.25, abs=0.1)
    assert frame.time_s == 1308141046.25  # 2011-06-15 12:30:46.25 UTC
    assert frame.pose.heading_deg == 200.0
    assert frame.device.serial_number == 100


@pytest.mark.parametrize(
    ("serial", "high", "flags", "near_m", "length_m"),
    [
        (100, True, 0, 4 * 0.419, 5.0),
        (100, False, 0, 8 * 0.419, 20.0),
        (100, True, 1, 4 * 0.375, 4.5),
        (100, True, 2, 4 * 0.419, 10.0),
        (100, False, 3, 8 * 0.375, 36.0),
    ],
)
def test_window_of_a_ddf(
    tmp_path: Path, serial: int, high: bool, flags: int, near_m: float, length_m: float
) -> None:
    path = tmp_path / "a.ddf"
    write_ddf(path, pings(1, 30, 48), serial=serial, high=high, flags=flags)
    beams = open_recording(path)[0].beams
    assert beams is not None
    assert beams.range_min_m == pytest.approx(near_m)
    assert beams.range_max_m == pytest.approx(near_m + length_m)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("gains", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_oculus(tmp_path: Path, version: int, gains: bool, dtype: Any) -> None:
    samples = np.asarray(pings(3, 40, 16), dtype)
    samples *= 257 if dtype == np.uint16 else 1
    path = write_oculus(tmp_path / "a.raw", samples, version=version, gains=gains)
    with open_recording(path) as recording:
        assert len(recording) == 3
        frame = recording[1]
    assert frame.samples.dtype == dtype
    assert np.array_equal(frame.samples, samples[1])
    assert frame.beams is not None
    assert np.rad2deg(frame.beams.azimuths_rad)[[0, -1]] == pytest.approx([-30, 30])
    assert frame.beams.range_min_m == 0
    assert frame.beams.range_max_m == pytest.approx(0.8)
    assert frame.device.frequency_khz == 1200
    assert frame.device.sound_speed_m_s == 1490
    assert frame.pose.heading_deg == (90.0 if version == 2 else None)
    assert frame.time_s == (77.5 if version == 2 else None)


@pytest.mark.parametrize("code", [4, 6, 12])
def test_a_ddf_window_of_another_code_is_as_long_as_its_samples(tmp_path: Path, code: int) -> None:
    """512 samples at 48 kHz are 8 m; where the sonar's clock says nothing, the computer's does."""
    path = write_ddf(tmp_path / "a.ddf", pings(1, 512, 48), code=code, year=0)
    frame = open_recording(path)[0]
    assert frame.beams is not None
    assert frame.beams.range_max_m - frame.beams.range_min_m == pytest.approx(8.0)
    assert frame.time_s == 1.4e9


@pytest.mark.parametrize("packed", [False, True])
def test_a_log_of_viewpoint(tmp_path: Path, packed: bool) -> None:
    samples = pings(3, 40, 16)
    path = write_log(tmp_path / "a.oculus", samples, packed=packed)
    with open_recording(path) as recording:
        assert len(recording) == 3
        assert not recording.warning
        assert [frame.time_s for frame in recording] == [1.6e9, 1.6e9 + 1, 1.6e9 + 2]
        np.testing.assert_array_equal([frame.samples for frame in recording], samples)
    path.write_bytes(path.read_bytes()[:-7])
    with open_recording(path) as recording:
        assert len(recording) == 2
        assert "cut short" in recording.warning
    path.write_bytes(path.read_bytes()[:26] + b"\1" + path.read_bytes()[27:])
    with pytest.raises(FactoryError, match="is encrypted"):
        open_recording(path)


def test_video_and_images(tmp_path: Path) -> None:
    frames = np.repeat(np.linspace(20, 220, 5).astype(np.uint8), 48 * 64).reshape(5, 48, 64)
    with open_recording(write_video(tmp_path / "a.avi", frames)) as recording:
        assert len(recording) == 5
        order = [recording[number] for number in (3, 0, 4, 1)]
        read = [frame.samples for frame in recording]
    assert [frame.time_s for frame in order] == pytest.approx([0.3, 0, 0.4, 0.1])
    assert [frame.samples.shape for frame in order] == [(48, 64)] * 4
    assert np.abs(np.array(read).astype(int) - frames).max() <= 3
    assert abs(int(order[0].samples[5, 5]) - int(frames[3, 5, 5])) <= 3
    folder = tmp_path / "images"
    folder.mkdir()
    for name, image in (("b.png", frames[0]), ("a.tif", frames[1].astype(np.uint16) * 257)):
        assert cv2.imwrite(str(folder / name), image)
    (folder / "notes.txt").write_text("none")
    (folder / "c.png").write_bytes(b"no image")
    images = open_recording(folder)
    assert len(images) == 3
    assert images[0].samples.dtype == np.uint16
    assert np.array_equal(images[1].samples, frames[0])
    with pytest.raises(FrameError, match=r"c\.png: not a readable"):
        images[2]
    assert len(open_recording(folder / "b.png")) == 1


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_stack_of_pages(tmp_path: Path, dtype: Any) -> None:
    pages = pings(5, 30, 40).astype(dtype) / (255 if dtype is np.float32 else 1)
    path = write_stack(tmp_path / "a.tif", pages.astype(dtype))
    assert (kind_of(path), is_recording(path)) == ("stack", True)
    with open_recording(path) as recording:
        assert len(recording) == 5
        order = [recording[number].samples for number in (3, 0, 4)]
        assert [page.dtype for page in order] == [dtype] * 3
        for number, page in zip((3, 0, 4), order, strict=True):
            assert np.array_equal(page, pages[number].astype(dtype))


def test_pages_that_are_no_frames(tmp_path: Path) -> None:
    """A smaller copy behind an image; pages of another kind."""
    image = pings(1, 32, 40)[0]
    thumbnail = write_stack(tmp_path / "thumbnail.tif", [image, image[::4, ::4]])
    assert kind_of(thumbnail) == "images"
    assert np.array_equal(open_recording(thumbnail)[0].samples, image)
    for pages, words in (
        (np.full((2, 9, 9), 2, np.float32), r"page 1: floats must be grey values from 0 to 1"),
        (np.zeros((2, 9, 9), np.int32), "page 1: pixels are int32; expected uint8, "),
    ):
        path = write_stack(tmp_path / "a.tif", pages)
        with pytest.raises(FrameError, match=words), open_recording(path) as recording:
            list(recording)


def test_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("x")
    (tmp_path / "empty").mkdir()
    named = {"a.txt": "not a recording", "none.aris": "no such", "empty": "no image"}
    for name, words in named.items():
        with pytest.raises(FactoryError, match=words):
            open_recording(tmp_path / name)
    assert kind_of(tmp_path / "a.txt") is None
    write_aris(tmp_path / "a.ddf", pings(1, 9, 48))
    with pytest.raises(FactoryError, match=r"rename it to \.aris"):
        open_recording(tmp_path / "a.ddf")


def test_a_file_cut_short_gives_its_whole_frames_and_a_warning(tmp_path: Path) -> None:
    samples = pings(3, 20, 48)
    for path in (
        write_aris(tmp_path / "a.aris", samples),
        write_ddf(tmp_path / "a.ddf", samples),
        write_oculus(tmp_path / "a.raw", samples, others=False),
    ):
        content = path.read_bytes()
        path.write_bytes(content[:-7])
        recording = open_recording(path)
        assert len(recording) == 2
        assert str(path) in recording.warning
        assert np.array_equal(recording[1].samples, samples[1])
        path.write_bytes(content[:300])
        with pytest.raises(FactoryError, match="cut short"):
            open_recording(path)


def test_a_ping_as_a_fan() -> None:
    """An echo lies in the fan where its range and bearing say."""
    bearings = tuple(np.deg2rad(np.linspace(-20, 30, 64)).tolist())
    beams = Beams(bearings, 2.0, 10.0)
    samples = np.full((400, 64), 0.2, np.float32)
    samples[100, 50] = 1.0
    image, geometry = fan_of(samples, beams)
    assert image.shape[0] >= 400
    row, column = np.unravel_index(image.argmax(), image.shape)
    range_m = 2.0 + 8.0 * 100.5 / 400
    pixel = geometry.pixels(np.array(range_m / 10), np.array(bearings[50]))
    assert np.hypot(row - pixel[0], column - pixel[1]) < 3
    assert column > geometry.apex_x_px, "positive bearings are on the right"
    maps = geometry.maps(0, 0, *image.shape)
    assert not image[maps["sector"] == 0].any()
    assert image[maps["sector"] == 1].min() > 0.1
    assert np.rad2deg(maps["azimuth_rad"][maps["sector"] == 1].min()) > -21
    polar = polar_geometry(beams, 400)
    assert polar.maps(0, 0, 400, 64)["azimuth_rad"][0] == pytest.approx(bearings)


@pytest.mark.skipif(not (DATA / "aris-sdk").is_dir(), reason="no shared data")
def test_real_aris() -> None:
    with open_recording(DATA / "aris-sdk" / "sample.aris") as recording:
        frames = list(recording)
    assert len(frames) == 6
    assert frames[0].samples.shape == (2000, 48)
    beams = frames[0].beams
    assert beams is not None
    # The header says as much in fields that are not read: WindowStart 3.33 and WindowLength 20.3.
    assert beams.range_min_m == pytest.approx(3.33, abs=0.04)
    assert beams.range_max_m - beams.range_min_m == pytest.approx(20.3, abs=0.3)
    # The sound speed is the frame's own.
    assert frames[0].device.sound_speed_m_s == pytest.approx(1435.93, abs=0.01)
    assert beams.range_min_m == pytest.approx(4593e-6 * 1435.93 / 2, abs=1e-4)
    assert frames[0].device.name == "ARIS 1200"
    steps = np.diff([frame.time_s or 0.0 for frame in frames])
    assert steps == pytest.approx([0.153] * 5, abs=0.002)
    image, _ = fan_of(grey_of(frames[0]), beams)
    assert image[image > 0].mean() == pytest.approx(0.37, abs=0.15)


@pytest.mark.skipif(not (DATA / "oculus").is_dir(), reason="no shared data")
def test_real_oculus() -> None:
    with open_recording(DATA / "oculus" / "three_pings_8bit.raw") as recording:
        frames = list(recording)
    assert [frame.samples.shape for frame in frames] == [(703, 256)] * 3
    assert not recording.warning
    beams = frames[0].beams
    assert beams is not None
    assert np.rad2deg(beams.azimuths_rad)[[0, -1]] == pytest.approx([-30, 30])
    assert beams.range_max_m == pytest.approx(2.0, abs=0.01)
    assert frames[0].device.sound_speed_m_s == pytest.approx(1490.7, abs=0.1)
    # Neighbouring samples are alike only if rows and columns are where they should be.
    samples = frames[0].samples.astype(float)
    assert np.corrcoef(samples[:, 1:].ravel(), samples[:, :-1].ravel())[0, 1] > 0.6


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp", ".tif"])
@pytest.mark.parametrize("value", range(1, 9))
def test_the_orientation_of_exif_is_applied(tmp_path: Path, suffix: str, value: int) -> None:
    """Row 0 and column 0 of what is stored lie where TIFF 6.0 says for each value."""
    stored = np.zeros((24, 40), np.uint8)
    stored[2:9, 4:16] = 200
    upright = {
        1: stored,
        2: stored[:, ::-1],
        3: stored[::-1, ::-1],
        4: stored[::-1],
        5: stored.T,
        6: np.rot90(stored, -1),
        7: stored[::-1, ::-1].T,
        8: np.rot90(stored),
    }[value]
    tag = Image.Exif()
    tag[274] = value
    path = tmp_path / f"a{suffix}"
    Image.fromarray(stored).save(path, exif=tag, quality=100, lossless=True)
    actual = read_image(path)
    grey = actual if actual.ndim == 2 else actual[..., 0]
    assert np.abs(grey.astype(int) - upright).max() <= 2


@pytest.mark.parametrize("bits", [8, 10, 12, 14])
def test_samples_of_few_bits_in_16_are_as_bright_as_they_look(tmp_path: Path, bits: int) -> None:
    """A dark frame of a recording has the white of the others."""
    grey = np.random.default_rng(0).integers(0, 256, (3, 40, 30), dtype=np.uint8)
    grey[0] //= 5
    grey[1, 0, 0] = 255
    stored = grey.astype(np.uint16) << (bits - 8)
    np.save(tmp_path / "a.npy", stored)
    for number, frame in enumerate(grey):
        image, _ = frame_image(tmp_path / "a.npy", number)
        np.testing.assert_allclose(image, frame / 255, atol=0.005)
    assert cv2.imwrite(str(tmp_path / "a.png"), stored[1])
    np.testing.assert_allclose(frame_image(tmp_path / "a.png", 0)[0], grey[1] / 255, atol=0.005)
    full = grey.astype(np.uint16) * 257
    np.save(tmp_path / "full.npy", full)
    np.testing.assert_allclose(frame_image(tmp_path / "full.npy", 0)[0], grey[0] / 255, atol=0.005)
