"""The best point of a filter's grid without trying all of them.

Of one parameter after the other the values of the grid are tried from the present one outwards,
until the score has fallen twice; the last steps halve the ratio between neighbours of the grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from .filters.base import Baseline, Parameters

_ROUNDS = 2
_LEAST = 1e-3  # of the score; less is no gain


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
            if now > top + _LEAST:
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
        if (now := value(point)) > top + _LEAST:
            best, top = point, now
    return best
