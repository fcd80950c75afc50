"""Means of the measured figures and differences between rows, as JSON can hold them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...factory.common.array_types import Float64s
from ..judging.runner import SECONDS
from ..metrics.statistics import Estimate, estimate, holm, paired
from .tables import METRIC_NAMES, plain

if TYPE_CHECKING:
    import pandas as pd

_COMPARED_METRICS = ("psnr", "ssim", "gmsd", "psnr_fan", "ssim_fan", "gmsd_fan", "shadow_iou")


@dataclass(frozen=True, eq=False)
class Estimator:
    """The figures of all rows, and what their bootstrap draws.

    figures: metric -> its values of each pair (rows) by each method (columns, labels).
    groups: frame of each pair, the unit that the bootstrap draws.
    resamples, seed: of the bootstrap.
    """

    figures: Mapping[str, pd.DataFrame]
    groups: Sequence[str]
    resamples: int
    seed: int

    def values(self, metric: str, label: str) -> Float64s:
        """(pairs,) a metric of one row."""
        values: Float64s = self.figures[metric][label].to_numpy()
        return values

    def means(self, label: str) -> dict[str, dict[str, Any]]:
        """Metric -> mean of a row with its interval."""
        return {metric: self._mean(metric, label) for metric in self.figures if metric != SECONDS}

    def _mean(self, metric: str, label: str) -> dict[str, Any]:
        values = self.values(metric, label)
        mean = estimate(values, self.groups, resamples=self.resamples, seed=self.seed)
        return _as_dict(mean)

    def median_milliseconds(self, label: str) -> float:
        """Median time of an image."""
        return 1000 * float(np.median(self.values(SECONDS, label)))

    def differences(self, label: str, reference: str) -> dict[str, dict[str, Any]]:
        """Metric -> mean difference of a row to a reference, pair by pair, with its test."""
        return {
            metric: self._difference(metric, label, reference)
            for metric in _COMPARED_METRICS
            if metric in self.figures
        }

    def _difference(self, metric: str, label: str, reference: str) -> dict[str, Any]:
        comparison = paired(
            self.values(metric, label),
            self.values(metric, reference),
            self.groups,
            better=METRIC_NAMES[metric].better,
            resamples=self.resamples,
            seed=self.seed,
        )
        test = {"p": plain(comparison.p), "wins": plain(comparison.wins)}
        return _as_dict(comparison.difference) | test


def add_holm_p(comparisons: Sequence[Mapping[str, dict[str, Any]]]) -> None:
    """Add `p_holm` to the differences of several rows; each metric is a family of tests.

    comparisons: of each row, as `Estimator.differences` returns them.
    """
    for metric in _COMPARED_METRICS:
        family = [comparison[metric] for comparison in comparisons if metric in comparison]
        p_values = [math.nan if test["p"] is None else test["p"] for test in family]
        for test, adjusted_p in zip(family, holm(p_values), strict=True):
            test["p_holm"] = plain(adjusted_p)


def _as_dict(item: Estimate) -> dict[str, Any]:
    """An estimate for JSON, which has no NaN."""
    return {name: value if name == "count" else plain(value) for name, value in vars(item).items()}
