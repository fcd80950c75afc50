"""Whether a picture without a word about its origin shows the paper's noise of points.

Shards say how they were formed; a PNG says nothing, and the weights for one kind of noise harm
pictures of the other by decibels.  Points show: cells without any echo between bright ones,
scatter that falls with the mean as counts do, no grain wider than a cell.  A small network on such
figures of a picture says how likely it is that `simnfnd-paper` gains more than `simnfnd`.  It was
fitted by `python -m tools.fit_points` to what both gain on drawn pictures of either kind.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ....factory.sonar.geometry import FanGeometry
from ..pictures import Gray

FILE = Path(__file__).parents[2] / "pretrained" / "points.json"
"""What `tools.fit_points` wrote."""
FORMAT = "simnfnd-points/1"

_GREY = np.array([0, 1, 2, 4, 8, 16, 32, 64, 128, 192, 254, 255]) / 255
"""Edges of the histogram; 0 and 255 have bins of their own."""
_MEANS = ((0.01, 0.03), (0.03, 0.08), (0.08, 0.2), (0.2, 0.4), (0.4, 0.7))
"""Local means within which scatter is measured."""
_LAGS = ((0, 1), (1, 0), (0, 2), (2, 0), (1, 1))
_MOST = 3.0
_LEAST = 100
"""Pixels that a figure needs; with fewer it is 0."""


def likelihood(gray: Gray, geometry: FanGeometry | None = None) -> float:
    """How likely it is, 0 to 1, that the weights for points gain more on a picture.

    gray: (H, W) float32 in 0..1.  geometry: where its sector lies, if that is known.
    """
    return float(judged(figures(gray, geometry), _judge()))


def judged(
    found: npt.NDArray[np.float64], judge: Mapping[str, npt.NDArray[np.float64]]
) -> npt.NDArray[np.float64]:
    """The likelihood (...) from figures (..., 46)."""
    values = standardised(found, judge)
    hidden = np.tanh(values @ judge["first"].T + judge["first_bias"])
    return np.asarray(1 / (1 + np.exp(-(hidden @ judge["last"] + judge["last_bias"]))))


def standardised(
    found: npt.NDArray[np.float64], judge: Mapping[str, npt.NDArray[np.float64]]
) -> npt.NDArray[np.float64]:
    """Figures (..., 46) in spreads from the mean of those fitted to, at most _MOST of them.

    Further out, where a flat picture or one of pure noise lies, nothing was fitted.
    """
    return np.asarray(np.clip((found - judge["mean"]) / judge["spread"], -_MOST, _MOST))


def figures(gray: Gray, geometry: FanGeometry | None = None) -> npt.NDArray[np.float64]:
    """(46,) figures of a picture (H, W) in 0..1, of its sector alone.

    Shares of grey values (log), spread over mean in windows of 7x7 by their mean (is there any; log
    of the 10th, 50th and 90th percentile), correlation of neighbours by mean, shares of empty and
    of saturated pixels beside bright ones, of lone bright ones, and the height (log).
    """
    gray = np.ascontiguousarray(gray, np.float32)
    sector = _sector(gray, geometry)
    inside = gray[sector]
    counts = np.histogram(inside, np.append(_GREY - 1e-6, 1.1))[0]
    mean = _box(gray, 7)
    spread = np.sqrt(np.maximum(_box(gray * gray, 7) - mean * mean, 0))
    whole = _box(sector.astype(np.float32), 7) > 0.999
    found = [*np.log(np.maximum(counts / inside.size, 1e-4))]
    for least, most in _MEANS:
        here = whole & (mean >= least) & (mean < most)
        if here.sum() < _LEAST:
            found += [0.0] * 4
            continue
        parts = np.percentile(spread[here] / mean[here], [10, 50, 90])
        found += [1.0, *np.log(parts + 0.01)]
    found += _correlations(gray, mean, whole)
    bright = sector & (mean > 0.1)
    empty = (gray <= 1.5 / 255) & (cv2.dilate(gray, np.ones((3, 3), np.uint8)) > 0.25)
    about = bright.sum() + _LEAST
    alone = (gray > 0.05) & (9 * _box(gray, 3) - gray < 0.02) & sector
    found += [
        np.log(((empty & bright).sum() + 1) / about),
        np.log((bright & (gray >= 254.5 / 255)).sum() / about + 1e-3),
        np.log(alone.sum() / inside.size + 1e-4),
        np.log(len(gray)),
    ]
    return np.asarray(found, np.float64)


def _sector(gray: Gray, geometry: FanGeometry | None) -> npt.NDArray[np.bool_]:
    """Pixels (H, W) of the sector; without geometry those near anything that is not black."""
    if geometry is not None:
        found = geometry.sector_mask(*gray.shape)
    else:
        near = np.ones((31, 31), np.uint8)
        lit = (gray > 0).astype(np.uint8)
        found = cv2.morphologyEx(lit, cv2.MORPH_CLOSE, near).astype(bool)
    return found if found.any() else np.ones(gray.shape, bool)


def _correlations(gray: Gray, mean: Gray, whole: npt.NDArray[np.bool_]) -> list[float]:
    """Correlation with neighbours of the rest over windows of 5x5, on dark and bright ground."""
    rest = gray - _box(gray, 5)
    found = []
    shifted = [rest * np.roll(rest, lag, (0, 1)) for lag in _LAGS]
    for least, most in ((0.01, 0.1), (0.1, 0.4)):
        here = whole & (mean >= least) & (mean < most)
        if here.sum() < _LEAST:
            found += [0.0] * len(_LAGS)
            continue
        power = float(np.square(rest[here]).mean()) + 1e-9
        found += [float(product[here].mean()) / power for product in shifted]
    return found


def _box(image: Gray, side: int) -> Gray:
    return np.asarray(cv2.blur(image, (side, side), borderType=cv2.BORDER_REFLECT), np.float32)


def saved(judge: Mapping[str, npt.NDArray[Any]], facts: Mapping[str, Any]) -> str:
    """The text of FILE: what `likelihood` needs (`mean`, `spread`, `first`, ...), and `facts`."""
    numbers = {name: np.round(np.asarray(value), 5).tolist() for name, value in judge.items()}
    return json.dumps({"format": FORMAT, **facts, "judge": numbers}) + "\n"


@lru_cache(maxsize=1)
def _judge() -> dict[str, npt.NDArray[np.float64]]:
    content = json.loads(FILE.read_text(encoding="utf-8"))
    return {name: np.asarray(value, np.float64) for name, value in content["judge"].items()}
