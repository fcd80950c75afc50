"""The likeliest sector: a simplex search from a first guess, then one parameter after another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....factory.common.array_types import Bools, Float64s
from .first_guess import guess_outline
from .lit_pixels import LitPixels, PixelCounts
from .sector import AnchorRows, Outline, Sector
from .simplex import find_lowest_point

_FINE_STEP_PX = 1.0
_SQUEEZE_STEP_PX = 0.5
_LOG_SQUEEZE_STEP = 0.05
_MIN_SQUEEZE_GAIN = 30.0  # log-likelihood by which the arcs must contradict square pixels
_EVALUATIONS_PER_PARAMETER = 40
_ALL_BUT_SQUEEZE = range(Outline._fields.index("log_squeeze"))
_NEAR_THEN_FAR_ARC = Outline._fields.index("near_row"), Outline._fields.index("far_row")
_MOVES = 21  # of each parameter, between its limits
_EQUAL_COST = 1e-6
INVALID_COST = math.inf
"""Cost of an outline without a sector."""
_MAX_FIT_COLUMNS = 400  # a fit takes every n-th column of wider images
# Limits of the probabilities, so that no pixel of an image is impossible.
_INSIDE_LIMITS = 0.05, 0.97
_OUTSIDE_LIMITS = 1e-3, 0.05


def fit_sector(lit: Bools) -> Sector | None:
    """The sector that best separates lit from black pixels, (H, W); None where there is none."""
    guess = guess_outline(lit)
    if guess is None:
        return None
    outline = guess.outline
    lit_pixels = LitPixels(lit)
    # Twice: the first fit improves the estimate of the probabilities.
    for step_px in (guess.cell_px, _FINE_STEP_PX):
        sector = outline.to_sector(guess.anchors)
        if sector is None:
            return None
        probabilities = estimate_probabilities(lit_pixels, sector)
        if probabilities is None:
            return None
        likelihood = OutlineLikelihood(lit_pixels, guess.anchors, probabilities)
        outline = _fit_leading_parameters(likelihood, outline, [step_px] * len(_ALL_BUT_SQUEEZE))

    squeezed = _fit_squeeze(likelihood, outline)
    square_cost = likelihood.smooth_cost(outline)
    if likelihood.smooth_cost(squeezed) < square_cost - _MIN_SQUEEZE_GAIN:
        outline = squeezed
    return _polish(likelihood, outline).to_sector(guess.anchors)


def _fit_squeeze(likelihood: OutlineLikelihood, outline: Outline) -> Outline:
    """The likeliest outline nearby whose pixels need not be square."""
    steps = [_SQUEEZE_STEP_PX] * len(_ALL_BUT_SQUEEZE)
    return _fit_leading_parameters(likelihood, outline, [*steps, _LOG_SQUEEZE_STEP])


def _fit_leading_parameters(
    likelihood: OutlineLikelihood, outline: Outline, first_steps: list[float]
) -> Outline:
    """The likeliest outline nearby, by the simplex search of Nelder and Mead 1965.

    first_steps: of the leading parameters of the outline, which are fitted; the others are fixed.
    """
    free_count = len(first_steps)
    start = np.array(outline[:free_count])
    fixed = outline[free_count:]

    def cost(free: Float64s) -> float:
        return likelihood.smooth_cost(Outline(*free.tolist(), *fixed))

    corners = np.vstack([start, start + np.diag(first_steps)])
    best = find_lowest_point(cost, corners, _EVALUATIONS_PER_PARAMETER * free_count)
    return Outline(*best.tolist(), *fixed)


def _polish(likelihood: OutlineLikelihood, outline: Outline) -> Outline:
    """Move each end of an edge and each arc, one at a time, to where it fits best."""
    # The arcs first, and farther: short arcs hardly count in the fit of the whole outline.
    for parameter in _NEAR_THEN_FAR_ARC:
        outline = _move_parameter(likelihood, outline, parameter, 8.0)
    for reach_px in (1.5, 0.5):
        for parameter in _ALL_BUT_SQUEEZE:
            outline = _move_parameter(likelihood, outline, parameter, reach_px)
    return outline


def _move_parameter(
    likelihood: OutlineLikelihood, outline: Outline, parameter: int, reach_px: float
) -> Outline:
    """Move one parameter by up to `reach_px`, to the centre of all places that fit best."""
    moves_px = np.linspace(-reach_px, reach_px, _MOVES)
    candidates = np.repeat(np.array(outline)[None], _MOVES, axis=0)
    candidates[:, parameter] += moves_px
    outlines = [Outline(*row) for row in candidates.tolist()]
    costs = likelihood.whole_pixel_costs(outlines)
    is_best = costs <= costs.min() + _EQUAL_COST
    return Outline(*candidates[is_best].mean(axis=0).tolist())


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
