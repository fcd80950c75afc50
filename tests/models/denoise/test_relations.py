"""Relations that hold for any recording, on those that ship: no truth is needed.

A recording that is changed in a way that does not matter must come out changed in the same way.
Tolerances are parts of what denoising changes, each with its reason.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

import simnfnd
from simnfnd.factory.common.array_types import Array
from simnfnd.models.denoise import options
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.device_settings import RecordedSettings
from tests.models.denoise.untrained import Halving
from tests.models.recordings.video_files import encode
from tests.project_files import ROOT

WINDOW = 3
EXAMPLES = {
    "lamprey": ("didson/lamprey.avi", 7, np.s_[330:426, 150:246]),
    "aris": ("aris/sample.aris", 5, np.s_[500:596, :]),
    "oculus": ("oculus/three_pings_8bit.raw", 3, np.s_[300:396, 60:156]),
}
every = pytest.mark.parametrize("name", EXAMPLES)


@cache
def recorded(name: str) -> Array:
    """A part of a recording that ships, (frames, rows, columns) uint8."""
    file, count, part = EXAMPLES[name]
    with open_recording(ROOT / "examples" / file) as recording:
        frames = [recording[number].samples[part] for number in range(count)]
    result: Array = np.stack(frames)
    result.setflags(write=False)
    return result


def smoothing(grey: Any, geometry: object = None) -> Any:
    """A network of which the relations hold exactly."""
    return cv2.GaussianBlur(grey, (0, 0), 1.0)


def denoised(
    frames: Array,
    settings: list[RecordedSettings] | None = None,
    *,
    at_once: int = 1,
    **options: Any,
) -> Array:
    denoising = Denoising(smoothing, frames=WINDOW, **options)
    sequence = denoising.open_sequence(at_once=at_once)
    shots = (
        denoising.shot(
            number, frame, lambda _: None, settings=None if settings is None else settings[number]
        )
        for number, frame in enumerate(frames)
    )
    return np.stack([result.image for result in sequence.run(shots)])


@cache
def plain(name: str) -> Array:
    return denoised(recorded(name))


def difference(result: Array, expected: Array, noisy: Array) -> float:
    """Mean difference, as part of what denoising changes."""
    changed = np.abs(expected.astype(float) - noisy).mean()
    return float(np.abs(result.astype(float) - expected).mean() / changed)


@pytest.mark.parametrize("name", ["aris", "oculus"])
def test_interleaved_with_another_one_by_settings(name: str) -> None:
    """Exactly: each kind has a stream of its own."""
    first = recorded(name)
    second = first[::-1, ::-1]
    both = np.stack([first, second], axis=1).reshape(-1, *first.shape[1:])
    settings = [RecordedSettings(gain_db=10.0), RecordedSettings(gain_db=20.0)] * len(first)
    result = denoised(both, settings)
    np.testing.assert_array_equal(result[::2], plain(name))
    np.testing.assert_array_equal(result[1::2], denoised(second))


@pytest.mark.parametrize("name", ["lamprey", "aris"])
def test_interleaved_with_another_one_untold(name: str) -> None:
    """Exactly, as the scenes are unlike."""
    first = recorded(name)
    second = first[:, ::-1]
    both = np.stack([first, second], axis=1).reshape(-1, *first.shape[1:])
    np.testing.assert_array_equal(denoised(both)[::2], plain(name))


@pytest.mark.parametrize(("name", "gain"), [("lamprey", 0.5), ("aris", 0.8), ("oculus", 0.6)])
def test_a_gain_on_all_frames(name: str, gain: float) -> None:
    """Tolerance: noise is measured in classes of grey value, which the gain moves."""
    frames = recorded(name).astype(np.float32) / 255
    expected = denoised(frames)
    assert difference(denoised(frames * np.float32(gain)) / gain, expected, frames) < 0.12


@every
def test_more_bits(name: str) -> None:
    """Tolerance: half a level of 8 bits is rounded, and of 10 bits in 16 half a level, too."""
    frames = recorded(name)
    deep = denoised(frames.astype(np.uint16) * 257)
    np.testing.assert_allclose(deep / 257, plain(name), atol=0.51)
    ten = denoised(frames.astype(np.uint16) * 4)
    assert difference(ten / 4, deep / 257, frames) < 0.12


@pytest.mark.parametrize("name", ["lamprey", "aris"])
def test_repeated_frames(name: str) -> None:
    """Exactly: copies are left out."""
    result = denoised(np.repeat(recorded(name), 2, axis=0))
    for copy in range(2):
        np.testing.assert_array_equal(result[copy::2], plain(name))


@every
def test_mirrored(name: str) -> None:
    """Tolerance: noise is measured on every third pixel from the left."""
    frames = recorded(name)
    result = denoised(frames[:, :, ::-1])[:, :, ::-1]
    assert difference(result, plain(name), frames) < 0.12


@every
def test_reversed_in_time(name: str) -> None:
    """Tolerance: noise and strength are measured as the frames come."""
    frames = recorded(name)
    result = denoised(frames[::-1])[::-1]
    assert difference(result, plain(name), frames) < 0.2


@pytest.mark.parametrize("name", ["lamprey", "oculus"])
def test_a_crop_away_from_its_border(name: str) -> None:
    """Tolerance: noise and strength are measured on fewer pixels."""
    frames = recorded(name)
    result = denoised(frames[:, 8:-8, 8:-8])[:, 16:-16, 16:-16]
    inner = np.s_[:, 24:-24, 24:-24]
    assert difference(result, plain(name)[inner], frames[inner]) < 0.2


def test_more_threads() -> None:
    """Exactly."""
    np.testing.assert_array_equal(denoised(recorded("aris"), at_once=4), plain("aris"))


def test_cut_in_two() -> None:
    """Tolerance: noise and strength are measured on fewer frames, those beside the cut are left."""
    frames = recorded("lamprey")
    first = denoised(frames[:5])[:3]
    second = denoised(frames[2:])[-3:]
    assert difference(first, plain("lamprey")[:3], frames[:3]) < 0.2
    assert difference(second, plain("lamprey")[-3:], frames[-3:]) < 0.2


@pytest.mark.parametrize("strength", [0.3, 0.999])
def test_a_part_of_the_strength(strength: float) -> None:
    """Tolerance: half a grey value is rounded."""
    frames = recorded("aris")
    expected = frames + strength * (plain("aris").astype(float) - frames)
    np.testing.assert_allclose(denoised(frames, strength=strength), expected, atol=1.01)


def test_api_command_and_files_agree(tmp_path: Path, halving: Halving) -> None:
    """Exactly: each holds the same pixels without loss."""
    frames = recorded("lamprey")[:4]
    (tmp_path / "shots").mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(str(tmp_path / "shots" / f"{number:02d}.png"), frame)
    np.save(tmp_path / "a.npy", frames)
    tifffile.imwrite(tmp_path / "b.tif", frames, photometric="minisblack")
    encode(tmp_path / "c.mkv", frames)
    expected = denoised_by_halving(frames)
    words = ["--frames", str(WINDOW), "--geometry", "none"]
    for name in ("a.npy", "b.tif", "c.mkv", "shots"):
        out = tmp_path / "out" / name
        assert options.main([str(tmp_path / name), "--out", str(out), *words]) == 0
        with open_recording(out if name == "shots" else out / name) as result:
            np.testing.assert_array_equal([frame.samples for frame in result], expected)


def denoised_by_halving(frames: Array) -> Array:
    denoising = Denoising(Halving(), frames=WINDOW)
    shots = (denoising.shot(n, frame, lambda _: None) for n, frame in enumerate(frames))
    return np.stack([result.image for result in denoising.sequence(shots)])


def test_the_api_equals_the_command(tmp_path: Path) -> None:
    """Exactly, with the weights that ship."""
    frames = recorded("lamprey")[:3, :64, :64]
    np.save(tmp_path / "a.npy", frames)
    words = [str(tmp_path / "a.npy"), "--out", str(tmp_path / "out"), "--frames", "3"]
    assert options.main([*words, "--geometry", "none"]) == 0
    result = simnfnd.denoise(frames, frames=3, geometry=None)
    np.testing.assert_array_equal(np.load(tmp_path / "out" / "a.npy"), result)
