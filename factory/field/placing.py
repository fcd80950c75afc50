"""Compiled loops from rendered pixels to scatterers; see `factory.compiled`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from factory.compiled import compiled
from factory.field.kernels import cube

Floats = npt.NDArray[np.float32]

_8, _GOLDEN = np.uint32(8), np.uint32(0x9E3779B9)
# When neighbours are one surface, as in `factory.cloud.joined`: parts of the depth, and of a step.
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
    tangent: Floats,
    sine: Floats,
) -> None:
    """Tangent of the azimuth and sine of the elevation of a row of pixels.

    What lies behind the sonar has a tangent beyond every sector, and NaN without depth.
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
        tangent[column] = -y / x if x > 0 else np.float32(np.inf)
        sine[column] = up / np.sqrt(x * x + y * y + up * up)


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


@compiled(
    "int64(Array(float32, 2, 'C', readonly=True), Array(float32, 2, 'C', readonly=True),"
    " Array(uint8, 2, 'C', readonly=True), Array(float32, 2, 'C', readonly=True), float32[::1],"
    " float32[::1], float32[::1], float32[:, ::1], float32[::1], boolean, float32, float32,"
    " float32[::1], int32[::1], float32, float32[::1], float32[::1], boolean[::1], float32,"
    " int32[::1],"
    " int32[::1], float32[::1], int32[::1], float32[::1])"
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
    tangents: Floats,
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
) -> int:
    """Each lit pixel as scatterers of polar bins; returns how many there are.

    A pixel covers the ranges from its own to that of the pixel below it, where both are one
    surface.  `power` gets its echo in exact parts.  A scatterer lies anywhere in between, one for
    each range bin that it covers: at grazing incidence there are fewer pixels than bins.

    depth_m, radiance: (H, W).  labels: (H, W), or (0, 0) when all are 0; reflectivity: of each.
    factor: (H, W) multiplies the radiance, or (0, 0).
    across, down: (u - cx) / fx, (v - cy) / fy.  rotation, position_m: sonar axes from camera axes.
    tangents: (beams + 1,) tangents of the beams' edges; first_beam, beam_scale: a table that says
    where in it to begin.  pattern: vertical intensity pattern at equal steps of sin(elevation) from
    -1 to 1.
    power, owner: (bins,) out, summed power and last pixel of a bin (-1: none).  in_beam: (bins,)
    out, whether a pixel within sin(elevation) of +-widest_sine fills it.
    bin_of, power_of, pixel_of, part_of: (at least pixels,) out; part: how far towards the pixel
    below, 0 to 1.
    """
    height, width = depth_m.shape
    beams = tangents.shape[0] - 1
    rows = power.shape[0] // beams
    steps = pattern.shape[0] - 1
    low, high = tangents[0], tangents[beams]
    half_steps, one, tiny = np.float32(0.5 * steps), np.float32(1), np.float32(1e-6)
    # A row at a time: first what a processor does for many pixels at once, then the rest.
    tangent_of, bin_row_of = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    sine_of, value_of = np.empty((2, width), np.float32), np.empty((2, width), np.float32)
    ground_up = rotation[2] if ground_range else np.zeros(3, np.float32)
    count = 0
    for row in range(height + 1):
        now, before = row & 1, 1 - (row & 1)
        if row < height:
            directions(
                depth_m[row], across, down[row], rotation, position_m,
                tangent_of[now], sine_of[now],
            )  # fmt: skip
            strengths(
                depth_m[row], radiance[row], across, down[row], position_m, ground_up, near_m,
                bins_per_m, bin_row_of[now], value_of[now],
            )  # fmt: skip
        if row == 0:
            continue
        above = row - 1
        for column in range(width):
            value, tangent = value_of[before, column], tangent_of[before, column]
            if not (value > 0 and low <= tangent < high):
                continue
            start = bin_row_of[before, column]
            end = start
            if row < height:
                z, z_below = depth_m[above, column], depth_m[row, column]
                small, step_m = _SMALL_STEP * min(z, z_below), z_below - z
                one_surface = abs(step_m) < small
                if not one_surface and abs(step_m) < _LARGE_STEP * min(z, z_below):
                    # The ground far away is a run of large steps; an outline is a single one.
                    before_m = z - depth_m[max(above - 1, 0), column]
                    after_m = depth_m[min(row + 1, height - 1), column] - z_below
                    run_m = max(before_m, after_m) if step_m > 0 else -min(before_m, after_m)
                    one_surface = abs(step_m) < _SLOPE_CHANGE * run_m
                if one_surface:
                    end = bin_row_of[now, column]
            near, far = min(start, end), max(start, end)
            if not (far >= 0 and near < rows):
                continue
            guess = int((tangent - low) * beam_scale)
            beam = first_beam[min(guess, first_beam.shape[0] - 1)]
            while tangent >= tangents[beam + 1]:
                beam += 1
            sine = (sine_of[before, column] + np.float32(1)) * half_steps
            central = abs(sine_of[before, column]) <= widest_sine
            step = min(int(sine), steps - 1)
            part = sine - np.float32(step)
            value *= pattern[step] + part * (pattern[step + 1] - pattern[step])
            value *= reflectivity[labels[above, column] if labels.shape[0] else 0]
            if factor.shape[0]:
                value *= factor[above, column]
            pixel = above * width + column
            span = far - near
            if span <= 1 and near >= 0 and far < rows:
                # Most pixels: one bin, or parts of two (the same one twice costs less than asking).
                first, last = int(near), int(far)
                kept = (
                    min((np.float32(last) - near) / max(span, tiny), one) if last > first else one
                )
                power[last * beams + beam] += value * (one - kept)
                power[first * beams + beam] += value * kept
                owner[first * beams + beam] = pixel
                in_beam[first * beams + beam] |= central
                many = 1
            else:
                share_ = value / max(span, tiny)
                for bin_row in range(int(max(near, np.float32(0))), min(int(far), rows - 1) + 1):
                    inside = min(far, np.float32(bin_row + 1)) - max(near, np.float32(bin_row))
                    power[bin_row * beams + beam] += share_ * inside
                    owner[bin_row * beams + beam] = pixel
                    in_beam[bin_row * beams + beam] |= central
                many = max(min(int(np.ceil(span)), _MOST_PARTS), 1)
                if count + many + (height - above) * width > bin_of.shape[0]:
                    many = 1
            where = np.float32(np.uint32(np.uint32(pixel) * _GOLDEN) >> _8) * np.float32(2.0**-24)
            for number in range(many):
                part = (np.float32(number) + where) / np.float32(many)
                bin_row = int(np.floor(start + part * (end - start)))
                if 0 <= bin_row < rows:
                    bin_of[count] = bin_row * beams + beam
                    power_of[count] = value / np.float32(many)
                    pixel_of[count] = pixel
                    part_of[count] = part if end != start else np.float32(0)
                    count += 1
    return count


@compiled(
    "void(int32[::1], float32[::1], Array(float32, 2, 'C', readonly=True), float32[::1],"
    " float32[::1], float64[:, ::1], float64, uint32[::1])"
)
def cells(
    pixels: npt.NDArray[np.int32],
    parts: Floats,
    depth_m: Floats,
    across: Floats,
    down: Floats,
    world_from_camera: npt.NDArray[np.float64],
    cell_m: float,
    cell_of: npt.NDArray[np.uint32],
) -> None:
    """Number (hash) of the world cell, a cube of edge `cell_m`, in which each scatterer lies.

    pixels, parts: as `place` gives them.
    """
    width = depth_m.shape[1]
    m = world_from_camera / cell_m
    for i in range(pixels.shape[0]):
        row = pixels[i] // width
        column = pixels[i] - row * width
        z = np.float64(depth_m[row, column])
        y = down[row] * z
        if parts[i] > 0:
            below = np.float64(depth_m[row + 1, column])
            y += parts[i] * (down[row + 1] * below - y)
            z += parts[i] * (below - z)
        x = across[column] * z
        first = np.floor(m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3])
        second = np.floor(m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3])
        third = np.floor(m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
        cell_of[i] = cube(np.int64(first), np.int64(second), np.int64(third))


@compiled("void(uint32[::1], float32[::1], uint32[::1], int32[::1], float32[::1])")
def share(
    cell_of: npt.NDArray[np.uint32],
    power_of: Floats,
    names: npt.NDArray[np.uint32],
    counts: npt.NDArray[np.int32],
    amplitude_of: Floats,
) -> None:
    """Amplitude of each point, sqrt(power / points of its cell): they add up coherently.

    names, counts: zeros, a power of two of them, at least twice as many as there are points.
    """
    mask = np.uint32(names.shape[0] - 1)
    slot_of = np.empty(cell_of.shape[0], np.int32)
    for i in range(cell_of.shape[0]):
        name = max(cell_of[i], np.uint32(1))  # 0 is a free slot
        slot = name & mask
        while names[slot] != name and names[slot] != 0:
            slot = np.uint32(slot + np.uint32(1)) & mask
        names[slot] = name
        counts[slot] += np.int32(1)
        slot_of[i] = slot
    for i in range(cell_of.shape[0]):
        amplitude_of[i] = np.sqrt(power_of[i] / np.float32(counts[slot_of[i]]))
