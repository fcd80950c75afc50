"""Compiled loops over scatterers and over the bins of a polar field; see `factory.compiled`.

A field is (looks, 2, range_bins, beams) float32: real and imaginary parts as planes of their own,
so that whatever mixes beams or ranges treats them as plain numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import compiled
from ...elementary import log10

Floats = npt.NDArray[np.float32]

_A, _B = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)
_13, _16 = np.uint32(13), np.uint32(16)


@compiled()
def mixed(word: Any) -> Any:
    """32 bits -> 32 bits that look random: the finaliser of MurmurHash3 (public domain)."""
    word = np.uint32(word ^ (word >> _16))
    word = np.uint32(word * _A)
    word = np.uint32(word ^ (word >> _13))
    word = np.uint32(word * _B)
    return np.uint32(word ^ (word >> _16))


@compiled("void(float32[:, ::1], float32[::1], float32[:, ::1])")
def along_range(planes: Floats, kernel: Floats, out: Floats) -> None:
    """Correlate the rows of (rows, n) with `kernel`; nothing comes from beyond the ends."""
    rows, width = planes.shape
    half = kernel.shape[0] // 2
    for row in range(rows):
        for column in range(width):
            out[row, column] = 0
        for tap in range(kernel.shape[0]):
            source = row + tap - half
            if 0 <= source < rows:
                weight = kernel[tap]
                for column in range(width):
                    out[row, column] += weight * planes[source, column]


@compiled()
def _products(four: Floats, matrix: Floats, out: Floats) -> None:
    """(4, m) times (m, n), m a multiple of 4; the order of the sums is fixed.

    Four rows by four sources at a time: each number that is loaded or stored serves four products.
    """
    a, b, c, d = four[0], four[1], four[2], four[3]
    first, second, third, fourth = out[0], out[1], out[2], out[3]
    for at in range(matrix.shape[1]):
        first[at] = second[at] = third[at] = fourth[at] = 0
    for i in range(0, matrix.shape[0], 4):
        m0, m1, m2, m3 = matrix[i], matrix[i + 1], matrix[i + 2], matrix[i + 3]
        a0, a1, a2, a3 = a[i], a[i + 1], a[i + 2], a[i + 3]
        b0, b1, b2, b3 = b[i], b[i + 1], b[i + 2], b[i + 3]
        c0, c1, c2, c3 = c[i], c[i + 1], c[i + 2], c[i + 3]
        d0, d1, d2, d3 = d[i], d[i + 1], d[i + 2], d[i + 3]
        # Where nothing echoes, as in most bins of a frame, nothing is added.
        if (
            (a0 == 0 and a1 == 0 and a2 == 0 and a3 == 0)
            and (b0 == 0 and b1 == 0 and b2 == 0 and b3 == 0)
            and (c0 == 0 and c1 == 0 and c2 == 0 and c3 == 0)
            and (d0 == 0 and d1 == 0 and d2 == 0 and d3 == 0)
        ):
            continue
        for at in range(matrix.shape[1]):
            w0, w1, w2, w3 = m0[at], m1[at], m2[at], m3[at]
            first[at] += a0 * w0 + a1 * w1 + a2 * w2 + a3 * w3
            second[at] += b0 * w0 + b1 * w1 + b2 * w2 + b3 * w3
            third[at] += c0 * w0 + c1 * w1 + c2 * w2 + c3 * w3
            fourth[at] += d0 * w0 + d1 * w1 + d2 * w2 + d3 * w3


@compiled()
def _copy(numbers: Floats, out: Floats) -> None:
    # A slice on the left of an assignment is copied number by number, for it might overlap.
    for at in range(numbers.shape[0]):
        out[at] = numbers[at]


@compiled()
def _fold(planes: Floats, first: int, pairs: int, sums: Floats, differences: Floats) -> None:
    """Sums and differences of mirrored beams of up to four rows, from `first` on."""
    beams, last = planes.shape[1], np.uintp(planes.shape[1] - 1)
    for line in range(min(4, planes.shape[0] - first)):
        given = planes[first + line]
        added, subtracted = sums[line], differences[line]
        for beam in range(pairs):
            mirrored = given[last - np.uintp(beam)]
            added[beam] = given[beam] + mirrored
            subtracted[beam] = given[beam] - mirrored
        for beam in range(pairs, beams - pairs):
            sums[line, beam] = given[beam]


@compiled()
def _unfold(alike: Floats, unlike: Floats, first: int, pairs: int, out: Floats) -> None:
    """Up to four rows of beams, from `first` on, of what their sums and differences became."""
    beams, last = out.shape[1], np.uintp(out.shape[1] - 1)
    for line in range(min(4, out.shape[0] - first)):
        made = out[first + line]
        added, subtracted = alike[line], unlike[line]
        for beam in range(pairs):
            made[beam] = added[beam] + subtracted[beam]
        for beam in range(pairs):
            made[last - np.uintp(beam)] = added[beam] - subtracted[beam]
        for beam in range(pairs, beams - pairs):
            made[beam] = alike[line, beam]


@compiled(
    "void(float32[:, ::1], Array(float32, 2, 'C', readonly=True),"
    " Array(float32, 2, 'C', readonly=True), float32[:, ::1])"
)
def across_beams(planes: Floats, even: Floats, odd: Floats, out: Floats) -> None:
    """(n, beams) times the mixing of the beams, as `beams.halves` splits it."""
    rows, beams = planes.shape
    pairs = beams // 2 if odd.shape[0] else 0
    sums = np.zeros((4, even.shape[0]), np.float32)
    differences = np.zeros((4, odd.shape[0]), np.float32)
    alike = np.empty((4, even.shape[1]), np.float32)
    unlike = np.zeros((4, even.shape[1]), np.float32)
    for row in range(0, rows, 4):
        _fold(planes, row, pairs, sums, differences)
        _products(sums, even, alike)
        if pairs:
            _products(differences, odd, unlike)
        _unfold(alike, unlike, row, pairs, out)


@compiled(
    "void(float32[:, ::1], Array(float32, 2, 'C', readonly=True),"
    " Array(float32, 2, 'C', readonly=True), float32[:, ::1])"
)
def into_modes(planes: Floats, even: Floats, odd: Floats, modes: Floats) -> None:
    """(n, beams) into (n, even and odd modes): the first factors of `beams.modes`."""
    rows, beams = planes.shape
    pairs, middle = beams // 2, even.shape[1]
    sums = np.zeros((4, even.shape[0]), np.float32)
    differences = np.zeros((4, odd.shape[0]), np.float32)
    alike = np.empty((4, even.shape[1]), np.float32)
    unlike = np.empty((4, odd.shape[1]), np.float32)
    for row in range(0, rows, 4):
        _fold(planes, row, pairs, sums, differences)
        _products(sums, even, alike)
        _products(differences, odd, unlike)
        for line in range(min(4, rows - row)):
            _copy(alike[line], modes[row + line, :middle])
            _copy(unlike[line], modes[row + line, middle:])


@compiled(
    "void(float32[:, ::1], Array(float32, 2, 'C', readonly=True),"
    " Array(float32, 2, 'C', readonly=True), float32[:, ::1])"
)
def out_of_modes(modes: Floats, even: Floats, odd: Floats, out: Floats) -> None:
    """(n, even and odd modes) into (n, beams): the second factors."""
    rows, pairs, middle = out.shape[0], out.shape[1] // 2, even.shape[0]
    sums = np.zeros((4, even.shape[0]), np.float32)
    differences = np.zeros((4, odd.shape[0]), np.float32)
    alike = np.empty((4, even.shape[1]), np.float32)
    unlike = np.empty((4, even.shape[1]), np.float32)
    for row in range(0, rows, 4):
        for line in range(min(4, rows - row)):
            _copy(modes[row + line, :middle], sums[line])
            _copy(modes[row + line, middle:], differences[line])
        _products(sums, even, alike)
        _products(differences, odd, unlike)
        _unfold(alike, unlike, row, pairs, out)


@compiled("void(uint32, float32[:, ::1], float32[::1], float32[::1], float32[:, :, ::1])")
def add_white(key: int, table: Floats, along: Floats, across: Floats, planes: Floats) -> None:
    """Add complex circular noise, a function of the key and the place.

    along, across: its amplitude is their product, (rows,) and (beams,).  planes: (2, rows, beams).
    """
    rows, beams = planes.shape[1:]
    drawn = np.empty(beams, np.uint32)
    for row in range(rows):
        first = np.uint32(row * beams)
        for beam in range(beams):
            place = np.uint32(first + np.uint32(beam))
            drawn[beam] = mixed(np.uint32(mixed(place) ^ key)) >> _16
        real, imaginary, level = planes[0, row], planes[1, row], along[row]
        for beam in range(beams):
            amplitude = level * across[beam]
            real[beam] += amplitude * table[drawn[beam], 0]
            imaginary[beam] += amplitude * table[drawn[beam], 1]


@compiled("void(float32[:, :, :, ::1], float32[:, ::1])")
def loudest(field: Floats, intensity: Floats) -> None:
    """Largest intensity of each look and range; field: (looks, 2, rows, beams)."""
    looks, _, rows, beams = field.shape
    squares = np.empty(beams, np.float32)
    for look in range(looks):
        for row in range(rows):
            real, imaginary = field[look, 0, row], field[look, 1, row]
            for beam in range(beams):
                squares[beam] = real[beam] * real[beam] + imaginary[beam] * imaginary[beam]
            intensity[look, row] = squares.max()


@compiled("void(float32[:, :, :, ::1], int64, float32)")
def beside(field: Floats, step: int, leak: float) -> None:
    """Add to a field what leaks of it into beams `step` to the left and to the right."""
    looks, parts, rows, beams = field.shape
    wide = np.zeros(beams + 2 * step, np.float32)
    # Slices from 0 on: the compiler then knows that no index is negative.
    left, middle, right = wide[:beams], wide[step : step + beams], wide[2 * step :]
    for look in range(looks):
        for part in range(parts):
            for row in range(rows):
                made = field[look, part, row]
                for beam in range(beams):
                    middle[beam] = made[beam]
                for beam in range(beams):
                    made[beam] = middle[beam] + leak * left[beam] + leak * right[beam]


@compiled("void(float32[:, :, :, ::1], float32[::1])")
def saturate(field: Floats, limit: Floats) -> None:
    """Weaken what is above the limit of its row, an intensity, down to it."""
    looks, _, rows, beams = field.shape
    one = np.float32(1)
    for look in range(looks):
        for row in range(rows):
            real, imaginary, most = field[look, 0, row], field[look, 1, row], limit[row]
            for beam in range(beams):
                intensity = real[beam] * real[beam] + imaginary[beam] * imaginary[beam]
                factor = np.sqrt(most / intensity) if intensity > most else one
                real[beam] *= factor
                imaginary[beam] *= factor


@compiled(
    "float32(float32[:, ::1], float32[::1], float32[:, ::1], boolean[::1], float32[:, ::1],"
    " float32[:, ::1])"
)
def expectation(
    expected: Floats,
    gain: Floats,
    power: Floats,
    seen: npt.NDArray[np.bool_],
    level: Floats,
    echoing: Floats,
) -> Any:
    """Amplitude after gain of expected intensities, and that of the bins that hold an echo alone.

    gain: of intensity, (rows,); power: where the echoes are; seen: (beams,).  Returns the largest
    intensity in a seen beam.
    """
    rows, beams = expected.shape
    mask, largest = np.empty(beams, np.float32), np.zeros(beams, np.float32)
    for beam in range(beams):
        mask[beam] = np.float32(seen[beam])
    for row in range(rows):
        given, there, factor = expected[row], power[row], gain[row]
        made, kept = level[row], echoing[row]
        for beam in range(beams):
            made[beam] = np.sqrt(given[beam] * factor)
        for beam in range(beams):
            kept[beam] = made[beam] * mask[beam] if there[beam] > 0 else np.float32(0)
        for beam in range(beams):
            largest[beam] = max(largest[beam], given[beam] * mask[beam])
    return largest.max()


@compiled("void(float32[:, :, :, ::1], float32[:, ::1])")
def amplitude(field: Floats, level: Floats) -> None:
    """Root of the intensity, averaged over the looks."""
    looks, _, rows, beams = field.shape
    level[:] = 0
    for look in range(looks):
        for row in range(rows):
            real, imaginary, made = field[look, 0, row], field[look, 1, row], level[row]
            for beam in range(beams):
                made[beam] += real[beam] * real[beam] + imaginary[beam] * imaginary[beam]
    for row in range(rows):
        made = level[row]
        for beam in range(beams):
            made[beam] = np.sqrt(made[beam] / np.float32(looks))


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
