"""Means with an honest uncertainty, and samples spread evenly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np

from ...factory.common.array_types import Float64s
from ...factory.common.seeds import stream

if TYPE_CHECKING:
    from ...factory.common.array_types import Float64s

T = TypeVar("T")


def evenly(every: Sequence[T], most: int | None) -> list[T]:
    """Choose at most this many items, evenly spread; None: all."""
    count = len(every) if most is None else min(most, len(every))
    return [every[number * len(every) // count] for number in range(count)]


class FigureEstimate(NamedTuple):
    """A figure with its 95 % bootstrap interval; NaN where there is nothing to measure."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Estimate:
    """A mean over images with its 95 % interval; all NaN when there was nothing to average.

    low, high: NaN where the images are of one group, which has no interval.
    """

    mean: float
    low: float
    high: float
    median: float
    count: int


def estimate(values: Float64s, groups: Sequence[str], *, resamples: int, seed: int) -> Estimate:
    """Mean of `values` (N,) with its 95 % percentile-bootstrap interval.

    groups: (N,) what each value belongs to.  Whole groups are drawn, because several noise variants
    of one frame say less than as many frames.  NaN values are left out.
    """
    known = np.isfinite(values)
    values = values[known]
    if not values.size:
        return Estimate(np.nan, np.nan, np.nan, np.nan, 0)
    names, member = np.unique(np.asarray(groups)[known], return_inverse=True)
    sums = np.bincount(member, weights=values)
    counts = np.bincount(member)
    mean = float(values.mean())
    median = float(np.median(values))
    if names.size < 2:
        return Estimate(mean, np.nan, np.nan, median, int(values.size))
    draws = stream(seed, "bootstrap").integers(0, names.size, size=(resamples, names.size))
    means = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Estimate(mean, float(low), float(high), median, int(values.size))


LEAST_FRAMES = 6
"""Frames from which on the test can fall below 0.05: its least p is 2 ** (1 - frames)."""


@dataclass(frozen=True)
class Paired:
    """A comparison of two rows, pair by pair.

    difference: mean of first minus second with its interval.
    p: of the two-sided Wilcoxon signed-rank test over frames; NaN for fewer than `LEAST_FRAMES`.
    wins: share of pairs where the first is better, ties counted half.
    """

    difference: Estimate
    p: float
    wins: float


def paired(
    first: Float64s,
    second: Float64s,
    groups: Sequence[str],
    *,
    better: int,
    resamples: int,
    seed: int,
) -> Paired:
    """Compare the figures (N,) of two methods on the same pairs.

    better: 1 where high is good, -1 where low is.  Pairs where either does not exist are left out.
    The test sees one value a frame, the mean over its noise variants, because they share a clean
    image and are no independent observations (Wilcoxon 1945; scipy).
    """
    both = np.isfinite(first) & np.isfinite(second)
    difference = np.full(both.shape, np.nan)
    difference[both] = first[both] - second[both]
    known = difference[both] * better
    wins = float((known > 0).mean() + 0.5 * (known == 0).mean()) if known.size else np.nan
    names, member = np.unique(np.asarray(groups)[both], return_inverse=True)
    frames = np.bincount(member, weights=difference[both]) / np.maximum(np.bincount(member), 1)
    p = np.nan
    if names.size >= LEAST_FRAMES and np.any(frames != 0):
        from scipy.stats import wilcoxon  # a third of a second to import

        p = float(wilcoxon(frames).pvalue)
    elif names.size >= LEAST_FRAMES:
        p = 1.0
    return Paired(estimate(difference, groups, resamples=resamples, seed=seed), p, wins)


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's adjusted p values (Holm 1979), in the order given; NaN stays and does not count."""
    known = [(p, index) for index, p in enumerate(p_values) if np.isfinite(p)]
    adjusted = [float("nan")] * len(p_values)
    highest = 0.0
    for rank, (p, index) in enumerate(sorted(known)):
        highest = max(highest, min(1.0, p * (len(known) - rank)))
        adjusted[index] = highest
    return adjusted
