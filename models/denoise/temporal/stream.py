"""Frames in, denoised frames out, in order: one pass, a window of frames in memory.

Aligning, fusing and measuring follow the order of the frames; the network then runs on as many
fused frames at once as the caller allows, which changes no pixel.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from ....factory.sonar.geometry import FanGeometry
from .fusion import Fused, Fusion
from .motion import Aligner, Grey, grey_of, laid_over
from .strength import Predictors, Strength, Weights, predictors

FRAMES, MOST_FRAMES = 7, 31

_DARK = 0.02  # grey value up to which a pixel tells nothing of what moved
_CALIBRATED_EVERY, _LONGEST = 8, 4
"""Frames from the first measured one to the second; later intervals are up to so many times it."""

_SIDE_PX = 256  # pictures are compared about this large
_APART, _MOST_APART = 0.03, 0.01
"""Grey values that differ, and the part of the surroundings that may."""
_LEAST_AROUND = 0.01  # part of a picture around the fan, else nothing says that it stays
_RIM = np.ones((9, 9), np.uint8)
_STILL_LIT = 0.75  # of the rim that was lit when the fan was found
_WITHOUT = 7  # frames after one without a fan that are believed to have none

Key = TypeVar("Key")


Network = Callable[..., Grey]
"""What denoises a picture, (H, W) float32 in 0..1, by its `FanGeometry` or None; see `Denoiser`.

One with an attribute `knows_frames` that is true is given `frames`, how many count in each pixel.
"""


@dataclass(frozen=True, eq=False)
class Shot(Generic[Key]):
    """A frame of a sequence.

    key: comes back with the result.  levels: (H, W) or (H, W, C) float32 in 0..1.
    place: says where range and bearing are; asked where they may differ from the frame before.
    shift_px: how far right and down the scene moved since the frame before, where that is known.
    """

    key: Key
    levels: Grey
    place: Callable[[], FanGeometry | None] = lambda: None
    shift_px: tuple[float, float] | None = None


@dataclass
class Tally:
    """What was done: pictures, of which `alone` matched no neighbour; sums over pictures."""

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
            "frames matched no neighbour"
        )
        for strength in self.strengths:
            yield f"strength by the recording itself: {strength}"


@dataclass(frozen=True, eq=False)
class _Ready:
    """A fused frame.  sigma: (H, W) or (H, W, C) of the noise left in each pixel."""

    fused: Fused
    sigma: Grey
    geometry: FanGeometry | None
    network: Grey | None = None


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
        at_once: int = 1,
    ) -> None:
        """network: None: frames are fused, no more.  frames: of a window, odd.

        causal: a window ends with its frame.

        calibrated: whether the recording chooses the strength; else the usual one is taken.
        tally: counts what is done.  at_once: networks that run at the same time; with 1 a frame
        comes out of the `push` that completes its window.
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
        self._fan: KeptFan | None = None
        self._measured: dict[int, _Ready] = {}
        self._newest, self._next = -1, 0
        self._last_fit: int | None = None
        self._pool = ThreadPoolExecutor(at_once) if at_once > 1 else None
        self._running: deque[tuple[Key, Future[Grey]]] = deque()
        self._at_once = at_once

    def push(self, shot: Shot[Key]) -> Iterator[tuple[Key, Grey]]:
        """The next frame; gives those that are denoised."""
        self._newest += 1
        self._held[self._newest] = shot
        if self._frames > 1:
            self._aligner.add(self._newest, grey_of(shot.levels), shot.shift_px)
            # Motions over several frames start from those between neighbours.
            self._aligner.motion(self._newest, self._newest - 1)
        while self._next <= self._newest - self._wait():
            yield from self._one()

    def finish(self) -> Iterator[tuple[Key, Grey]]:
        """All that are left."""
        while self._next <= self._newest:
            yield from self._one()
        yield from self._done(0)
        if self._pool is not None:
            self._pool.shutdown()
        if self.strength.measured:
            self._tally.strengths.append(str(self.strength))

    def _wait(self) -> int:
        """How many frames are to come before one is denoised.

        The first wait until the strength is measured; then one frame beyond a window is read, to
        measure it again.
        """
        if self._causal or not self._calibrated:
            return self._after
        first = self._next == 0 and self._newest < self._frames
        return self._frames if first else self._after + 1

    def _one(self) -> Iterator[tuple[Key, Grey]]:
        """Begin the next frame; gives those that are denoised by then."""
        number = self._next
        if self._calibrated:
            due = _CALIBRATED_EVERY * min(max(self.strength.measured, 1), _LONGEST)
            if self._last_fit is None and not self._causal:
                self._calibrate(self._before)
            elif number - (self._last_fit or 0) >= due:
                self._calibrate(number)
        ready = self._measured.pop(number, None) or self._ready(number)
        self._count(ready.fused)
        key, weights = self._held[number].key, self.strength.weights
        self._next += 1
        for old in [one for one in self._held if one < self._next - self._before - 1]:
            del self._held[old]
        if self._pool is None:
            yield key, self._denoised(ready, weights)
            return
        self._running.append((key, self._pool.submit(self._denoised, ready, weights)))
        yield from self._done(self._at_once)

    def _done(self, most: int) -> Iterator[tuple[Key, Grey]]:
        """What is denoised, in order, until at most so many are under way."""
        while len(self._running) > most:
            key, denoised = self._running.popleft()
            yield key, denoised.result()

    def _place(self, number: int) -> FanGeometry | None:
        shot = self._held[number]
        if self._frames == 1:
            return shot.place()
        if self._fan is None or not self._fan.stays(shot.levels):
            self._fan = KeptFan(shot.place(), shot.levels)
        return self._fan.geometry

    def _ready(self, number: int) -> _Ready:
        fused = self._fused(number)
        geometry = self._place(number) if self._network is not None else None
        return _Ready(fused, self._sigma(fused.picture, fused.frames), geometry)

    def _sigma(self, picture: Grey, frames: Grey) -> Grey:
        """Of the noise that is left in each pixel; none is asked for of frames by themselves."""
        if self._frames == 1:
            return picture
        root: Grey = np.sqrt(frames)
        left: Grey = root if picture.ndim == 2 else root[..., None]
        return np.asarray(self._fusion.noise.at(picture) / left)

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

    def _denoised(self, ready: _Ready, weights: Weights) -> Grey:
        network, picture = self._network, ready.fused.picture
        if network is None:
            return picture
        if self._frames == 1:
            return each_plane(picture, lambda grey: network(grey, ready.geometry))
        if picture.ndim == 2:
            return weights.applied(self._predictors(ready), ready.fused.frames)
        planes: list[Grey] = []
        for channel in range(picture.shape[2]):
            plane = np.ascontiguousarray(picture[..., channel])
            fused = Fused(plane, ready.fused.frames, ready.fused.agrees)
            one = _Ready(fused, ready.sigma[..., channel], ready.geometry)
            planes.append(weights.applied(self._predictors(one), fused.frames))
        return np.stack(planes, axis=-1)

    def _predictors(self, ready: _Ready) -> Predictors:
        grey, network = ready.fused.picture, ready.network
        if network is None:
            network = self._by_network(ready)
        return predictors(grey, ready.sigma, network)

    def _by_network(self, ready: _Ready) -> Grey:
        assert self._network is not None
        if self._told:
            return self._network(ready.fused.picture, ready.geometry, frames=ready.fused.frames)
        return self._network(ready.fused.picture, ready.geometry)

    def _calibrate(self, number: int) -> None:
        """Measure on a frame which strength predicts one outside its window."""
        outside = number - self._before - 1 if self._causal else number + self._after + 1
        if number - self._before < 0 or outside not in self._held or number > self._newest:
            return
        self._last_fit = number
        shot = self._held[number]
        target = self._laid(number, outside)
        ready = self._ready(number)
        self._measured[number] = ready
        if target is None or shot.levels.ndim != 2:
            return
        fused = ready.fused
        where = self._fusion.same(fused.picture, *target)
        one = np.ones_like(fused.frames)
        own = _Ready(Fused(shot.levels, one, one), self._sigma(shot.levels, one), ready.geometry)
        self.strength.add(False, self._predictors(own), target[0], where)
        ready = replace(ready, network=self._by_network(ready))
        self._measured[number] = ready
        full = where & (fused.frames > 0.8 * fused.frames.max())
        self.strength.add(True, self._predictors(ready), target[0], full)
        self.strength.fit()

    def _count(self, fused: Fused) -> None:
        if self._frames == 1:
            return
        lit = grey_of(fused.picture) > _DARK
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


class KeptFan:
    """Where range and bearing were found in a frame, and whether they are there in another.

    Finding a fan anew in each frame costs more than the network.  It stays while what lies around
    it stays as it was and what lies along its edges stays lit; a frame without any fan is believed
    for a few more.
    """

    def __init__(self, geometry: FanGeometry | None, levels: Grey) -> None:
        """levels: (H, W) or (H, W, C) in 0..1, the frame in which `geometry` was found."""
        self.geometry = geometry
        self._shape, self._left = levels.shape, _WITHOUT
        if geometry is None:
            return
        inside = geometry.sector_mask(*levels.shape[:2]).astype(np.float32)
        small = _small(inside)
        sector = (small > 0).astype(np.uint8)
        self._seen = _small(grey_of(levels))
        self._around = cv2.dilate(sector, _RIM) == 0
        self._rim: npt.NDArray[np.bool_] = (small > 0.99) & (cv2.erode(sector, _RIM) == 0)
        ground = self._seen[self._around]
        self._level = (float(np.median(ground)) if ground.size else 0.0) + _APART
        self._lit = float((self._seen[self._rim] > self._level).mean()) if self._rim.any() else 0.0
        self._tells = bool(self._around.mean() >= _LEAST_AROUND) and self._lit > 0

    def stays(self, levels: Grey) -> bool:
        """Whether the geometry is that of another frame of the recording, too."""
        if levels.shape != self._shape:
            return False
        if self.geometry is None:
            self._left -= 1
            return self._left >= 0
        if not self._tells:
            return False
        now = _small(grey_of(levels))
        apart = np.abs(now - self._seen)[self._around] > _APART
        lit = float((now[self._rim] > self._level).mean())
        return bool(apart.mean() <= _MOST_APART) and lit >= _STILL_LIT * self._lit


def _small(plane: Grey) -> Grey:
    scale = max(1, max(plane.shape) // _SIDE_PX)
    size = -(-plane.shape[1] // scale), -(-plane.shape[0] // scale)
    return cv2.resize(plane, size, interpolation=cv2.INTER_AREA)
