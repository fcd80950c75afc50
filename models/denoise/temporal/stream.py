"""Frames in, denoised frames out, in order: one pass, a window of frames in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from ....factory.sonar.geometry import FanGeometry
from .fusion import Fused, Fusion
from .motion import Aligner, Grey, laid_over
from .strength import Predictors, Strength, predictors

FRAMES, MOST_FRAMES = 7, 31

_DARK = 0.02  # grey value up to which a pixel tells nothing of what moved
_CALIBRATED_EVERY = 8
"""Frames from one that the strength is measured on to the next: a tenth of the time."""

Key = TypeVar("Key")


Network = Callable[..., Grey]
"""What denoises a picture, (H, W) float32 in 0..1, by its `FanGeometry` or None; see `Denoiser`.

One with an attribute `knows_frames` that is true is given `frames`, how many count in each pixel.
"""


@dataclass(frozen=True, eq=False)
class Shot(Generic[Key]):
    """A frame of a sequence.

    key: comes back with the result.  levels: (H, W) or (H, W, C) float32 in 0..1.
    place: says where range and bearing are; asked once, when the frame is denoised.
    shift_px: how far right and down the scene moved since the frame before, where that is known.
    """

    key: Key
    levels: Grey
    place: Callable[[], FanGeometry | None] = lambda: None
    shift_px: tuple[float, float] | None = None


@dataclass
class Tally:
    """What was done: pictures, of which `alone` fitted no other; sums over pictures."""

    pictures: int = 0
    alone: int = 0
    frames: float = 0.0
    moved: float = 0.0
    strengths: list[str] = field(default_factory=list)

    def lines(self, frames: int) -> Iterator[str]:
        """For the user; nothing where there was no sequence."""
        if not self.pictures:
            return
        share = 1 / self.pictures
        yield (
            f"in time: {self.frames * share:.1f} of up to {frames} frames fused in a pixel, "
            f"{100 * self.moved * share:.1f} % of pixels moved, {self.alone} of {self.pictures} "
            "pictures fit no other"
        )
        for strength in self.strengths:
            yield f"strength by the recording itself: {strength}"


class InTime(Generic[Key]):
    """Denoises the frames of one sequence.

    strength: chosen so far.
    """

    def __init__(
        self,
        network: Network | None,
        *,
        frames: int = FRAMES,
        causal: bool = False,
        calibrated: bool = True,
        tally: Tally | None = None,
    ) -> None:
        """network: None: frames are fused, no more.  frames: of a window, odd.

        causal: a window ends with its frame.

        calibrated: whether the recording chooses the strength; else the usual one is taken.
        tally: counts what is done.
        """
        self._network, self._frames, self._causal = network, frames, causal
        self._before = frames - 1 if causal else frames // 2
        self._after = 0 if causal else frames // 2
        self._calibrated = calibrated and network is not None and frames > 1
        self._tally = tally if tally is not None else Tally()
        self._aligner, self._fusion = Aligner(2 * frames), Fusion()
        self._told = bool(getattr(network, "knows_frames", False))
        self.strength = Strength(frames, told=self._told)
        self._held: dict[int, Shot[Key]] = {}
        self._places: dict[int, FanGeometry | None] = {}
        self._newest, self._next = -1, 0
        self._last_fit: int | None = None

    def push(self, shot: Shot[Key]) -> Iterator[tuple[Key, Grey]]:
        """The next frame; gives those that can be denoised now."""
        self._newest += 1
        self._held[self._newest] = shot
        if self._frames > 1:
            self._aligner.add(self._newest, _grey(shot.levels), shot.shift_px)
            # Motions over several frames start from those between neighbours.
            self._aligner.motion(self._newest, self._newest - 1)
        yield from self._ready()

    def finish(self) -> Iterator[tuple[Key, Grey]]:
        """All that are left."""
        while self._next <= self._newest:
            yield self._one()
        if self.strength.measured:
            self._tally.strengths.append(str(self.strength))

    def _ready(self) -> Iterator[tuple[Key, Grey]]:
        while self._next <= self._newest - self._wait():
            yield self._one()

    def _wait(self) -> int:
        """How many frames are to come before one is denoised.

        The first wait until the strength is measured; then one frame beyond a window is read, to
        measure it again.
        """
        if self._causal or not self._calibrated:
            return self._after
        first = self._next == 0 and self._newest < self._frames
        return self._frames if first else self._after + 1

    def _one(self) -> tuple[Key, Grey]:
        number = self._next
        if self._calibrated and self._last_fit is None and not self._causal:
            self._calibrate(self._before)
        elif self._calibrated and number - (self._last_fit or 0) >= _CALIBRATED_EVERY:
            self._calibrate(number)
        shot = self._held[number]
        fused = self._fused(number)
        result = self._denoised(fused, self._place(number))
        self._count(fused)
        self._next += 1
        for old in [one for one in self._held if one < self._next - self._before - 1]:
            del self._held[old]
            self._places.pop(old, None)
        return shot.key, result

    def _place(self, number: int) -> FanGeometry | None:
        if number not in self._places:
            self._places[number] = self._held[number].place()
        return self._places[number]

    def _fused(self, number: int) -> Fused:
        shot = self._held[number]
        laid, shown = [], []
        around = range(max(0, number - self._before), min(self._newest, number + self._after) + 1)
        for other in sorted(around, key=lambda one: abs(one - number)):
            found = self._laid(number, other) if other != number else None
            if found is not None:
                laid.append(found[0])
                shown.append(found[1])
        return self._fusion(shot.levels, laid, shown)

    def _laid(self, number: int, other: int) -> tuple[Grey, Grey | None] | None:
        """Another frame over this one; None where it shows something else."""
        if other not in self._held or self._held[other].levels.shape != (
            self._held[number].levels.shape
        ):
            return None
        motion = self._aligner.motion(number, other)
        return None if motion is None else laid_over(self._held[other].levels, motion)

    def _denoised(self, fused: Fused, geometry: FanGeometry | None) -> Grey:
        network = self._network
        if network is None:
            return fused.picture
        if self._frames == 1:
            return each_plane(fused.picture, lambda grey: network(grey, geometry))
        return each_plane(
            fused.picture,
            lambda grey: self.strength.applied(
                self._predictors(grey, fused.frames, geometry), fused.frames
            ),
        )

    def _predictors(self, grey: Grey, frames: Grey, geometry: FanGeometry | None) -> Predictors:
        assert self._network is not None
        if self._told:
            network = self._network(grey, geometry, frames=frames)
        else:
            network = self._network(grey, geometry)
        # Of the noise that is left in a pixel.
        sigma = self._fusion.noise.at(grey) / np.sqrt(frames)
        return predictors(grey, sigma, network)

    def _calibrate(self, number: int) -> None:
        """Measure on a frame which strength predicts one outside its window."""
        outside = number - self._before - 1 if self._causal else number + self._after + 1
        if number - self._before < 0 or outside not in self._held or number > self._newest:
            return
        self._last_fit = number
        shot = self._held[number]
        target = self._laid(number, outside)
        fused = self._fused(number)
        if target is None or shot.levels.ndim != 2:
            return
        geometry = self._place(number)
        where = self._fusion.same(fused.picture, *target)
        one = np.ones_like(fused.frames)
        for whole, grey, frames in (
            (False, shot.levels, one),
            (True, fused.picture, fused.frames),
        ):
            found = self._predictors(grey, frames, geometry)
            full = where & (frames > 0.8 * frames.max()) if whole else where
            self.strength.add(whole, found, target[0], full)
        self.strength.fit()

    def _count(self, fused: Fused) -> None:
        if self._frames == 1:
            return
        lit = _grey(fused.picture) > _DARK
        some = bool(lit.any())
        mean = float(fused.frames[lit].mean()) if some else float(fused.frames.mean())
        self._tally.pictures += 1
        self._tally.frames += mean
        self._tally.moved += 1 - float(fused.agrees[lit].mean()) if some else 0.0
        self._tally.alone += bool(fused.frames.max() <= 1)


def each_plane(levels: Grey, work: Callable[[Grey], Grey]) -> Grey:
    """`work` on each colour of (H, W, C), or on (H, W); equal colours are worked on once."""
    if levels.ndim == 2:
        return work(levels)
    planes: list[Grey] = []
    for channel in range(levels.shape[2]):
        plane = np.ascontiguousarray(levels[..., channel])
        same = channel and np.array_equal(plane, levels[..., 0])
        planes.append(planes[0] if same else work(plane))
    return np.stack(planes, axis=-1)


def _grey(levels: Grey) -> Grey:
    return levels if levels.ndim == 2 else levels.mean(axis=2, dtype=np.float32)
