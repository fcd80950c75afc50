"""Filters tuned on static groups, and judged on others.

Two folds: each is judged by filters that were tuned on the other, so that no filter is judged on
frames that chose its parameters.  A line search: of one parameter after the other the values of the
filter's grid are tried from the present one outwards, until the score has fallen twice; the last
steps halve the ratio between neighbours of the grid.  The search sees the middle of each frame,
half as high and half as wide; the best points of it are then compared on the whole frames.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..filters import REGISTRY
from ..filters.base import Baseline, Parameters
from ..methods import reason
from ..metrics.statistics import evenly
from .groups import Group, Judged
from .measure import psnr_of

FOLDS = 2
FRAMES_OF_A_GROUP = 2
MOST_FRAMES = 16
"""Frames that a filter is tuned on, and of each group where there are several."""

_SLOW_S, _SLOWER = 0.25, 4  # CPU seconds a picture from which one frame of four has to do
_ROUNDS = 2
_BEST = 2  # points that are compared on whole frames
_LEAST_SIDE = 96  # pixels of the middle of a frame
_LEAST_DB = 1e-3  # less is no gain


@dataclass(frozen=True)
class Part:
    """What is done with a group.

    judged: places of its frames that are judged.  fold: by filters that were tuned in the other.
    tuning: fold -> places of the frames that filters are tuned on for this fold.
    """

    judged: tuple[int, ...]
    fold: int
    tuning: dict[int, tuple[int, ...]]


@dataclass(frozen=True, eq=False)
class Task:
    """A filter to be tuned for a fold, on frames with references."""

    baseline: str
    fold: int
    frames: tuple[Judged, ...]


def parts_of(groups: Sequence[Group]) -> list[Part]:
    """What is tuned on and what is judged: every other group; of a single one its two halves."""
    if len(groups) == 1:
        count = len(groups[0].shots)
        half = count // 2
        tuning = {0: tuple(evenly(range(half), MOST_FRAMES))}
        return [Part(tuple(range(half, count)), 0, tuning)]
    # Of many groups a part is enough to tune on.
    most = MOST_FRAMES // FRAMES_OF_A_GROUP
    used = set()
    for fold in range(FOLDS):
        used |= set(evenly(range(fold, len(groups), FOLDS), most))
    found = []
    for number, group in enumerate(groups):
        every = range(len(group.shots))
        other = (number + 1) % FOLDS
        tuning = {other: tuple(evenly(every, FRAMES_OF_A_GROUP))} if number in used else {}
        found.append(Part(tuple(every), number % FOLDS, tuning))
    return found


def tuned(task: Task) -> Parameters | str:
    """The best parameters of a filter on some frames, or why it failed."""
    baseline = REGISTRY[task.baseline]
    try:
        frames = task.frames
        middles = [_middle(frame) for frame in frames]
        for _ in range(2):  # the first one loads and compiles
            start = time.process_time()
            _psnr(baseline, dict(baseline.default), frames[:1])
        if time.process_time() - start > _SLOW_S:
            frames, middles = frames[::_SLOWER], middles[::_SLOWER]
        points = line_search(baseline, lambda point: _psnr(baseline, point, middles))
        return max(points[:_BEST], key=lambda point: _psnr(baseline, point, frames))
    except Exception as error:  # a method's own defect must not take the others along
        return reason(error)


def line_search(baseline: Baseline, measured: Callable[[Parameters], float]) -> list[Parameters]:
    """The points of a filter's grid that were tried, one parameter after the other; best first.

    measured: the score of a point, high is good.
    """
    points: dict[tuple[float, ...], Parameters] = {}
    known: dict[tuple[float, ...], float] = {}

    def value(point: Parameters) -> float:
        key = tuple(point[name] for name in sorted(point))
        if key not in known:
            known[key], points[key] = measured(point), point
        return known[key]

    best = dict(baseline.default)
    for turn in range(_ROUNDS):
        before = dict(best)
        for name, axis in baseline.grid.items():
            best = _along(best, name, axis, value)
        if best == before or (turn == 0 and len(baseline.grid) == 1):
            break
    for name, axis in baseline.grid.items():
        best = _finer(best, name, axis, value)
    # Of equal ones the first, which is nearer to the default.
    ranked = sorted(points, key=lambda key: -known[key])
    first = tuple(best[name] for name in sorted(best))
    return [points[key] for key in [first, *(key for key in ranked if key != first)]]


def _along(
    start: Parameters,
    name: str,
    axis: Sequence[float],
    value: Callable[[Parameters], float],
) -> Parameters:
    best, top = start, value(start)
    for outwards in (
        [one for one in axis if one > start[name]],
        [one for one in reversed(axis) if one < start[name]],
    ):
        last, falls = value(start), 0
        for one in outwards:
            point = {**start, name: one}
            now = value(point)
            if now > top + _LEAST_DB:
                best, top = point, now
            falls = falls + 1 if now < last else 0
            last = now
            if falls == 2:
                break
    return best


def _finer(
    start: Parameters, name: str, axis: Sequence[float], value: Callable[[Parameters], float]
) -> Parameters:
    """The best of the present value and those half way, in ratio, to its neighbours on the grid."""
    if not all(isinstance(one, float) for one in axis) or start[name] not in axis:
        return start
    place = axis.index(start[name])
    best, top = start, value(start)
    for neighbour in (*axis[max(place - 1, 0) : place], *axis[place + 1 : place + 2]):
        point = {**start, name: float(f"{math.sqrt(start[name] * neighbour):.3g}")}
        if (now := value(point)) > top + _LEAST_DB:
            best, top = point, now
    return best


def _psnr(baseline: Baseline, point: Parameters, frames: Sequence[Judged]) -> float:
    values = []
    for frame in frames:
        assert frame.reference is not None
        picture = baseline(frame.noisy, point)
        values.append(psnr_of(picture, frame.reference, frame.where))
    return float(np.mean(values))


def _middle(frame: Judged) -> Judged:
    """The middle of what is judged of a frame, half as high and half as wide."""
    cut = []
    for places, size in zip(np.nonzero(frame.where), frame.where.shape, strict=True):
        side = min(max(size // 2, _LEAST_SIDE), size)
        first = min(max(int(places.mean()) - side // 2, 0), size - side)
        cut.append(slice(first, first + side))
    part = tuple(cut)
    assert frame.reference is not None
    if not frame.where[part].any():
        return frame
    noisy, reference, where = (
        np.ascontiguousarray(one[part]) for one in (frame.noisy, frame.reference, frame.where)
    )
    return replace(frame, noisy=noisy, reference=reference, where=where)
