"""Frames in, denoised frames out, in order: one pass, a window of frames in memory.

Aligning, fusing and measuring follow the order of the frames; the network then runs on as many
fused frames at once as the caller allows, which changes no pixel.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ....factory.sonar.geometry import FanGeometry
from .fusion import Fused, Fusion, Neighbour
from .motion import Aligner, Grey, grey_of, laid_over
from .strength import Predictors, Strength, Weights

FRAMES, MOST_FRAMES = 7, 31

_DARK = 0.02  # grey value up to which a pixel tells nothing of what moved
_CALIBRATED_EVERY, _LONGEST = 8, 4
"""Frames from the first measured one to the second; later intervals are up to so many times it."""

Network = Callable[..., Grey]
"""What denoises a picture, (H, W) float32 in 0..1, by its `FanGeometry` or None; see `Denoiser`.

One with an attribute `knows_frames` that is true is given `frames`, how many count in each pixel.
"""


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame of a sequence.

    key: comes back with the result.  levels: (H, W) or (H, W, C) float32 in 0..1.
    place: says where range and bearing are; asked where they may differ from the frame before.
    shift_px: how far right and down the scene moved since the frame before, where that is known.
    wanted: whether its result is asked for; others only teach the stream what it learns from them.
    is_tracked: whether `place` itself keeps to the frame before, so that it is asked each time.
    """

    key: Any
    levels: Grey
    place: Callable[[], FanGeometry | None] = lambda: None
    shift_px: tuple[float, float] | None = None
    wanted: bool = True
    is_tracked: bool = False


@lru_cache(maxsize=8)
def outside_of(geometry: FanGeometry, height: int, width: int) -> npt.NDArray[np.bool_]:
    """(H, W), the pixels that are not in the sector."""
    return np.asarray(geometry.maps(0, 0, height, width)["sector"] <= 0)


@dataclass(frozen=True, eq=False)
class _Ready:
    """A fused frame.  sigma: (H, W) or (H, W, C) of the noise left in each pixel."""

    fused: Fused
    sigma: Grey
    geometry: FanGeometry | None
    predictors: Predictors | None = None


class InTime:
    """Denoises the frames of one sequence.

    network: None: frames are fused, no more.  frames: of a window, odd.  causal: a window ends with
    its frame.  calibrated: whether the recording chooses the strength; else the usual one is taken.
    keeps_outside: whether pixels around a fan stay as they are.
    tally: what was done: `pictures`, of which `alone` matched no neighbour, and sums over these:
    `frames` in a pixel, share of pixels that `moved`.  at_once: networks that run at the same time;
    with 1 a frame comes out as soon as its window is complete.  strength: chosen so far.
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
        self._network, self._frames, self._causal = network, frames, causal
        self._before = frames - 1 if causal else frames // 2
        self._after = 0 if causal else frames // 2
        self._keeps_outside = keeps_outside
        self._calibrated = calibrated and network is not None and frames > 1
        self._tally = tally if tally is not None else defaultdict(float)
        self._aligner, self._fusion = Aligner(2 * frames), Fusion()
        self._told = bool(getattr(network, "knows_frames", False))
        self.strength = Strength(frames, frame_aware=self._told)
        self._held: dict[int, Shot] = {}
        self._places: dict[int, FanGeometry | None] = {}
        self._measured: dict[int, _Ready] = {}
        self._newest, self._next = -1, 0
        self._last_fit: int | None = None
        self._pool, self._under_way = ThreadPoolExecutor(at_once), at_once if at_once > 1 else 0
        self._running: deque[tuple[Any, Future[Grey]]] = deque()

    def __call__(self, shots: Iterable[Shot]) -> Iterator[tuple[Any, Grey]]:
        """The key of each frame and its levels, denoised."""
        for shot in shots:
            self._newest += 1
            self._held[self._newest] = shot
            if self._frames > 1:
                self._aligner.add(self._newest, grey_of(shot.levels), shot.shift_px)
                # Motions over several frames start from those between neighbours.
                self._aligner.motion(self._newest, self._newest - 1)
            while self._next <= self._newest - self._wait():
                yield from self._one()
        while self._next <= self._newest:
            yield from self._one()
        yield from self._done(0)
        self._pool.shutdown()

    def _wait(self) -> int:
        """How many frames are to come before one is denoised."""
        if self._causal or not self._calibrated:
            return self._after
        # The first wait until the strength is measured; then one beyond a window measures it again.
        first = self._next == 0 and self._newest < self._frames
        return self._frames if first else self._after + 1

    def _one(self) -> Iterator[tuple[Any, Grey]]:
        """Begin the next frame; gives those that are denoised by then."""
        number = self._next
        if self._calibrated:
            due = _CALIBRATED_EVERY * min(max(self.strength.measured, 1), _LONGEST)
            if self._last_fit is None and not self._causal:
                self._calibrate(self._before)
            elif number - (self._last_fit or 0) >= due:
                self._calibrate(number)
        shot = self._held[number]
        # A frame by itself teaches the stream nothing.
        if shot.wanted or self._frames > 1:
            ready = self._measured.pop(number, None) or self._ready(number)
            if self._frames > 1:
                self._count(ready.fused)
            if shot.wanted:
                weights = self.strength.weights
                finished = self._pool.submit(self._finished, ready, weights, shot.levels)
                self._running.append((shot.key, finished))
        self._next += 1
        self._held.pop(number - self._before - 1, None)
        yield from self._done(self._under_way)

    def _count(self, fused: Fused) -> None:
        lit = grey_of(fused.image) > _DARK
        lit = lit if lit.any() else np.ones_like(lit)
        self._tally["pictures"] += 1
        self._tally["frames"] += float(fused.frame_count[lit].mean())
        self._tally["moved"] += 1 - float(fused.static_share[lit].mean())
        self._tally["alone"] += bool(fused.frame_count.max() <= 1)

    def _done(self, most: int) -> Iterator[tuple[Any, Grey]]:
        """What is denoised, in order, until at most so many are under way."""
        while len(self._running) > most:
            key, denoised = self._running.popleft()
            yield key, denoised.result()

    def _ready(self, number: int) -> _Ready:
        shot = self._held[number]
        neighbours = []
        around = range(max(0, number - self._before), min(self._newest, number + self._after) + 1)
        for other in sorted(around, key=lambda one: abs(one - number)):
            found = self._laid(number, other) if other != number else None
            if found is not None:
                neighbours.append(Neighbour(other - number, *found))
        fused = self._fusion(shot.levels, neighbours)
        geometry = self._place(number) if self._network is not None else None
        return _Ready(fused, self._sigma(fused.image, fused.frame_count), geometry)

    def _laid(self, number: int, other: int) -> tuple[Grey, Grey] | None:
        """Another frame over this one; None where it shows something else."""
        levels = self._held[other].levels if other in self._held else None
        if levels is None or levels.shape != self._held[number].levels.shape:
            return None
        motion = self._aligner.motion(number, other)
        return None if motion is None else laid_over(levels, motion)

    def _place(self, number: int) -> FanGeometry | None:
        """Where range and bearing are: as in the nearest frame if that shows the same scene."""
        if self._held[number].is_tracked:
            return self._held[number].place()
        # To find a fan anew in each frame costs more than the network.
        self._places.pop(number - self._frames, None)
        near = min(self._places, key=lambda one: abs(one - number), default=None)
        if near is None or self._aligner.motion(number, near) is None:
            self._places[number] = self._held[number].place()
        else:
            self._places[number] = self._places[near]
        return self._places[number]

    def _sigma(self, picture: Grey, frames: Grey) -> Grey:
        """Of the noise that is left in each pixel; none is asked for of frames by themselves."""
        if self._frames == 1:
            return picture
        root: Grey = np.sqrt(frames)
        return self._fusion.noise.at(picture) / (root if picture.ndim == 2 else root[..., None])

    def _finished(self, ready: _Ready, weights: Weights, levels: Grey) -> Grey:
        """Denoised; around a fan the frame keeps its own levels."""
        denoised, geometry = self._denoised(ready, weights), ready.geometry
        if not self._keeps_outside or geometry is None or geometry.layout == "polar":
            return denoised
        outside = outside_of(geometry, *levels.shape[:2])
        result = denoised.copy()
        result[outside] = levels[outside]
        return result

    def _denoised(self, ready: _Ready, weights: Weights) -> Grey:
        fused, network = ready.fused, self._network
        if network is None:
            return fused.image
        if fused.image.ndim == 3:
            planes = []
            for channel in range(fused.image.shape[2]):
                plane = replace(fused, image=np.ascontiguousarray(fused.image[..., channel]))
                one = _Ready(plane, ready.sigma[..., channel], ready.geometry)
                planes.append(self._denoised(one, weights))
            return np.stack(planes, axis=-1)
        if self._frames == 1:
            return network(fused.image, ready.geometry)
        return weights.apply(ready.predictors or self._predictors(ready), fused.frame_count)

    def _predictors(self, ready: _Ready) -> Predictors:
        assert self._network is not None
        told = {"frames": ready.fused.frame_count} if self._told else {}
        made = self._network(ready.fused.image, ready.geometry, **told)
        return Predictors.of(ready.fused.image, ready.sigma, made)

    def _calibrate(self, number: int) -> None:
        """Measure on a frame which strength predicts one outside its window."""
        outside = number - self._before - 1 if self._causal else number + self._after + 1
        if number < self._before or outside not in self._held:
            return
        self._last_fit = number
        levels = self._held[number].levels
        target = self._laid(number, outside)
        ready = self._measured[number] = self._ready(number)
        if target is None or levels.ndim != 2:
            return
        fused = ready.fused
        where = self._fusion.shows_same(fused, *target)
        one = np.ones_like(fused.frame_count)
        own = _Ready(Fused(levels, one, one), self._sigma(levels, one), ready.geometry)
        self.strength.add_single(self._predictors(own), target[0], where)
        found = self._predictors(ready)
        self._measured[number] = replace(ready, predictors=found)
        full = where & (fused.frame_count > 0.8 * fused.frame_count.max())
        self.strength.add_window(found, target[0], full)
        self.strength.fit()
