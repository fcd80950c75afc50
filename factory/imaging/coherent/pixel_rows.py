"""Compiled loops over a row of rendered pixels; see `simnfnd.factory.compiled`.

`placing.place` puts them together: what a processor does for many pixels at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import compiled

Floats = npt.NDArray[np.float32]

_8, _GOLDEN = np.uint32(8), np.uint32(0x9E3779B9)
# When neighbours are one surface, as in `render.kernels.joints`: parts of the depth, and of a step.
_SMALL_STEP, _LARGE_STEP, _SLOPE_CHANGE = np.float32(0.02), np.float32(0.1), np.float32(3)


@compiled()
def bounded(value: Any, most: Any) -> Any:
    """A whole number from 0 to `most`; NaN is 0."""
    value = value if value > np.float32(0) else np.float32(0)
    return np.int32(value if value < most else most)


@compiled()
def anywhere(pixel: Any) -> Any:
    """A number of 0 to 1 that belongs to a pixel."""
    return np.float32(np.int32(np.uint32(np.uint32(pixel) * _GOLDEN) >> _8)) * np.float32(2.0**-24)


@compiled()
def directions(
    depth_m: Floats,
    across: Floats,
    down: float,
    rotation: Floats,
    position_m: Floats,
    bearing: Floats,
    sine: Floats,
) -> None:
    """Sines of the bearing and of the elevation of a row of pixels.

    A line of elements tells apart the angles to itself alone, so its beams are cones:
    sin(bearing) = sin(azimuth) cos(elevation).  What lies behind the sonar has a bearing beyond
    every sector, and NaN without depth.
    """
    # Local names: the compiler then knows that what it writes changes none of them.
    a0, a1, a2 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    b0, b1, b2 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    c0, c1, c2 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    px, py, pz = position_m[0], position_m[1], position_m[2]
    for column in range(depth_m.shape[0]):
        z = depth_m[column]
        x_, y_, z_ = across[column] * z - px, down * z - py, z - pz
        x = a0 * x_ + a1 * y_ + a2 * z_
        y = b0 * x_ + b1 * y_ + b2 * z_
        up = c0 * x_ + c1 * y_ + c2 * z_
        per_range = np.float32(1) / np.sqrt(x * x + y * y + up * up)
        bearing[column] = -y * per_range if x > 0 else np.float32(np.inf)
        sine[column] = up * per_range


@compiled()
def strengths(
    depth_m: Floats,
    radiance: Floats,
    across: Floats,
    down: float,
    position_m: Floats,
    ground_up: Floats,
    near_m: float,
    bins_per_m: float,
    bin_row: Floats,
    value: Floats,
) -> None:
    """Fractional range bin, and radiance times solid angle (without 1 / fx fy), of a row of pixels.

    ground_up: the sonar's upward axis in camera axes where ranges count along the ground, else 0.
    """
    one = np.float32(1)
    px, py, pz = position_m[0], position_m[1], position_m[2]
    g0, g1, g2 = ground_up[0], ground_up[1], ground_up[2]
    for column in range(depth_m.shape[0]):
        a, z = across[column], depth_m[column]
        x_, y_, z_ = a * z - px, down * z - py, z - pz
        up = g0 * x_ + g1 * y_ + g2 * z_
        square_m2 = x_ * x_ + y_ * y_ + z_ * z_ - up * up
        bin_row[column] = (np.sqrt(max(square_m2, np.float32(0))) - near_m) * bins_per_m
        # Solid angle of a pixel is cos^3 / (fx fy).
        square = one / (one + a * a + down * down)
        value[column] = radiance[column] * square * np.sqrt(square)


@compiled()
def far_ends(
    before_m: Floats,
    here_m: Floats,
    below_m: Floats,
    after_m: Floats,
    start: Floats,
    start_below: Floats,
    end: Floats,
) -> None:
    """Where the pixels of a row end: where those below begin, if both are one surface.

    before_m ... after_m: depths of four rows, this one the second.  start, end: range bins.
    """
    for column in range(here_m.shape[0]):
        z, z_below = here_m[column], below_m[column]
        nearer_m, step_m = min(z, z_below), z_below - z
        size_m = abs(step_m)
        # The ground far away is a run of large steps; an outline is a single one.
        first_m, next_m = z - before_m[column], after_m[column] - z_below
        run_m = max(first_m, next_m) if step_m > 0 else -min(first_m, next_m)
        sloping = (size_m < _LARGE_STEP * nearer_m) & (size_m < _SLOPE_CHANGE * run_m)
        joined = (size_m < _SMALL_STEP * nearer_m) | sloping
        end[column] = start_below[column] if joined else start[column]


@compiled()
def heard(
    value: Floats,
    bearing: Floats,
    start: Floats,
    end: Floats,
    low: float,
    high: float,
    rows: int,
    lit: npt.NDArray[np.uint8],
    columns: npt.NDArray[np.uint32],
) -> int:
    """The lit pixels of a row inside the sector and the range window; returns how many."""
    zero, beyond, count = np.float32(0), np.float32(rows), np.uint32(0)
    for column in range(value.shape[0]):
        near, far = min(start[column], end[column]), max(start[column], end[column])
        inside = (value[column] > zero) & (low <= bearing[column]) & (bearing[column] < high)
        lit[column] = np.uint8(inside & (far >= zero) & (near < beyond))
    for column in range(value.shape[0]):
        columns[count] = column
        count += np.uint32(lit[column])
    return int(count)


@compiled()
def looked_for(
    bearing: Floats,
    sine: Floats,
    low: float,
    beam_scale: float,
    most: Any,
    steps: int,
    guess: npt.NDArray[np.int32],
    step: npt.NDArray[np.int32],
    part: Floats,
) -> None:
    """Where to look for the beam and the vertical pattern of a row of pixels.

    guess, most: place in the table of beams and its last.  step, part: place in the pattern, and
    how far towards the next.
    """
    half_steps, last = np.float32(0.5 * steps), np.float32(steps - 1)
    for column in range(bearing.shape[0]):
        guess[column] = bounded((bearing[column] - low) * beam_scale, most)
        place = (sine[column] + np.float32(1)) * half_steps
        step[column] = bounded(place, last)
        part[column] = place - np.float32(step[column])


@compiled()
def spread(
    start: Floats,
    end: Floats,
    first_pixel: int,
    rows: int,
    beams: int,
    short: npt.NDArray[np.uint8],
    near_bin: npt.NDArray[np.int32],
    far_bin: npt.NDArray[np.int32],
    share: Floats,
    one_bin: npt.NDArray[np.int32],
    part: Floats,
) -> None:
    """What of a row of pixels falls into which range bins, for those that cover at most one.

    short: whether they do, inside the window.  near_bin, far_bin: bins of beam 0 in which the
    pixel begins and ends; share: what is in the near one.  one_bin: that of a scatterer anywhere
    in between; part: how far towards `end` it lies.
    """
    zero, one, tiny = np.float32(0), np.float32(1), np.float32(1e-6)
    beyond, last_row, stride = np.float32(rows), np.float32(rows - 1), np.int32(beams)
    for column in range(start.shape[0]):
        near, far = min(start[column], end[column]), max(start[column], end[column])
        span = far - near
        short[column] = np.uint8((span <= one) & (near >= zero) & (far < beyond))
        first, last = bounded(near, last_row), bounded(far, last_row)
        inside = min((np.float32(last) - near) / max(span, tiny), one)
        share[column] = inside if last > first else one
        near_bin[column], far_bin[column] = first * stride, last * stride
        where = anywhere(np.uint32(first_pixel) + np.uint32(column))
        place = start[column] + where * (end[column] - start[column])
        one_bin[column] = bounded(place, last_row) * stride
        part[column] = where if end[column] != start[column] else zero
