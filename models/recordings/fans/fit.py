"""The likeliest sector: a simplex search from a first guess, then one parameter after another."""

from __future__ import annotations

import numpy as np

from ....factory.common.array_types import Bools, Float64s
from .first_guess import guess_outline
from .likelihood import OutlineLikelihood, estimate_probabilities
from .lit_pixels import LitPixels
from .outline import Outline
from .sector import Sector
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
