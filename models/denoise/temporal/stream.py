"""Frames in, denoised frames out, in order: one pass, a window of frames in memory.

What a frame becomes is a function of the frames around it alone: `MARGIN_BEFORE` stored ones before
and `MARGIN_AFTER` after it at most (causal: none after it).  Its window holds the nearest frames of
its kind, its noise is measured in the window, and its strength on the frames nearest to it.  So a
recording may begin anywhere, and any part of it has the bytes that it has in the whole.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import atan2, degrees
from typing import Any, NamedTuple

import cv2
import numpy as np

from ....factory.common.array_types import Array, Bools
from ....factory.dataset.fan_geometry import FanGeometry
from ...recordings.device_settings import RecordedSettings
from ..options import FRAMES
from ..saturated import with_saturated
from .fusion import FusedFrame, Neighbour, fuse, shows_same
from .grouping import LOOK, REACH, Grouping
from .likeness import Likeness, likeness_of, thumbnail_of
from .motion import Aligner, factors, grey_of, laid_over, reduced
from .noise_level import at_level
from .strength import Measurement, Predictors, Strength, fitted

MOST_FRAMES = 31
MARGIN_BEFORE = 4 * REACH + LOOK
MARGIN_AFTER = 2 * REACH + LOOK
"""Stored frames before and after a frame that may count in its result."""

_CALIBRATED_ON = 8
"""Frames before a frame, and as many after it, whose measurements decide on its strength."""
_DARK = 0.02  # grey value up to which a pixel tells nothing of what moved
_FULL_WINDOW = 0.8  # share of the highest frame count from which on a pixel has a whole window
_CHANGED = 0.1  # grey value: a codec changes a copy by less, a clock over the fan by more
_COPY_WINDOW_PX = 3

Network = Callable[..., Array]
"""Denoises an image, (H, W) float32 in 0..1, with its `FanGeometry` or None; see `Denoiser`.

One with a true attribute `knows_frames` also gets `frames`, (H, W): how many frames were
averaged at each pixel.
"""


@dataclass(frozen=True, eq=False)
class SequenceFrame:
    """A frame of a sequence.

    key: comes back with the result.  levels: (H, W) or (H, W, C) float32 in 0..1.
    geometry: where range and bearing are in the image; None where that is not known.
    shift_px: how far right and down the scene moved since the frame before, where that is known.
    number: of the frame in its recording, which ascends; None: that after the last one.
    wanted: whether its result is returned; the other frames serve as neighbours.
    settings: of the sonar, as the recording states them; see `grouping`.
    """

    key: Any
    levels: Array
    geometry: FanGeometry | None = None
    shift_px: tuple[float, float] | None = None
    number: int | None = None
    wanted: bool = True
    settings: RecordedSettings = field(default_factory=RecordedSettings)


class FrameFacts(NamedTuple):
    """What was done to a frame; numbers alone, so that they can be kept beside its pixels.

    previous: number of the frame before it of its kind, -1 for none.  is_copy: 1 for a copy.
    fused: mean number of frames averaged at a pixel; 0: a frame that is denoised alone.
    deviating: share of pixels that moved.
    shift_x_px, shift_y_px, rotation_deg: of the scene since the previous frame of its kind.
    network, variation: mean coefficients; measured: frames that they were fitted to.
    has_fan: 1 where the geometry of the image is known.
    """

    previous: float = -1
    is_copy: float = 0
    fused: float = 1
    deviating: float = 0
    shift_x_px: float = 0
    shift_y_px: float = 0
    rotation_deg: float = 0
    network: float = 1
    variation: float = 0
    measured: float = 0
    has_fan: float = 0


class StreamResult(NamedTuple):
    """A denoised frame: the key of its `SequenceFrame`, its levels, and what was done to it.

    fused: the frame before the network; None for a frame that is denoised alone.
    """

    key: Any
    levels: Array
    facts: FrameFacts
    fused: FusedFrame | None


@lru_cache(maxsize=8)
def outside_of(geometry: FanGeometry, height: int, width: int) -> Bools:
    """(H, W), the pixels that are not in the sector."""
    return np.asarray(geometry.maps(0, 0, height, width)["sector"] <= 0)


class _Target(NamedTuple):
    """A frame outside a window as seen from the middle one, and where it shows the same."""

    levels: Array
    is_same_scene: Bools


class _Restored(NamedTuple):
    """A frame between network and strength.

    predictors: by channel.  measurement: None where there is none.
    """

    predictors: list[Predictors]
    measurement: Measurement | None


class InTime:
    """Denoises the frames of one sequence, each from a window of frames around it.

    Frames are grouped, aligned and fused; the result is a weighted sum of the network's output and
    of simpler predictors of the static scene (`strength`).  An object serves for one sequence.
    """

    def __init__(
        self,
        network: Network | None,
        *,
        frames: int = FRAMES,
        causal: bool = False,
        calibrated: bool = True,
        keeps_outside: bool = False,
        at_once: int = 1,
    ) -> None:
        """network: denoises the fused frames; with None they are only fused.

        frames: length of the window, odd.
        causal: whether the window ends with the frame that is denoised, and is not centred on it.
        calibrated: whether the strength is fitted to the recording; otherwise it is the default.
        keeps_outside: whether pixels around a fan stay as they are.
        at_once: frames that the network denoises at the same time.
        """
        self._network = network
        self._window = frames
        self._causal = causal
        self._before = frames - 1 if causal else frames // 2
        self._after = 0 if causal else frames // 2
        self._keeps_outside = keeps_outside
        self._calibrated = calibrated and network is not None and frames > 1
        self._is_frame_aware = bool(getattr(network, "knows_frames", False))

        self._grouping = Grouping(causal=causal)
        self._aligner = Aligner(self._previous_original)

        # All by frame number.
        self._frames: dict[int, SequenceFrame] = {}
        self._reduced: dict[int, Array] = {}
        self._fused: dict[int, FusedFrame] = {}
        self._restored: dict[int, Future[_Restored]] = {}
        self._measurements: dict[int, Measurement | None] = {}
        self._results: dict[int, Future[Array]] = {}
        self._held_by_number: tuple[dict[int, Any], ...] = (
            *(self._frames, self._reduced, self._fused),
            *(self._restored, self._measurements, self._results),
        )
        self._newest = -1
        self._next = 0

        self._pool = ThreadPoolExecutor(at_once)
        self._max_pending = at_once if at_once > 1 else 0
        self._pending: deque[tuple[int, Future[Array]]] = deque()
        self._facts: dict[int, FrameFacts] = {}

    def __call__(self, frames: Iterable[SequenceFrame]) -> Iterator[StreamResult]:
        """What became of each frame, in order."""
        for frame in frames:
            yield from self.push(frame)
        yield from self.finish()

    def push(self, frame: SequenceFrame) -> Iterator[StreamResult]:
        """Take the next frame; yields those that are denoised by now."""
        number = self._newest + 1 if frame.number is None else frame.number
        if self._newest < 0:
            self._next = number
        self._newest = number
        if not frame.levels.flags.c_contiguous:
            frame = replace(frame, levels=np.ascontiguousarray(frame.levels))
        self._frames[self._newest] = frame
        if self._window > 1:
            grey = grey_of(frame.levels)
            self._grouping.add(self._newest, grey, frame.settings)
            gain = self._grouping.gain(self._newest)
            self._aligner.add(self._newest, _brightened(grey, gain), frame.shift_px)
        while self._next <= self._newest and self._is_surrounded(self._next):
            yield from self._denoise_next()

    def finish(self) -> Iterator[StreamResult]:
        """Yield all frames that are left; the sequence has ended."""
        while self._next <= self._newest:
            yield from self._denoise_next()
        yield from self._finished(0)
        self.close()

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown(cancel_futures=True)

    def _is_surrounded(self, number: int) -> bool:
        """Whether all frames after one that count in its result have come."""
        if self._causal or self._window == 1:
            return True
        if self._newest >= number + MARGIN_AFTER:
            return True
        more = _CALIBRATED_ON + 1 + self._max_pending if self._calibrated else 0
        after = self._grouping.after(number, self._after + more)
        return len(after) == self._after + more and self._newest >= after[-1] + LOOK

    def _denoise_next(self) -> Iterator[StreamResult]:
        """Start the denoising of the next frame; yield the frames that are finished."""
        number = self._next
        self._next += 1
        if number in self._frames and self._frames[number].wanted:
            if self._max_pending:
                # What frames after it need is computed while this one is waited for.
                for later in self._grouping.after(number, _CALIBRATED_ON + self._max_pending):
                    if self._calibrated and not self._causal and later + LOOK <= self._newest:
                        self._restore(later)
            self._facts[number], denoised = self._begin(number)
            self._pending.append((number, denoised))
        yield from self._finished(self._max_pending)
        self._forget()

    def _finished(self, max_pending: int) -> Iterator[StreamResult]:
        """Yield denoised frames, in order, until at most `max_pending` are being denoised."""
        while len(self._pending) > max_pending:
            number, denoised = self._pending.popleft()
            levels = denoised.result()
            # Planes that only its result needs.
            self._restored.pop(number, None)
            original = self._grouping.original(number) if self._window > 1 else number
            fused = self._fused.get(original)
            yield StreamResult(self._frames[number].key, levels, self._facts.pop(number), fused)

    def _forget(self) -> None:
        """Drop the frames that no result needs any more."""
        oldest_pending = self._pending[0][0] if self._pending else self._next
        held = self._before + _CALIBRATED_ON * (1 + self._causal) + 2
        for number in list(self._frames):
            if number >= oldest_pending:
                break
            is_far = number < self._next - 2 * REACH
            if is_far or self._window == 1 or len(self._later_originals(number, held)) == held:
                for held_by_number in self._held_by_number:
                    held_by_number.pop(number, None)
                self._aligner.forget(number)

    def _later_originals(self, number: int, count: int) -> list[int]:
        after = self._grouping.after(number, count)
        return [later for later in after if later < self._next]

    # --- what a frame is denoised with ------------------------------------------------------------

    def _now(self, number: int) -> int:
        """The newest frame that may count in the result of one."""
        return number if self._causal else self._newest

    def _previous_original(self, number: int) -> int | None:
        previous = self._grouping.previous(number, self._now(number))
        return None if previous is None else self._grouping.original(previous)

    def _begin(self, number: int) -> tuple[FrameFacts, Future[Array]]:
        """Start to denoise a frame: what is done to it, and what it will become."""
        if self._window == 1:
            frame = self._frames[number]
            facts = FrameFacts(fused=0, has_fan=float(frame.geometry is not None))
            return facts, self._pool.submit(self._denoise_alone, frame)
        original = self._grouping.original(number)
        if original not in self._frames:
            original = number
        facts = self._facts_of(number, original)
        strength = self._strength_of(original)
        if strength is not None:
            parts = strength.parts
            facts = facts._replace(
                network=parts.network, variation=parts.variation, measured=parts.measured
            )
        if original not in self._results:
            restored = self._restore(original)
            frame = self._frames[original]
            gain = self._grouping.gain(original)
            self._results[original] = self._pool.submit(
                self._weigh, frame, self._fused_frame(original), restored, strength, gain
            )
        if original == number:
            return facts, self._results[original]
        arguments = self._results[original], self._frames[original], self._frames[number]
        return facts, self._pool.submit(_of_copy, *arguments)

    def _facts_of(self, number: int, original: int) -> FrameFacts:
        fused = self._fused_frame(original)
        lit = (grey_of(fused.image) > _DARK).astype(np.uint8)
        if not lit.any():
            lit = np.ones_like(lit)
        previous = self._grouping.previous(number, self._now(number))
        facts = FrameFacts(
            previous=-1 if previous is None else previous,
            is_copy=float(original != number),
            fused=cv2.mean(fused.frame_count, lit)[0],
            deviating=1 - cv2.mean(fused.static_share, lit)[0],
            has_fan=float(self._frames[number].geometry is not None),
        )
        before = None if previous is None else self._grouping.original(previous)
        motion = None
        if before is not None and before != original and before in self._frames:
            motion = self._aligner.motion(before, original)
        if motion is None:
            return facts
        shape = fused.frame_count.shape
        down, right = factors(shape)
        shift_x, shift_y, xx, xy, yx, yy = motion.affine
        half = shape[1] / right / 2
        rotation = degrees(atan2(yx - xy, xx + yy + 2 * half))
        return facts._replace(
            shift_x_px=shift_x * right, shift_y_px=shift_y * down, rotation_deg=rotation
        )

    def _strength_of(self, number: int) -> Strength | None:
        """The strength of a frame, fitted to the frames nearest to it."""
        if self._network is None:
            return None
        measured: list[Measurement] = []
        if self._calibrated:
            count = _CALIBRATED_ON * (1 + self._causal)
            near = [*reversed(self._grouping.before(number, count, self._now(number))), number]
            near += [] if self._causal else self._grouping.after(number, _CALIBRATED_ON)
            results = [self._measurement_of(other) for other in near if other in self._frames]
            measured = [each for each in results if each is not None]
        return fitted(measured, self._window, frame_aware=self._is_frame_aware)

    def _measurement_of(self, number: int) -> Measurement | None:
        if number not in self._measurements:
            self._measurements[number] = self._restore(number).result().measurement
        return self._measurements[number]

    def _neighbours_of(self, number: int, *, more: int = 0) -> dict[int, int]:
        """The other frames of a window, nearest first, with their offsets in frames of the kind.

        more: frames beyond the window on each side.
        """
        now = self._now(number)
        before = self._grouping.before(number, self._before + more, now)
        after = [] if self._causal else self._grouping.after(number, self._after + more)
        offsets = {neighbour: -offset for offset, neighbour in enumerate(before, 1)}
        offsets |= {neighbour: offset for offset, neighbour in enumerate(after, 1)}
        return dict(sorted(offsets.items(), key=lambda item: abs(item[1])))

    def _fused_frame(self, number: int) -> FusedFrame:
        """A frame fused with those frames of its window that show the same scene."""
        if number not in self._fused:
            neighbours = []
            for neighbour, offset in self._neighbours_of(number).items():
                aligned = self._aligned(number, neighbour, offset)
                if aligned is not None:
                    neighbours.append(aligned)
            self._fused[number] = fuse(self._levels_of(number, number), neighbours)
        return self._fused[number]

    def _levels_of(self, number: int, viewer: int) -> Array:
        """The levels of a frame with the gain of another."""
        return _brightened(self._frames[number].levels, self._grouping.gain(viewer))

    def _aligned(self, number: int, neighbour: int, offset: int) -> Neighbour | None:
        """Another frame as seen from a frame; None where it shows something else."""
        if neighbour not in self._frames:
            return None
        motion = self._aligner.motion(number, neighbour)
        if motion is None:
            return None
        levels, visible = laid_over(self._levels_of(neighbour, number), motion)
        likeness = self._likeness(number, levels, visible)
        if not likeness.is_same_level:
            if not likeness.is_same_scene:
                return None
            # The gain of the sonar or the exposure of a screen changed between both.
            levels = np.minimum(levels * np.float32(likeness.gain), np.float32(1))
        return Neighbour(offset, levels, visible)

    def _likeness(self, number: int, levels: Array, visible: Array) -> Likeness:
        """How unlike another frame, as it is seen from a frame, is to that frame."""
        shape = levels.shape
        small_visible = reduced(visible)
        return likeness_of(
            thumbnail_of(reduced(grey_of(levels)) * small_visible, shape),
            thumbnail_of(self._small(number) * small_visible, shape),
        )

    def _small(self, number: int) -> Array:
        """A frame, grey and reduced, with its own gain."""
        if number not in self._reduced:
            self._reduced[number] = reduced(grey_of(self._levels_of(number, number)))
        return self._reduced[number]

    def _restore(self, number: int) -> Future[_Restored]:
        """Start the network on a frame and measure how well it predicts one outside its window."""
        if number not in self._restored:
            fused = self._fused_frame(number)
            target = self._target(number, fused) if self._calibrated else None
            geometry = self._frames[number].geometry
            self._restored[number] = self._pool.submit(self._predict, fused, geometry, target)
        return self._restored[number]

    def _target(self, number: int, fused: FusedFrame) -> _Target | None:
        """The nearest frame outside a window, for the calibration."""
        if fused.image.ndim != 2:
            return None
        inside = self._neighbours_of(number)
        outside = self._neighbours_of(number, more=1)
        # After it rather than before it, where both are as near.
        for other in sorted(outside.keys() - inside.keys(), key=lambda n: (abs(outside[n]), -n)):
            aligned = self._aligned(number, other, outside[other])
            if aligned is not None:
                same = shows_same(fused, aligned.levels, aligned.visible)
                return _Target(aligned.levels, same)
        return None

    # --- in threads -------------------------------------------------------------------------------

    def _denoise_alone(self, frame: SequenceFrame) -> Array:
        """A frame without others: what the network makes of it."""
        if self._network is None:
            return frame.levels
        geometry = frame.geometry
        planes = [self._network(plane, geometry) for plane in _channels(frame.levels)]
        return self._kept(_joined(planes), frame, geometry)

    def _predict(
        self, fused: FusedFrame, geometry: FanGeometry | None, target: _Target | None
    ) -> _Restored:
        """Run the network and the simpler denoisers on a fused frame."""
        assert self._network is not None
        condition = {"frames": fused.frame_count} if self._is_frame_aware else {}
        planes = []
        for plane in _channels(fused.image):
            sigma = at_level(plane, fused.pixel_noise) / np.sqrt(fused.frame_count)
            planes.append(Predictors.of(plane, sigma, self._network(plane, geometry, **condition)))
        measurement = None
        if target is not None:
            is_full = fused.frame_count > _FULL_WINDOW * fused.frame_count.max()
            measurement = Measurement.of(planes[0], target.levels, target.is_same_scene & is_full)
        return _Restored(planes, measurement)

    def _weigh(
        self,
        frame: SequenceFrame,
        fused: FusedFrame,
        restored: Future[_Restored] | None,
        strength: Strength | None,
        gain: float,
    ) -> Array:
        """The denoised frame from its predictors and their coefficients."""
        if restored is None or strength is None:
            denoised = fused.image
        else:
            planes = restored.result().predictors
            denoised = _joined(
                [strength.weights.apply(plane, fused.frame_count) for plane in planes]
            )
        if gain != 1:
            # What is brighter than the scale stays.
            denoised = np.where(frame.levels * gain > 1, frame.levels, denoised / np.float32(gain))
        return self._kept(denoised, frame, frame.geometry)

    def _kept(self, denoised: Array, frame: SequenceFrame, geometry: FanGeometry | None) -> Array:
        """A denoised frame with its own levels around a fan and in saturated echoes."""
        # Simulated points pile up: there a clipped cell is noisy, too.
        if self._is_frame_aware and self._window > 1:
            denoised = with_saturated(denoised, frame.levels)
        if not self._keeps_outside or geometry is None or geometry.layout == "polar":
            return denoised
        outside = outside_of(geometry, *frame.levels.shape[:2])
        kept = denoised.copy()
        kept[outside] = frame.levels[outside]
        return kept


def _of_copy(denoised: Future[Array], frame: SequenceFrame, copy: SequenceFrame) -> Array:
    """What was made of a frame, with what its copy shows besides, such as a clock."""
    result = denoised.result()
    if np.array_equal(copy.levels, frame.levels) or copy.levels.shape != result.shape:
        return result
    apart = np.abs(grey_of(copy.levels) - grey_of(frame.levels))
    apart = cv2.blur(apart, (_COPY_WINDOW_PX, _COPY_WINDOW_PX))
    wide = np.ones((_COPY_WINDOW_PX, _COPY_WINDOW_PX), np.uint8)
    changed = cv2.dilate((apart > _CHANGED).astype(np.uint8), wide) > 0
    geometry = frame.geometry
    if geometry is not None and geometry.layout != "polar":
        changed = changed | outside_of(geometry, *changed.shape)
    result = result.copy()
    result[changed] = copy.levels[changed]
    return result


def _brightened(levels: Array, gain: float) -> Array:
    if gain == 1:
        return levels
    return np.minimum(levels * np.float32(gain), np.float32(1))


def _channels(levels: Array) -> list[Array]:
    """The planes, (H, W), of a frame of one or several channels."""
    if levels.ndim == 2:
        return [levels]
    return [np.ascontiguousarray(levels[..., channel]) for channel in range(levels.shape[2])]


def _joined(planes: list[Array]) -> Array:
    return planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)
