"""The removed signal: grain raises no alarm, an erased target does, and is found."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import simnfnd
from simnfnd.factory.common.array_types import Array, Float32s
from simnfnd.models.denoise.removed import Removed, RemovedReport
from simnfnd.models.recordings import open_recording
from tests.models.denoise.untrained import Halving, main

LAMPREY2 = Path(__file__).parents[4] / "shared/data/didson/lamprey2.avi"
SIDE = 256


def scene() -> Array:
    """Brighter to the right, with one step across."""
    levels = np.tile(np.linspace(0.15, 0.4, SIDE, dtype=np.float32), (SIDE, 1))
    levels[SIDE // 2 :] *= 1.5
    return levels


def grain(seed: int, *, width_px: float = 0.5) -> Array:
    """Correlated Rayleigh speckle, 0 on average, of standard deviation 1."""
    speckle: Array = np.random.default_rng(seed).rayleigh(size=(SIDE, SIDE)).astype(np.float32)
    speckle = cv2.GaussianBlur(speckle, (0, 0), width_px, sigmaY=2 * width_px)
    return np.asarray((speckle - speckle.mean()) / speckle.std())


def ellipse(shape: tuple[int, ...], row: float, column: float) -> Array:
    """A soft ellipse with semi-axes of 4 and 10 pixels, in 0..1."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    inside = np.exp(-((((rows - row) / 4) ** 2 + ((columns - column) / 10) ** 2) ** 2))
    return np.asarray(inside, np.float32)


def report_of(pairs: list[tuple[Array, Array]]) -> tuple[RemovedReport, str]:
    report = RemovedReport()
    for number, (noisy, denoised) in enumerate(pairs):
        report.add(f"frame {number}", Removed(noisy, denoised).structure)
    (line,) = report.summary()
    return report, line


def test_grain_alone_raises_no_alarm() -> None:
    clean = scene()
    pairs = [(clean * (1 + 0.25 * grain(seed)), clean) for seed in range(12)]
    report, line = report_of(pairs)
    assert "no structure found" in line
    for noisy, denoised in pairs:
        structure = Removed(noisy, denoised).structure
        assert structure is not None
        assert abs(structure.deviation) < report.limit()
        assert structure.share < 0.02


@pytest.mark.parametrize(("contrast", "kind"), [(3.0, "an echo"), (-3.0, "a shadow")])
def test_an_erased_target_is_found_where_it_was(contrast: float, kind: str) -> None:
    clean = scene()
    pairs = [(clean * (1 + 0.25 * grain(seed)), clean) for seed in range(6)]
    noisy = pairs[4][0] + contrast * 0.25 * clean * ellipse(clean.shape, 90, 70)
    pairs[4] = noisy, clean
    _, line = report_of(pairs)
    assert f"structure in 1 of 6 images; most suspicious: {kind} in frame 4, row" in line
    structure = Removed(*pairs[4]).structure
    assert structure is not None
    assert np.hypot(structure.row - 90, structure.column - 70) < 10
    assert structure.share > 0.02


def test_a_target_that_was_kept_raises_no_alarm() -> None:
    clean = scene()
    target = 0.75 * clean * ellipse(clean.shape, 90, 70)
    noisy = clean * (1 + 0.25 * grain(0)) + target
    assert "no structure found" in report_of([(noisy, clean + target)])[1]


def test_the_signal_counts_in_standard_deviations_of_the_grain() -> None:
    clean = np.full((SIDE, SIDE), 0.4, np.float32)
    clean[:, : SIDE // 2] = 0
    noisy = clean * (1 + 0.1 * grain(1, width_px=0.3))
    signal = Removed(noisy, clean).signal
    assert (signal[:, : SIDE // 2 - 16] == 0).all(), "where nothing was insonified"
    right = signal[:, SIDE // 2 + 16 :]
    assert right.std() == pytest.approx(1, abs=0.1)
    assert np.corrcoef(right.ravel(), (noisy - clean)[:, SIDE // 2 + 16 :].ravel())[0, 1] > 0.95


@pytest.mark.parametrize("shape", [(1, 1), (20, 20), (64, 64)])
def test_black_and_tiny_images_are_not_judged(shape: tuple[int, int]) -> None:
    black = np.zeros(shape, np.float32)
    removed = Removed(black, black)
    assert removed.structure is None
    assert not removed.signal.any()
    assert list(RemovedReport().summary()) == []


@pytest.mark.skipif(not LAMPREY2.is_file(), reason="no real recordings here")
def test_a_target_erased_from_a_real_recording_is_found() -> None:
    """The mean over time stands for a denoiser that removes whatever moves."""
    with open_recording(LAMPREY2) as recording:
        frames = [frame.samples[60:420].astype(np.float32) / 255 for frame in recording][:16]
    frames = [frame if frame.ndim == 2 else frame.mean(axis=2) for frame in frames]
    mean = np.mean(frames, axis=0)
    pairs: list[tuple[Array, Array]] = [(frame, mean) for frame in frames]
    assert "no structure found" in report_of(pairs)[1]

    spread: Float32s = np.std(frames, axis=0)
    row, column = 300, 130
    pairs[7] = frames[7] + 4 * spread * ellipse(mean.shape, row, column), mean
    _, line = report_of(pairs)
    assert "structure in 1 of 16 images; most suspicious: an echo in frame 7, row" in line
    structure = Removed(*pairs[7]).structure
    assert structure is not None
    assert np.hypot(structure.row - row, structure.column - column) < 12


def test_the_command_closes_with_what_was_removed(
    tmp_path: Path, halving: Halving, capsys: pytest.CaptureFixture[str]
) -> None:
    noisy = np.rint(255 * np.clip(scene() * (1 + 0.25 * grain(0)), 0, 1)).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "a.png"), noisy)
    assert main([str(tmp_path / "a.png"), "--out", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("removed: ") and "a.png, row" in line]


def test_python_returns_the_removed_signal_on_request() -> None:
    stack = np.stack([np.clip(scene() * (1 + 0.25 * grain(seed)), 0, 1) for seed in range(2)])
    image, removed = simnfnd.denoise(stack, frames=1, geometry=None, return_removed=True)
    np.testing.assert_array_equal(image, simnfnd.denoise(stack, frames=1, geometry=None))
    assert removed.shape == stack.shape
    assert removed.dtype == np.dtype(np.float32)
    assert np.corrcoef(removed.ravel(), (stack - image).ravel())[0, 1] > 0.9
    single = simnfnd.denoise(stack[0], geometry=None, return_removed=True)
    np.testing.assert_array_equal(single.removed, removed[0])
