"""Means with an honest uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from factory.seeds import stream


@dataclass(frozen=True)
class Estimate:
    """A mean over images with its 95 % interval; all NaN when there was nothing to average."""

    mean: float
    low: float
    high: float
    median: float
    count: int


def estimate(
    values: npt.NDArray[np.float64], groups: Sequence[str], *, resamples: int, seed: int
) -> Estimate:
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
    draws = stream(seed, "bootstrap").integers(0, names.size, size=(resamples, names.size))
    means = sums[draws].sum(axis=1) / counts[draws].sum(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return Estimate(
        float(values.mean()), float(low), float(high), float(np.median(values)), int(values.size)
    )
