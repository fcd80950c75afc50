"""Groups of nearly static frames: found in a shuffled folder, registered, and judged by."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.evaluation.real.judge import score
from simnfnd.models.recordings.static import (
    aligned,
    find_groups,
    moving,
    references,
    shift_px,
)

Gray = npt.NDArray[np.float32]
SHAPE = (240, 160)
SECTOR = np.ones(SHAPE, bool)
SECTOR[:, :8] = SECTOR[:, -8:] = False


def scene(seed: int) -> Gray:
    """Blobs of several sizes on a grey floor, wider than a frame."""
    rng = np.random.default_rng(seed)
    wide = rng.normal(0, 1, (SHAPE[0] + 40, SHAPE[1] + 40)).astype(np.float32)
    found = np.asarray(sum(size * cv2.GaussianBlur(wide, (0, 0), size) for size in (2.5, 5.0)))
    return np.asarray(np.clip(0.45 + 0.2 * found / found.std(), 0, 1), np.float32)


def frame(of: Gray, shift: tuple[float, float], rng: np.random.Generator, noise: float) -> Gray:
    """The scene lies `shift` pixels right and down of the middle; black outside the sector."""
    matrix = np.array([[1, 0, 20 - shift[0]], [0, 1, 20 - shift[1]]], np.float64)
    seen = cv2.warpAffine(
        of, matrix, SHAPE[::-1], flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    ) + rng.normal(0, noise, SHAPE)
    return np.where(SECTOR, np.clip(seen, 0, 1), 0).astype(np.float32)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.7), (-2.25, 1.5)])
def test_a_shift_is_found_to_a_tenth_of_a_pixel(shift: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    fixed, moved = (frame(scene(0), one, rng, 0.06) for one in ((0.0, 0.0), shift))
    assert shift_px(fixed, moved, SECTOR) == pytest.approx(shift, abs=0.1)


def test_groups_are_found_in_a_shuffled_folder() -> None:
    rng = np.random.default_rng(2)
    frames, names = [], []
    for number, count in enumerate((7, 9, 3)):
        for _ in range(count):
            shift = (rng.uniform(-1, 1), rng.uniform(-1, 1))
            frames.append(frame(scene(number), shift, rng, 0.06))
            names.append(number)
    order = rng.permutation(len(frames))
    groups = find_groups([frames[i] for i in order], [SECTOR] * len(order), least=6)
    found = [sorted({names[order[i]] for i in group.numbers}) for group in groups]
    assert sorted(found) == [[0], [1]], "three frames are too few"
    assert sorted(len(group.numbers) for group in groups) == [7, 9]


def test_frames_that_moved_too_far_are_left_out() -> None:
    rng = np.random.default_rng(3)
    shifts = [(0.0, 0.0), (1.0, 0.0), (9.0, 0.0), (0.0, -1.0)]
    group = aligned([frame(scene(0), shift, rng, 0.03) for shift in shifts], SECTOR)
    assert group.numbers == (0, 1, 3)
    assert np.abs(group.shifts_px - np.array([shifts[0], shifts[1], shifts[3]])).max() < 0.15


def test_the_mean_of_the_others_rewards_denoising_and_not_blurring() -> None:
    rng = np.random.default_rng(4)
    shifts = [(rng.uniform(-1, 1), rng.uniform(-1, 1)) for _ in range(12)]
    truth = [frame(scene(0), shift, rng, 0.0) for shift in shifts]
    frames = [frame(scene(0), shift, rng, 0.1) for shift in shifts]
    group = aligned(frames, SECTOR)
    assert len(group.numbers) == 12
    inner = cv2.erode(SECTOR.astype(np.uint8), np.ones((15, 15), np.uint8)).astype(bool)
    reference = references(frames, group)
    blurs = [np.asarray(cv2.GaussianBlur(one, (0, 0), 6.0), np.float32) for one in frames]
    noisy, clean, blurred = (
        np.mean([score(one, ref, inner)[0] for one, ref in zip(ones, reference, strict=True)])
        for ones in (frames, truth, blurs)
    )
    # The noise of the frame and an eleventh of it in the reference, less what the gain takes away.
    assert 19.5 < noisy < 21.5
    assert clean > noisy + 6
    assert clean > blurred + 3


def test_what_moves_is_found() -> None:
    rng = np.random.default_rng(6)
    frames = []
    for number in range(10):
        one = frame(scene(0), (0.0, 0.0), rng, 0.05)
        one[54:67, 24 + 10 * number : 37 + 10 * number] = 1
        frames.append(one)
    found = moving(frames, SECTOR)
    assert found[60, 40:110].mean() > 0.9
    assert found[120:].mean() < 0.02
