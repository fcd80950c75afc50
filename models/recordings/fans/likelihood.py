"""How well an outline explains which pixels of an image are lit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....factory.common.array_types import Float64s
from .lit_pixels import LitPixels, PixelCounts
from .outline import AnchorRows, Outline
from .sector import Sector

INVALID_COST = 1e9
"""Cost of an outline without a sector; any sector in an image of 2^26 pixels costs less."""
_MAX_FIT_COLUMNS = 400  # a fit takes every n-th column of wider images
# Limits of the probabilities, so that no pixel of an image is impossible.
_INSIDE_LIMITS = 0.05, 0.97
_OUTSIDE_LIMITS = 1e-3, 0.05


class LitProbabilities(NamedTuple):
    """The probability that a pixel is lit, inside the sector and outside."""

    inside: float
    outside: float


def estimate_probabilities(lit_pixels: LitPixels, sector: Sector) -> LitProbabilities | None:
    """The shares of lit pixels inside and outside a sector; None where the inside is not brighter.

    They are the estimates of greatest likelihood, within limits.
    """
    counts = lit_pixels.count_fractional(sector)
    area_outside = max(lit_pixels.pixel_count - counts.area, 1.0)
    lit_outside = lit_pixels.lit_count - counts.lit
    inside = float(np.clip(counts.lit / max(counts.area, 1.0), *_INSIDE_LIMITS))
    outside = float(np.clip(lit_outside / area_outside, *_OUTSIDE_LIMITS))
    return LitProbabilities(inside, outside) if inside > outside else None


class OutlineLikelihood:
    """Negative log-likelihood of outlines, given which pixels of an image are lit.

    The model: pixels are independent.  Each is lit with probability p inside the sector, and with
    probability q, smaller than p, outside.  An image with L lit and B black pixels inside, and L'
    and B' outside, has the log-likelihood

        L log p + B log(1 - p) + L' log q + B' log(1 - q).

    L + L' and B + B' are the same for every sector.  Up to this constant, the negative
    log-likelihood is therefore a sum over the pixels inside alone, the cost of the sector:

        B log((1 - q) / (1 - p)) - L log(p / q).

    Each lit pixel that a sector includes lowers its cost and each black pixel raises it, by finite
    amounts: shadows inside and text outside do not spoil a fit.
    """

    def __init__(
        self, lit_pixels: LitPixels, anchors: AnchorRows, probabilities: LitProbabilities
    ) -> None:
        """anchors: the rows at which the outlines state their edges."""
        self._lit_pixels = lit_pixels
        self._anchors = anchors
        p, q = probabilities
        self._lit_gain = math.log(p / q)
        self._black_cost = math.log((1 - q) / (1 - p))
        self._column_step = max(1, lit_pixels.width // _MAX_FIT_COLUMNS)

    def smooth_cost(self, outline: Outline) -> float:
        """Cost by parts of pixels, smooth for a fit; `INVALID_COST` without a sector."""
        sector = outline.to_sector(self._anchors)
        if sector is None:
            return INVALID_COST
        counts = self._lit_pixels.count_fractional(sector, self._column_step)
        return float(self._cost(counts))

    def whole_pixel_costs(self, outlines: Sequence[Outline]) -> Float64s:
        """(n,) costs by whole pixels, exact to a pixel; `INVALID_COST` without a sector."""
        sectors = [outline.to_sector(self._anchors) for outline in outlines]
        costs = np.full(len(sectors), INVALID_COST)
        is_valid = [sector is not None for sector in sectors]
        valid = [sector for sector in sectors if sector is not None]
        if valid:
            costs[is_valid] = self._cost(self._lit_pixels.count_whole(valid, self._column_step))
        return costs

    def _cost(self, counts: PixelCounts) -> Any:
        sampled_cost = self._black_cost * counts.black - self._lit_gain * counts.lit
        return sampled_cost * self._column_step
