"""Compiled loops from rendered pixels to scatterers; see `simnfnd.factory.compiled`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simnfnd.factory.compiled import compiled

Floats = npt.NDArray[np.float32]

_8, _GOLDEN = np.uint32(8), np.uint32(0x9E3779B9)
# When neighbours are one surface, as in `cloud.joined`: parts of the depth, and of a step.
_SMALL_STEP, _LARGE_STEP, _SLOPE_CHANGE = np.float32(0.02), np.float32(0.1), np.float32(3)
# A pixel at grazing incidence is at most so many scatterers.
_MOST_PARTS = 32


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


@compiled(
    "int64(Array(float32, 2, 'C', readonly=True), Array(float32, 2, 'C', readonly=True),"
    " Array(uint8, 2, 'C', readonly=True), Array(float32, 2, 'C', readonly=True), float32[::1],"
    " float32[::1], float32[::1], float32[:, ::1], float32[::1], boolean, float32, float32,"
    " float32[::1], int32[::1], float32, float32[::1], float32[::1], boolean[::1], float32,"
    " int32[::1],"
    " int32[::1], float32[::1], int32[::1], float32[::1], int32[::1])"
)
def place(
    depth_m: Floats,
    radiance: Floats,
    labels: npt.NDArray[np.uint8],
    factor: Floats,
    reflectivity: Floats,
    across: Floats,
    down: Floats,
    rotation: Floats,
    position_m: Floats,
    ground_range: bool,
    near_m: float,
    bins_per_m: float,
    edges: Floats,
    first_beam: npt.NDArray[np.int32],
    beam_scale: float,
    pattern: Floats,
    power: Floats,
    in_beam: npt.NDArray[np.bool_],
    widest_sine: float,
    owner: npt.NDArray[np.int32],
    bin_of: npt.NDArray[np.int32],
    power_of: Floats,
    pixel_of: npt.NDArray[np.int32],
    part_of: Floats,
    row_end: npt.NDArray[np.int32],
) -> int:
    """Each lit pixel as scatterers of polar bins; returns how many there are.

    A pixel covers the ranges from its own to that of the pixel below it, where both are one
    surface.  `power` gets its echo in exact parts.  A scatterer lies anywhere in between, one for
    each range bin that it covers: at grazing incidence there are fewer pixels than bins.

    depth_m, radiance: (H, W).  labels: (H, W), or (0, 0) when all are 0; reflectivity: of each,
    the last of those beyond, too.
    factor: (H, W) multiplies the radiance, or (0, 0).
    across, down: (u - cx) / fx, (v - cy) / fy.  rotation, position_m: sonar axes from camera axes.
    edges: (beams + 1,) sines of the beams' edges; first_beam, beam_scale: a table that says
    where in it to begin.  pattern: vertical intensity pattern at equal steps of sin(elevation) from
    -1 to 1.
    power, owner: (bins,) out, summed power and last pixel of a bin (-1: none).  in_beam: (bins,)
    out, whether a pixel within sin(elevation) of +-widest_sine fills it.
    bin_of, power_of, pixel_of, part_of: (at least pixels,) out; part: how far towards the pixel
    below, 0 to 1.  row_end: (H,) out, how many scatterers there are up to the end of each row.
    """
    height, width = depth_m.shape
    beams = edges.shape[0] - 1
    rows = power.shape[0] // beams
    steps = pattern.shape[0] - 1
    low, high = edges[0], edges[beams]
    half_steps, one, tiny = np.float32(0.5 * steps), np.float32(1), np.float32(1e-6)
    # A row at a time: first what a processor does for many pixels at once, then the rest.
    bearing_of, bin_row_of = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    sine_of, value_of = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    end_of, columns = np.empty(width, np.float32), np.empty(width, np.uint32)
    lit, last_label = np.empty(width, np.uint8), np.uint32(reflectivity.shape[0] - 1)
    ground_up = rotation[2] if ground_range else np.zeros(3, np.float32)
    count = 0
    for row in range(height + 1):
        now, before = row & 1, 1 - (row & 1)
        if row < height:
            directions(
                depth_m[row], across, down[row], rotation, position_m,
                bearing_of[now], sine_of[now],
            )  # fmt: skip
            strengths(
                depth_m[row], radiance[row], across, down[row], position_m, ground_up, near_m,
                bins_per_m, bin_row_of[now], value_of[now],
            )  # fmt: skip
        if row == 0:
            continue
        above = row - 1
        bearings, starts = bearing_of[before], bin_row_of[before]
        sines, values = sine_of[before], value_of[before]
        if row < height:
            far_ends(
                depth_m[max(above - 1, 0)], depth_m[above], depth_m[row],
                depth_m[min(row + 1, height - 1)], starts, bin_row_of[now], end_of,
            )  # fmt: skip
        else:
            end_of[:] = starts
        kept = heard(values, bearings, starts, end_of, low, high, rows, lit, columns)
        for at in range(kept):
            column = columns[at]
            value, bearing = values[column], bearings[column]
            start, end = starts[column], end_of[column]
            near, far = min(start, end), max(start, end)
            guess = min(int((bearing - low) * beam_scale), first_beam.shape[0] - 1)
            beam = first_beam[np.uint32(guess)]
            while bearing >= edges[np.uint32(beam + 1)]:
                beam += 1
            sine = (sines[column] + one) * half_steps
            central = abs(sines[column]) <= widest_sine
            step = np.uint32(min(int(sine), steps - 1))
            part = sine - np.float32(step)
            lower, upper = pattern[step], pattern[np.uint32(step + np.uint32(1))]
            value *= lower + part * (upper - lower)
            label = np.uint32(labels[above, column] if labels.shape[0] else 0)
            value *= reflectivity[min(label, last_label)]
            if factor.shape[0]:
                value *= factor[above, column]
            pixel = above * width + column
            where = np.float32(np.uint32(np.uint32(pixel) * _GOLDEN) >> _8) * np.float32(2.0**-24)
            span = far - near
            if span <= 1 and near >= 0 and far < rows:
                # Most pixels: one bin, or parts of two (the same one twice costs less than asking).
                first, last = int(near), int(far)
                share_ = min((np.float32(last) - near) / max(span, tiny), one)
                share_ = share_ if last > first else one
                nearest = np.uint32(first * beams + beam)
                power[np.uint32(last * beams + beam)] += value * (one - share_)
                power[nearest] += value * share_
                owner[nearest] = pixel
                if central:
                    in_beam[nearest] = True
                slot = np.uintp(count)
                bin_of[slot] = int(start + where * (end - start)) * beams + beam
                power_of[slot] = value
                pixel_of[slot] = pixel
                part_of[slot] = where if end != start else np.float32(0)
                count += 1
                continue
            share_ = value / max(span, tiny)
            for bin_row in range(int(max(near, np.float32(0))), min(int(far), rows - 1) + 1):
                inside = min(far, np.float32(bin_row + 1)) - max(near, np.float32(bin_row))
                power[bin_row * beams + beam] += share_ * inside
                owner[bin_row * beams + beam] = pixel
                in_beam[bin_row * beams + beam] |= central
            many = max(min(int(np.ceil(span)), _MOST_PARTS), 1)
            if count + many + (height - above) * width > bin_of.shape[0]:
                many = 1
            for number in range(many):
                part = (np.float32(number) + where) / np.float32(many)
                bin_row = int(np.floor(start + part * (end - start)))
                if 0 <= bin_row < rows:
                    bin_of[count] = bin_row * beams + beam
                    power_of[count] = value / np.float32(many)
                    pixel_of[count] = pixel
                    part_of[count] = part if end != start else np.float32(0)
                    count += 1
        row_end[above] = count
    return count
