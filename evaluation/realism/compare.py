"""Real against simulated, and real against real, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.seeds import stream
from .distances import STATISTICS, Rows, Statistic, prepare
from .measure import Measured

_BLOCKS = 12
SMALLEST = 8
"""Pictures that each side needs: fewer leave no half to compare."""


@dataclass(frozen=True)
class Interval:
    """Mean of the resamples and their 2.5 and 97.5 percentiles."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """One statistic.  baseline: real against real.  distance: simulation -> real against it."""

    statistic: Statistic
    baseline: Interval
    distance: Mapping[str, Interval]

    def ratio(self, name: str) -> float:
        """Distance over baseline: 1 is what a perfect simulation would reach."""
        return ratio(self.distance[name].mean, self.baseline.mean)


def ratio(distance: float, baseline: float) -> float:
    """Distance over baseline; a baseline of 0 counts as the smallest number there is above it."""
    if not (np.isfinite(distance) and np.isfinite(baseline)):
        return float("nan")
    return distance / max(baseline, 1e-9)


def compare(
    real: Measured,
    simulated: Mapping[str, Measured],
    *,
    resamples: int,
    halves: str,
    seed: int,
    statistics: Sequence[Statistic] = STATISTICS,
    progress: bool = True,
) -> list[Comparison]:
    """Every statistic that exists on both sides.

    Each resample halves the real pictures anew into A and B, and draws as many of each simulation
    as there are in A: baseline d(A, B), distance d(A, S).  All sets have one size, so a simulation
    that is no different has the baseline as its distance, however few pictures there are.  Half of
    each set without replacement: the spread of the resamples is that of the whole sets' figures
    (McCarthy 1969), which is the interval given.  Raises FactoryError for too few pictures.
    """
    size = half_size(real, simulated)
    found = {
        (statistic.name, name): np.empty(resamples)
        for statistic in statistics
        for name in ("", *simulated)
    }
    own = prepare(real, real)
    beside = {name: prepare(real, other) for name, other in simulated.items()}
    rng = stream(seed, "realism", "halves", halves)
    turns = range(resamples)
    for turn in progress_bar(turns, desc="distances", unit="resample") if progress else turns:
        first, second = _halves(len(real), size, halves, rng)
        drawn = {name: rng.permutation(len(m))[:size] for name, m in simulated.items()}
        for statistic in statistics:
            found[statistic.name, ""][turn] = statistic.distance(own, first, second)
            for name, rows in drawn.items():
                distance = statistic.distance(beside[name], first, rows)
                found[statistic.name, name][turn] = distance
    result = []
    for statistic in statistics:
        intervals = {name: _interval(found[statistic.name, name]) for name in ("", *simulated)}
        if any(np.isfinite(interval.mean) for interval in intervals.values()) and np.isfinite(
            intervals[""].mean
        ):
            result.append(Comparison(statistic, intervals.pop(""), intervals))
    return result


def half_size(real: Measured, simulated: Mapping[str, Measured]) -> int:
    """Pictures in every half.  Raises FactoryError when a side has too few."""
    for name, measured in {"real": real, **simulated}.items():
        if len(measured) < SMALLEST:
            raise FactoryError(
                f"{name}: {len(measured)} pictures; at least {SMALLEST} are needed to compare "
                "halves (more make narrower intervals)"
            )
    return min(len(real), *(len(measured) for measured in simulated.values())) // 2


def _halves(count: int, size: int, how: str, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """Rows of two sets of `size` that have none in common."""
    if how == "random":
        order = rng.permutation(count)
        return order[:size], order[size : 2 * size]
    blocks = np.array_split(np.arange(count), min(_BLOCKS, count // 2))
    order = rng.permutation(len(blocks))
    joined = np.concatenate([blocks[number] for number in order])
    # At most one block is cut: that where the halves meet.
    first, second = joined[: count // 2], joined[count // 2 :]
    return rng.permutation(first)[:size], rng.permutation(second)[:size]


def _interval(values: npt.NDArray[np.float64]) -> Interval:
    known = values[np.isfinite(values)]
    # A figure that only some resamples have is no figure.
    if known.size < values.size:
        return Interval(float("nan"), float("nan"), float("nan"))
    low, high = np.quantile(known, [0.025, 0.975])
    return Interval(float(known.mean()), float(low), float(high))


def overall(comparisons: Sequence[Comparison], name: str) -> dict[str, float]:
    """The whole table in three numbers.

    geometric_mean_ratio: geometric mean of max(ratio, 1).  within_2: part of the statistics with a
    ratio up to 2.  median_ratio.
    """
    ratios = np.array([item.ratio(name) for item in comparisons])
    ratios = ratios[np.isfinite(ratios)]
    if not ratios.size:
        return dict.fromkeys(("geometric_mean_ratio", "median_ratio", "within_2"), float("nan"))
    return {
        "geometric_mean_ratio": float(np.exp(np.log(np.maximum(ratios, 1)).mean())),
        "median_ratio": float(np.median(ratios)),
        "within_2": float((ratios <= 2).mean()),
    }
