"""Compiled loop from expected intensities to expected grey values; see `factory.compiled`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...compiled import compiled
from ...elementary import log10

Floats = npt.NDArray[np.float32]

# Far below every level that is shown, and no subnormal number.
_FAINTEST = np.float32(1e-37)


@compiled(
    "void(float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], float32, float32,"
    " Array(float32, 1, 'C', readonly=True), Array(float32, 2, 'C', readonly=True), float32,"
    " float32, float32[:, ::1])"
)
def displayed(
    echo: Floats,
    noise: Floats,
    steady: Floats,
    textured: Floats,
    looks: float,
    full_scale: float,
    shifts_db: Floats,
    table: Floats,
    low_db: float,
    steps_per_db: float,
    grey: Floats,
) -> None:
    """Look up the expected grey value of each bin; see `expected.Expected` and `expected.display`.

    shifts_db: what texture does to a level, at equal steps of the variance that it brings, from
    none to that of a bin of textured echo alone.  table: grey values at equal steps of the variance
    of the rest, 0 to 1, and of the level from `low_db` on.
    """
    rows, beams = echo.shape
    one, ten, zero = np.float32(1), np.float32(10), np.float32(0)
    shift_steps, variance_steps = np.float32(shifts_db.shape[0] - 1), np.float32(len(table) - 1)
    last_shift, last_variance = np.int32(shifts_db.shape[0] - 2), np.int32(len(table) - 2)
    last_level, per_look = np.float32(table.shape[1] - 1.001), one / np.float32(looks)
    level_db, total_of = np.empty(beams, np.float32), np.empty(beams, np.float32)
    shift_at, variance_at = np.empty(beams, np.float32), np.empty(beams, np.float32)
    for row in range(rows):
        echoes, noises, steadies, texture = echo[row], noise[row], steady[row], textured[row]
        # First what a processor does for many bins at once, then what must be looked up.
        for beam in range(beams):
            total_of[beam] = echoes[beam] + noises[beam] + steadies[beam] + np.float32(1e-37)
        for beam in range(beams):
            part = min(texture[beam] / total_of[beam], one)
            fixed = min(steadies[beam] / total_of[beam], one)
            shift_at[beam] = part * part * shift_steps
            variance_at[beam] = (one - fixed * fixed) * per_look * variance_steps
        for beam in range(beams):
            level_db[beam] = ten * log10(max(total_of[beam] / full_scale, _FAINTEST))
        made = grey[row]
        for beam in range(beams):
            step = min(np.int32(shift_at[beam]), last_shift)
            low, high = shifts_db[np.uint32(step)], shifts_db[np.uint32(step + 1)]
            shift_db = low + (shift_at[beam] - np.float32(step)) * (high - low)
            level_db[beam] = (level_db[beam] + shift_db - low_db) * steps_per_db
        for beam in range(beams):
            place = min(max(level_db[beam], zero), last_level)
            left = np.uint32(np.int32(place))
            away = place - np.float32(left)
            lower = min(np.int32(variance_at[beam]), last_variance)
            calm, lively = table[np.uint32(lower)], table[np.uint32(lower + 1)]
            first = calm[left] + away * (calm[left + np.uint32(1)] - calm[left])
            other = lively[left] + away * (lively[left + np.uint32(1)] - lively[left])
            made[beam] = first + (variance_at[beam] - np.float32(lower)) * (other - first)


@compiled("void(float32[:, ::1], int64, float32, float32)")
def leaked(intensity: Floats, step: int, leak: float, alike: float) -> None:
    """Add what leaks into beams `step` to the left and to the right, as expected intensities.

    leak: of amplitude.  alike: correlation of beams so far apart; what is alike adds in phase.
    """
    rows, beams = intensity.shape
    wide = np.zeros(beams + 2 * step, np.float32)
    left, middle, right = wide[:beams], wide[step : step + beams], wide[2 * step :]
    square, double = np.float32(leak * leak), np.float32(2 * leak * alike)
    for row in range(rows):
        made = intensity[row]
        for beam in range(beams):
            middle[beam] = np.sqrt(made[beam])
        for beam in range(beams):
            both = left[beam] * left[beam] + right[beam] * right[beam]
            in_phase = double * middle[beam] * (left[beam] + right[beam])
            made[beam] = max(made[beam] + square * both + in_phase, np.float32(0))
