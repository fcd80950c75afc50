"""Frames in time: laid over each other below a pixel, fused without trails, in one pass."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd import denoise
from simnfnd.factory.common.array_types import Array
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.denoise.reports import InTime as Tally
from simnfnd.models.denoise.temporal.background import backgrounds
from simnfnd.models.denoise.temporal.fusion import Neighbour, fuse, shows_same
from simnfnd.models.denoise.temporal.motion import Aligner, Motion, laid_over
from simnfnd.models.denoise.temporal.stream import InTime, SequenceFrame
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.inputs import find_items, sequences

SIDE = 224
MARGIN = 24
NOISE = 0.05
LAMPREY = Path("examples/didson/lamprey.avi")


def scene(side: int = SIDE + 2 * MARGIN, seed: int = 3) -> Array:
    """Ground with stones, smooth enough to be moved below a pixel."""
    rng = np.random.default_rng(seed)
    ground = cv2.GaussianBlur(rng.normal(0, 1, (side, side)).astype(np.float32), (0, 0), 3)
    stones = cv2.GaussianBlur((rng.random((side, side)) > 0.999).astype(np.float32), (0, 0), 2)
    return np.clip(0.3 + 0.8 * ground + 6 * stones, 0.05, 0.9).astype(np.float32)


def view(wide: Array, right: float = 0, down: float = 0, turn_deg: float = 0) -> Array:
    """A window of a scene, moved right and down by as much, and turned around its middle."""
    middle = MARGIN + (SIDE - 1) / 2
    matrix: Any = cv2.getRotationMatrix2D((middle, middle), turn_deg, 1.0)
    matrix[:, 2] += right - MARGIN, down - MARGIN
    moved: Any = cv2.warpAffine(wide, matrix, (SIDE, SIDE), flags=cv2.INTER_CUBIC)
    return np.array(np.clip(moved, 0, 1), dtype=np.float32)


def noisy(image: Array, seed: int) -> Array:
    noise = np.random.default_rng(seed).normal(0, NOISE, image.shape)
    noisy_frame: Array = np.clip(image + noise, 0, 1).astype(np.float32)
    return noisy_frame


def error(image: Array, truth: Array, edge: int = 12) -> float:
    return float((image - truth)[edge:-edge, edge:-edge].std())


def motion_between(first: Array, second: Array) -> Motion | None:
    """Where the pixels of the second lie in the first."""
    aligner = Aligner(lambda number: number - 1 if number else None)
    aligner.add(0, first)
    aligner.add(1, second)
    return aligner.motion(1, 0)


def as_it_is(grey: Array, geometry: FanGeometry | None = None) -> Array:
    return grey


def shots(frames: list[Array]) -> Iterator[SequenceFrame]:
    return (SequenceFrame(number, frame) for number, frame in enumerate(frames))


def through(
    frames: list[Array], *, window: int = 7, causal: bool = False, calibrated: bool = True
) -> tuple[list[Array], Tally]:
    tally = Tally()
    stream = InTime(as_it_is, frames=window, causal=causal, calibrated=calibrated)
    results = list(stream(shots(frames)))
    assert [result.key for result in results] == list(range(len(frames)))
    for result in results:
        tally.add(result.facts)
    return [result.levels for result in results], tally


@pytest.mark.parametrize(
    ("right", "down", "turn_deg"),
    [(3, -2, 0), (0.4, 0.7, 0), (-11.3, 6.6, 0), (1.5, 0, 1.2), (0, 0, -2)],
)
def test_frames_are_laid_over_each_other_below_a_pixel(
    right: float, down: float, turn_deg: float
) -> None:
    wide = scene()
    first_view = view(wide)
    second_view = view(wide, right, down, turn_deg)
    motion = motion_between(noisy(second_view, 1), noisy(first_view, 2))
    assert motion is not None
    laid, shown = laid_over(second_view, motion)
    inside = shown > 0
    inside[:30] = False
    inside[-30:] = False
    inside[:, :30] = False
    inside[:, -30:] = False
    difference = np.abs(laid - first_view)[inside]
    slope = np.hypot(*np.gradient(first_view))[inside]
    assert difference.mean() < 0.2 * slope.mean()  # a fifth of a pixel


def test_a_shuffled_folder_falls_back_frame_by_frame() -> None:
    frames = [noisy(view(scene(seed=number)), number) for number in range(9)]

    def halving(grey: Array, geometry: FanGeometry | None = None) -> Array:
        return grey / 2

    def no_fan(image: Array) -> None:
        return None

    denoising = Denoising(halving)
    shuffled = (
        denoising.shot(n, frame, lambda image: None, number=n) for n, frame in enumerate(frames)
    )
    for denoised in denoising.sequence(shuffled):
        np.testing.assert_allclose(denoised.image, frames[denoised.key] / 2, atol=1e-6)
        assert denoised.facts.fused == pytest.approx(1)


def test_where_nothing_moves_all_frames_count() -> None:
    truth = view(scene())
    frames = [noisy(truth, number) for number in range(14)]
    denoised, tally = through(frames, calibrated=False)
    plain = np.mean(frames[3:10], axis=0)
    assert tally.fused / tally.frames > 5.8  # the first and last have fewer neighbours
    assert tally.unmatched == 0
    # The usual strength takes a little total variation: no worse than the mean.
    assert error(denoised[6], truth) < 1.03 * error(plain, truth)


def fused_by_the_window(frames: list[Array]) -> dict[int, Array]:
    """Each frame with three before and three after it; static sonar."""
    visible = np.ones_like(frames[0])
    fused = {}
    for own in range(3, len(frames) - 3):
        window = sorted(range(own - 3, own + 4), key=lambda number: abs(number - own))[1:]
        neighbours = [Neighbour(n - own, frames[n], visible) for n in window]
        fused[own] = fuse(frames[own], neighbours).image
    return fused


def test_a_faint_target_on_a_path_keeps_its_contrast_and_loses_its_noise() -> None:
    ground = view(scene())
    shape = (9, 15)
    frames = []
    boxes = []
    for number in range(24):
        top, left = 30 + 2 * number, 40 + 4 * number
        box = np.s_[top : top + shape[0], left : left + shape[1]]
        clean = ground.copy()
        clean[box] += 1.5 * NOISE
        frames.append(noisy(clean, number))
        boxes.append(box)
    contrasts = []
    residuals = []
    for number, image in fused_by_the_window(frames).items():
        added = (image - ground)[boxes[number]]
        contrasts.append(added.mean() / (1.5 * NOISE))
        residuals.append(added.std())
    assert np.mean(contrasts) > 0.75
    assert np.mean(residuals) < 0.9 * NOISE


def test_noise_alone_seldom_counts_as_a_path() -> None:
    ground = view(scene())
    frames = [noisy(ground, number) for number in range(24)]
    plain = np.mean(frames[11:18], axis=0)
    image = fused_by_the_window(frames)[14]
    assert error(image, ground) < 1.15 * error(plain, ground)


def test_calibration_leaves_out_moving_objects() -> None:
    ground = view(scene())
    box = np.s_[80:100, 80:100]
    frames = [noisy(ground, number) for number in range(7)]
    frames[3][box] += 8 * NOISE
    visible = np.ones_like(ground)
    neighbours = [Neighbour(n - 3, frames[n], visible) for n in range(7) if n != 3]
    fused = fuse(frames[3], neighbours)
    same = shows_same(fused, noisy(ground, 99), visible)
    assert not same[box].any()
    assert same[20:60, 20:60].mean() > 0.8


def test_the_background_is_the_scene_and_objects_deviate_from_it() -> None:
    """Also where the sonar moves, and live."""
    wide = scene()
    for causal in (False, True):
        frames = []
        truth = []
        for number in range(10):
            truth.append(view(wide, 2 * number, number))
            frame = noisy(truth[-1], number)
            frame[60 + 8 * number : 70 + 8 * number, 100:110] += 5 * NOISE
            frames.append(frame.clip(0, 1))
        background = list(backgrounds(frames, window=7, causal=causal))[6]
        thing = np.s_[110:116, 102:108]
        assert background.deviation[thing].min() > 4
        away = np.s_[20:90, 20:200]
        assert background.frame_count[away].mean() > 4
        assert np.abs(background.deviation[away]).mean() < 1.2
        assert error(background.scene[away], truth[6][away], 5) < 0.6 * NOISE
        assert background.noise[away].mean() == pytest.approx(NOISE, rel=0.3)


def test_moving_objects_leave_no_trail_and_do_not_fade() -> None:
    truth = []
    frames = []
    for number in range(12):
        image = view(scene())
        top, left = 60 + 4 * number, 40 + 10 * number
        image[top : top + 10, left : left + 14] = 0.95
        truth.append(image)
        frames.append(noisy(image, number))
    aligner = Aligner(lambda number: number - 1 if number else None)
    for number, frame in enumerate(frames):
        aligner.add(number, frame)
    for own in range(3, 9):
        motions = {n: aligner.motion(own, n) for n in range(own - 3, own + 4) if n != own}
        neighbours = [
            Neighbour(number - own, *laid_over(frames[number], motion))
            for number, motion in motions.items()
            if motion is not None
        ]
        fused = fuse(frames[own], neighbours)
    thing = truth[8] == np.float32(0.95)
    trail = np.zeros_like(thing)
    for number in (5, 6, 7, 9, 10, 11):
        trail |= truth[number] == np.float32(0.95)
    trail &= ~cv2.dilate(thing.astype(np.uint8), np.ones((9, 9))).astype(bool)
    assert np.median(fused.frame_count[thing]) < 1.5
    assert abs(float((fused.image - truth[8])[thing].mean())) < 0.01
    assert abs(float((fused.image - truth[8])[trail].mean())) < 0.01
    assert np.median(fused.frame_count[40:50, 10:30]) > 6


def test_a_moving_sonar_keeps_what_it_gains() -> None:
    wide = scene()
    truth = [view(wide, 2 * n - 12, 1.3 * n - 8) for n in range(12)]
    denoised, tally = through([noisy(frame, n) for n, frame in enumerate(truth)], calibrated=False)
    assert tally.unmatched == 0
    assert error(denoised[6], truth[6]) < 0.6 * NOISE


def test_colours_of_no_map_are_fused_too() -> None:
    wide = scene()
    truth = [view(wide, 2 * n) for n in range(9)]
    tints = np.array([0.9, 0.5, 0.7], np.float32)
    coloured = [frame[..., None] * tints for frame in truth]
    denoised, tally = through(
        [noisy(frame, n) for n, frame in enumerate(coloured)], calibrated=False
    )
    assert tally.unmatched == 0
    assert error(denoised[4], coloured[4]) < 0.7 * NOISE


@pytest.mark.parametrize("causal", [False, True])
def test_order_and_window(causal: bool) -> None:
    """No frame further away than the window changes a result; causal: none that comes later."""
    frames = [noisy(view(scene()), number) for number in range(12)]
    denoised, _ = through(frames, window=3, causal=causal, calibrated=False)
    replaced = [*frames[:9], *(noisy(view(scene(seed=5)), 20 + n) for n in range(3))]
    changed, _ = through(replaced, window=3, causal=causal, calibrated=False)
    same = [bool(np.allclose(a, b, atol=1e-5)) for a, b in zip(denoised, changed, strict=True)]
    first = same.index(False)
    assert first >= (9 if causal else 8)


@pytest.mark.slow
def test_memory_stays_flat() -> None:
    def endless(count: int) -> Iterator[SequenceFrame]:
        truth = view(scene())
        for number in range(count):
            yield SequenceFrame(number, noisy(truth, number))

    def peak(count: int) -> int:
        tracemalloc.start()
        for _ in InTime(as_it_is, frames=7)(endless(count)):
            pass
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert peak(60) < 1.1 * peak(40)


def test_the_recording_chooses_the_strength() -> None:
    """A network that removes the noise gets a part, one that spoils the image gets none."""
    truth = view(scene())
    frames = [noisy(truth, number) for number in range(24)]

    class Knows:
        knows_frames = True

        def __init__(self, clean: Array) -> None:
            self.clean = clean

        def __call__(
            self, grey: Array, geometry: FanGeometry | None = None, *, frames: Array | None = None
        ) -> Array:
            return self.clean

    def share_of_network(clean: Array) -> float:
        *_, result = InTime(Knows(clean), frames=7)(shots(frames))
        assert result.facts.measured > 2
        return result.facts.network

    assert share_of_network(truth) > 0.8
    assert abs(share_of_network(np.zeros_like(truth))) < 0.2


@pytest.mark.parametrize("frames", [0, 2, -1, 33])
def test_windows_that_cannot_be(frames: int) -> None:
    with pytest.raises(FactoryError, match=r"--frames .*31"):
        Denoising(as_it_is, frames=frames)


def test_sequences_are_images_that_differ_in_their_last_number(tmp_path: Path) -> None:
    names = ["a2.png", "a10.png", "a1.png", "b1.png", "x.png", "a1.jpg"]
    for name in names:
        assert cv2.imwrite(str(tmp_path / name), np.zeros((20, 20), np.uint8))
    runs = sequences(find_items([tmp_path], tmp_path / "out"))
    assert sorted([item.source.name for item in some] for some in runs) == [
        ["a1.jpg"],
        ["a1.png", "a2.png", "a10.png"],
        ["b1.png"],
        ["x.png"],
    ]


@pytest.mark.slow
def test_lamprey_gains_in_time() -> None:
    """Decibels on the recording that ships, against the mean of frames that no window holds."""
    with open_recording(LAMPREY) as recording:
        stack = np.stack([recording[number].samples for number in range(8)])
    stack = stack if stack.ndim == 3 else stack[..., 0]
    levels = stack.astype(np.float32) / 255

    def decibels(denoised: Array, number: int) -> float:
        # Frames beside it only: the recording has too few for a window of seven and a reference.
        others = [n for n in range(len(levels)) if abs(n - number) > 1]
        truth = levels[others].mean(axis=0)
        lit = truth > 0.03
        return float(-10 * np.log10(((denoised - truth)[lit] ** 2).mean()))

    fused = denoise(levels, frames=3)
    alone = denoise(levels[3])
    middle = decibels(fused[3], 3)
    assert middle > decibels(levels[3], 3) + 3
    assert middle > decibels(alone, 3) + 0.5


def test_frames_that_show_nothing_stay_dark() -> None:
    """There is no slope to align by."""
    assert denoise(np.zeros((9, 200, 220), np.uint16)).max() < 0.01 * 65_535


def test_a_dark_recording_is_fused_like_a_bright_one() -> None:
    bright = [noisy(view(scene()), number) for number in range(10)]
    dark = [frame / np.float32(16) for frame in bright]
    from_bright, tally = through(bright, calibrated=False)
    from_dark, dark_tally = through(dark, calibrated=False)
    assert dark_tally.fused > 0.9 * tally.fused
    assert np.abs(16 * from_dark[5] - from_bright[5]).mean() < 0.1 * NOISE
