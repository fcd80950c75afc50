"""Frames in, denoised frames out, in order: one pass, a window of frames in memory.

Aligning, fusing and measuring follow the order of the frames; the network then runs on as many
fused frames at once as the caller allows, which changes no pixel.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from ....factory.common.array_types import Array, Bools
from ....factory.dataset.fan_geometry import FanGeometry
from ...recordings.device_settings import RecordedSettings
from ..options import FRAMES
from ..saturated import with_saturated
from .brightness import UNLIKE, Likeness, likeness_of, thumbnail_of
from .fusion import FusedFrame, Fusion, Neighbour
from .motion import Aligner, grey_of, laid_over, reduced
from .strength import Predictors, Strength, Weights

MOST_FRAMES = 31

_DARK = 0.02  # grey value up to which a pixel tells nothing of what moved
_CALIBRATION_INTERVAL = 8  # frames between the first two calibrations
_MAX_INTERVALS = 4  # later calibrations are up to this many intervals apart
SAME_GAIN = 0.04
"""Logarithm of the ratio of levels up to which frames are as bright as each other; it is .017 at
most in the recordings that ship."""
_FULL_WINDOW = 0.8  # share of the highest frame count from which on a pixel has a whole window

Network = Callable[..., Array]
"""Denoises an image, (H, W) float32 in 0..1, with its `FanGeometry` or None; see `Denoiser`.

One with a true attribute `knows_frames` also gets `frames`, (H, W): how many frames were
averaged at each pixel.
"""


@dataclass(frozen=True, eq=False)
class SequenceFrame:
    """A frame of a sequence.

    key: comes back with the result.  levels: (H, W) or (H, W, C) float32 in 0..1.
    place: finds the geometry of the image; called where the scene is not that of a frame before.
    shift_px: how far right and down the scene moved since the frame before, where that is known.
    wanted: whether its result is returned; the other frames serve as neighbours, and the noise and
        the strength are measured on them, too.
    is_tracked: whether `place` tracks the geometry from frame to frame, so it is called for each.
    settings: of the sonar, as the recording states them; see `kinds`.
    """

    key: Any
    levels: Array
    place: Callable[[], FanGeometry | None] = lambda: None
    shift_px: tuple[float, float] | None = None
    wanted: bool = True
    is_tracked: bool = False
    settings: RecordedSettings = field(default_factory=RecordedSettings)


@lru_cache(maxsize=8)
def outside_of(geometry: FanGeometry, height: int, width: int) -> Bools:
    """(H, W), the pixels that are not in the sector."""
    return np.asarray(geometry.maps(0, 0, height, width)["sector"] <= 0)


@dataclass(frozen=True, eq=False)
class _FusedShot:
    """A frame fused with its neighbours, ready for the network.

    sigma: (H, W) or (H, W, C) standard deviation of the noise that is left.
    predictors: the estimates that the strength combines (see `strength`), if calibration has
        computed them already.
    """

    fused: FusedFrame
    sigma: Array
    geometry: FanGeometry | None
    predictors: Predictors | None = None


class InTime:
    """Denoises the frames of one sequence, each from a window of frames around it.

    Frames are aligned and fused; the result is a weighted sum of the network's output and of
    simpler predictors of the static scene, whose weights (`Strength`) are fitted to the recording.
    An object serves for one sequence.

    network: denoises the fused frames; with None they are only fused.
    frames: length of the window, odd.
    causal: whether the window ends with the frame that is denoised, and is not centred on it.
    calibrated: whether the strength is fitted to the recording; otherwise it is the default.
    keeps_outside: whether pixels around a fan stay as they are.
    tally: counts that the stream adds to: `images`, the frames that were fused; `alone`, those
        that matched no neighbour; `frames` and `moved`, sums over the fused frames of the mean
        number of frames averaged at a pixel and of the share of pixels that moved.
    at_once: frames that the network denoises at the same time; with 1 a frame comes out as soon as
        its window is complete.
    strength: the weights of the predictors, as fitted so far.  window: `frames`.
    """

    def __init__(
        self,
        network: Network | None,
        *,
        frames: int = FRAMES,
        causal: bool = False,
        calibrated: bool = True,
        keeps_outside: bool = False,
        tally: dict[str, float] | None = None,
        at_once: int = 1,
    ) -> None:
        self._network = network
        self.window = frames
        self._causal = causal
        self._before = frames - 1 if causal else frames // 2
        self._after = 0 if causal else frames // 2
        self._keeps_outside = keeps_outside
        self._calibrated = calibrated and network is not None and frames > 1
        self._tally = tally if tally is not None else defaultdict(float)
        self._is_frame_aware = bool(getattr(network, "knows_frames", False))

        self._aligner = Aligner(2 * frames)
        self._fusion = Fusion()
        self.strength = Strength(frames, frame_aware=self._is_frame_aware)

        # All by frame number.
        self._shots: dict[int, SequenceFrame] = {}
        self._reduced: dict[int, Array] = {}
        self._thumbnails: dict[int, Array] = {}
        self._geometries: dict[int, FanGeometry | None] = {}
        self._fused_early: dict[int, _FusedShot] = {}
        self._newest = -1
        self._next = 0
        self._last_calibrated: int | None = None

        self._pool = ThreadPoolExecutor(at_once)
        self._max_pending = at_once if at_once > 1 else 0
        self._pending: deque[tuple[Any, Future[Array]]] = deque()

    def __call__(self, shots: Iterable[SequenceFrame]) -> Iterator[tuple[Any, Array]]:
        """The key of each frame and its levels, denoised, in order."""
        for shot in shots:
            yield from self.push(shot)
        yield from self.finish()

    def push(self, shot: SequenceFrame) -> Iterator[tuple[Any, Array]]:
        """Take the next frame; yields the key and the levels of each that is denoised by now."""
        self._newest += 1
        if not shot.levels.flags.c_contiguous:
            shot = replace(shot, levels=np.ascontiguousarray(shot.levels))
        self._shots[self._newest] = shot
        if self.window > 1:
            self._aligner.add(self._newest, grey_of(shot.levels), shot.shift_px)
            # Cache the motion between consecutive frames; longer motions start from it.
            self._aligner.motion(self._newest, self._newest - 1)
        while self._next <= self._newest - self._lookahead():
            yield from self._denoise_next()

    def flush(self) -> Iterator[tuple[Any, Array]]:
        """Yield all frames that are left, as no more of them come for some time."""
        while self._next <= self._newest:
            yield from self._denoise_next()
        yield from self._finished(0)

    def finish(self) -> Iterator[tuple[Any, Array]]:
        """Yield all frames that are left; the sequence has ended."""
        yield from self.flush()
        self.close()

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)

    def _lookahead(self) -> int:
        """How many frames must have come after the next one before it is denoised."""
        if self._causal or not self._calibrated:
            return self._after
        is_starting = self._next == 0 and self._newest < self.window
        if is_starting:
            # The first calibration takes a whole window and a frame beyond it.
            return self.window
        # Every later one takes a frame beyond the window as its target.
        return self._after + 1

    def _denoise_next(self) -> Iterator[tuple[Any, Array]]:
        """Fuse the next frame and start its denoising; yield the frames that are finished."""
        number = self._next
        if self._calibrated:
            self._calibrate_if_due(number)
        shot = self._shots[number]
        # Nothing is measured on frames that are denoised alone.
        if shot.wanted or self.window > 1:
            frame = self._fused_early.pop(number, None) or self._fuse(number)
            if self.window > 1:
                self._count(frame.fused)
            if shot.wanted:
                weights = self.strength.weights
                denoised = self._pool.submit(self._restore, frame, weights, shot.levels)
                self._pending.append((shot.key, denoised))
        self._next += 1
        self._forget(number - self._before - 1)
        yield from self._finished(self._max_pending)

    def _forget(self, number: int) -> None:
        """Drop a frame that no window needs any more."""
        self._shots.pop(number, None)
        self._reduced.pop(number, None)
        self._thumbnails.pop(number, None)

    def _finished(self, max_pending: int) -> Iterator[tuple[Any, Array]]:
        """Yield denoised frames, in order, until at most `max_pending` are being denoised."""
        while len(self._pending) > max_pending:
            key, denoised = self._pending.popleft()
            yield key, denoised.result()

    def _count(self, fused: FusedFrame) -> None:
        """Add a frame to the tally."""
        lit = (grey_of(fused.image) > _DARK).astype(np.uint8)
        if not lit.any():
            lit = np.ones_like(lit)
        self._tally["images"] += 1
        self._tally["frames"] += cv2.mean(fused.frame_count, lit)[0]
        self._tally["moved"] += 1 - cv2.mean(fused.static_share, lit)[0]
        self._tally["alone"] += bool(fused.frame_count.max() <= 1)

    def _fuse(self, number: int) -> _FusedShot:
        """Fuse a frame with those frames of its window that show the same scene."""
        first = max(0, number - self._before)
        last = min(self._newest, number + self._after)
        nearest_first = sorted(
            range(first, last + 1), key=lambda neighbour: abs(neighbour - number)
        )
        neighbours = []
        for neighbour in nearest_first:
            aligned = self._aligned(number, neighbour) if neighbour != number else None
            if aligned is not None:
                neighbours.append(Neighbour(neighbour - number, *aligned))
        fused = self._fusion(self._shots[number].levels, neighbours)
        geometry = self._geometry(number) if self._network is not None else None
        return _FusedShot(fused, self._sigma(fused.image, fused.frame_count), geometry)

    def _aligned(self, number: int, neighbour: int) -> tuple[Array, Array] | None:
        """Levels of another frame as seen from this one, and (H, W) where they are visible.

        None where the other frame shows something else.
        """
        shot = self._shots.get(neighbour)
        if shot is None or shot.levels.shape != self._shots[number].levels.shape:
            return None
        motion = self._aligner.motion(number, neighbour)
        if motion is None:
            return None
        levels, visible = laid_over(shot.levels, motion)
        likeness = self._likeness(number, neighbour, levels, visible)
        if abs(math.log(likeness.gain)) <= SAME_GAIN:
            return levels, visible
        if likeness.difference > UNLIKE:
            return None
        # The gain of the sonar or the exposure of a screen changed between both.
        return np.minimum(levels * np.float32(likeness.gain), np.float32(1)), visible

    def _likeness(self, number: int, neighbour: int, levels: Array, visible: Array) -> Likeness:
        """How unlike another frame, as it is seen from a frame, is to that frame."""
        shape = levels.shape
        if levels is self._shots[neighbour].levels:
            return likeness_of(self._thumbnail(neighbour), self._thumbnail(number))
        small_visible = reduced(visible)
        return likeness_of(
            thumbnail_of(reduced(grey_of(levels)) * small_visible, shape),
            thumbnail_of(self._small(number) * small_visible, shape),
        )

    def _small(self, number: int) -> Array:
        """A frame that is in memory, grey and reduced."""
        if number not in self._reduced:
            self._reduced[number] = reduced(grey_of(self._shots[number].levels))
        return self._reduced[number]

    def _thumbnail(self, number: int) -> Array:
        """The thumbnail of a frame that is in memory."""
        if number not in self._thumbnails:
            shape = self._shots[number].levels.shape
            self._thumbnails[number] = thumbnail_of(self._small(number), shape)
        return self._thumbnails[number]

    def _geometry(self, number: int) -> FanGeometry | None:
        """The geometry of a frame: that of the nearest known one if it shows the same scene."""
        shot = self._shots[number]
        if shot.is_tracked:
            return shot.place()
        # To find a fan anew in each frame costs more than the network.
        self._geometries.pop(number - self.window, None)
        nearest = min(self._geometries, key=lambda neighbour: abs(neighbour - number), default=None)
        if nearest is None or self._aligner.motion(number, nearest) is None:
            self._geometries[number] = shot.place()
        else:
            self._geometries[number] = self._geometries[nearest]
        return self._geometries[number]

    def _sigma(self, image: Array, frame_count: Array) -> Array:
        """Standard deviation of the noise in each pixel; zeros where it is not measured."""
        if self.window == 1:
            return np.zeros_like(image)
        root: Array = np.sqrt(frame_count)
        return self._fusion.noise.at(image) / (root if image.ndim == 2 else root[..., None])

    def _restore(self, frame: _FusedShot, predictor_weights: Weights, levels: Array) -> Array:
        """The denoised frame; around a fan and in saturated echoes it keeps its own levels."""
        denoised = self._denoise(frame, predictor_weights)
        # Simulated points pile up: there a clipped cell is noisy, too.
        if self._is_frame_aware and self.window > 1:
            denoised = with_saturated(denoised, levels)
        geometry = frame.geometry
        if not self._keeps_outside or geometry is None or geometry.layout == "polar":
            return denoised
        outside = outside_of(geometry, *levels.shape[:2])
        restored = denoised.copy()
        restored[outside] = levels[outside]
        return restored

    def _denoise(self, frame: _FusedShot, predictor_weights: Weights) -> Array:
        """Denoise a fused frame, channel by channel.

        A single frame is what the network makes of it.  In a window the network's output is one of
        several predictors of the static scene, and the result is their weighted sum.
        """
        fused = frame.fused
        if self._network is None:
            return fused.image
        if fused.image.ndim == 3:
            channels = range(fused.image.shape[2])
            planes = [
                self._denoise(_channel(frame, channel), predictor_weights) for channel in channels
            ]
            return np.stack(planes, axis=-1)
        if self.window == 1:
            return self._network(fused.image, frame.geometry)
        predictors = frame.predictors or self._compute_predictors(frame)
        return predictor_weights.apply(predictors, fused.frame_count)

    def _compute_predictors(self, frame: _FusedShot) -> Predictors:
        """Run the network and the simpler denoisers beside it on a grey frame; see `Predictors`."""
        assert self._network is not None
        fused = frame.fused
        condition = {"frames": fused.frame_count} if self._is_frame_aware else {}
        output = self._network(fused.image, frame.geometry, **condition)
        return Predictors.of(fused.image, frame.sigma, output)

    def _calibrate_if_due(self, number: int) -> None:
        """Calibrate before frame `number` is denoised, if enough frames came since the last time.

        A centred stream first calibrates on frame `_before`, the first with a whole window.  Every
        other calibration is on frame `number`, 8 to 32 frames or more after the one before.
        """
        if self._last_calibrated is None and not self._causal:
            # Later where the stream was flushed before it had a whole window.
            self._calibrate(max(self._before, number))
            return
        intervals = min(max(self.strength.measured, 1), _MAX_INTERVALS)
        if number - (self._last_calibrated or 0) >= _CALIBRATION_INTERVAL * intervals:
            self._calibrate(number)

    def _calibrate(self, number: int) -> None:
        """Fit the strength so that frame `number` best predicts a frame just outside its window.

        That frame has noise of its own, so only the static scene can be predicted.  The fit is made
        for the frame alone and for the frame fused with its window.
        """
        target_number = number - self._before - 1 if self._causal else number + self._after + 1
        if number < self._before or target_number not in self._shots:
            return
        self._last_calibrated = number
        levels = self._shots[number].levels
        target = self._aligned(number, target_number)
        frame = self._fuse(number)
        self._fused_early[number] = frame
        if target is None or levels.ndim != 2:
            return
        target_levels, visible = target
        is_same_scene = self._fusion.shows_same(frame.fused, target_levels, visible)

        ones = np.ones_like(frame.fused.frame_count)
        single = _FusedShot(
            FusedFrame(levels, ones, ones), self._sigma(levels, ones), frame.geometry
        )
        single_predictors = self._compute_predictors(single)
        self.strength.add_single(single_predictors, target_levels, is_same_scene)

        predictors = self._compute_predictors(frame)
        self._fused_early[number] = replace(frame, predictors=predictors)
        frame_count = frame.fused.frame_count
        has_full_window = frame_count > _FULL_WINDOW * frame_count.max()
        self.strength.add_window(predictors, target_levels, is_same_scene & has_full_window)
        self.strength.fit()


def _channel(frame: _FusedShot, index: int) -> _FusedShot:
    """One channel of a frame in colour, as a frame of its own."""
    image = np.ascontiguousarray(frame.fused.image[..., index])
    sigma = np.ascontiguousarray(frame.sigma[..., index])
    return _FusedShot(replace(frame.fused, image=image), sigma, frame.geometry)
