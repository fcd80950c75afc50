"""Compiled loops from rendered pixels to scatterers; see `simnfnd.factory.compiled`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...compiled import compiled
from .pixel_rows import (
    anywhere,
    directions,
    far_ends,
    heard,
    looked_for,
    spread,
    strengths,
)

Floats = npt.NDArray[np.float32]

# A pixel at grazing incidence is at most so many scatterers.
_MOST_PARTS = 32


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
    low, high, most_guess = edges[0], edges[beams], np.float32(first_beam.shape[0] - 1)
    one, tiny = np.float32(1), np.float32(1e-6)
    # A row at a time: first what a processor does for many pixels at once, then the rest.
    bearing_of, bin_row_of = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    sine_of, value_of = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    end_of, columns = np.empty(width, np.float32), np.empty(width, np.uint32)
    guess_of, step_of = np.empty(width, np.int32), np.empty(width, np.int32)
    aside_of, share_of = np.empty(width, np.float32), np.empty(width, np.float32)
    short, part_at = np.empty(width, np.uint8), np.empty(width, np.float32)
    near_bin, far_bin = np.empty(width, np.int32), np.empty(width, np.int32)
    one_bin = np.empty(width, np.int32)
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
        looked_for(
            bearings, sines, low, beam_scale, most_guess, steps, guess_of, step_of, aside_of,
        )  # fmt: skip
        spread(
            starts, end_of, above * width, rows, beams, short, near_bin, far_bin, share_of,
            one_bin, part_at,
        )  # fmt: skip
        for at in range(kept):
            column = columns[at]
            value, bearing = values[column], bearings[column]
            beam = first_beam[np.uint32(guess_of[column])]
            # Mostly one step at most, taken without a branch that cannot be foretold.
            beam += np.int32(bearing >= edges[np.uint32(beam + 1)])
            while bearing >= edges[np.uint32(beam + 1)]:
                beam += 1
            central = abs(sines[column]) <= widest_sine
            step = np.uint32(step_of[column])
            lower, upper = pattern[step], pattern[np.uint32(step + np.uint32(1))]
            value *= lower + aside_of[column] * (upper - lower)
            label = np.uint32(labels[above, column] if labels.shape[0] else 0)
            value *= reflectivity[min(label, last_label)]
            if factor.shape[0]:
                value *= factor[above, column]
            pixel = above * width + column
            if short[column]:
                # Most pixels: one bin, or parts of two (the same one twice costs less than asking).
                nearest = np.uint32(near_bin[column] + beam)
                power[np.uint32(far_bin[column] + beam)] += value * (one - share_of[column])
                power[nearest] += value * share_of[column]
                owner[nearest] = pixel
                if central:
                    in_beam[nearest] = True
                slot = np.uintp(count)
                bin_of[slot] = one_bin[column] + beam
                power_of[slot] = value
                pixel_of[slot] = pixel
                part_of[slot] = part_at[column]
                count += 1
                continue
            start, end = starts[column], end_of[column]
            near, far = min(start, end), max(start, end)
            span, where = far - near, anywhere(pixel)
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
