"""The device's beams as matrices, and fields after pulse compression and beamforming."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ...sonar import array
from ...sonar.settings import SonarSettings
from ...sonar.window import Window

Floats = npt.NDArray[np.float32]
Matrix = npt.NDArray[np.float64]

# What factors leave out, as a part of the largest number of a matrix.
_LEFT_OUT = 1e-6
# Modes a beam up to which two multiplications by factors are less work than one by the half.
_WORTH_IT = 0.4


@lru_cache(maxsize=8)
def mixing(sonar: SonarSettings) -> Floats:
    """The device's beam mixing; see `simnfnd.factory.sonar.array.beam_mixing`."""
    return array.beam_mixing(sonar.beam_centres_rad(), sonar.array)


@lru_cache(maxsize=16)
def halves(sonar: SonarSettings, power: bool) -> tuple[Floats, Floats]:
    """The mixing of amplitudes or, squared, of intensities, in two parts.

    A device whose left is the mirror of its right mixes the sums of mirrored beams with one matrix
    and their differences with another, each of half the size: together half the work.  Returns both
    (rows filled up with zeros to a multiple of 4).  Other devices: the whole matrix, and (0, 0).

    A beam so gets the rounding errors of its mirror image: 2e-7 of the row's strongest number.
    """
    even, odd = _split(mixing(sonar).astype(np.float64) ** (2 if power else 1))
    return _filled_up(even), _filled_up(odd)


@lru_cache(maxsize=16)
def modes(sonar: SonarSettings) -> tuple[Floats, Floats, Floats, Floats] | None:
    """Factors of the halves of the mixing of amplitudes: even, odd, even, odd; or None.

    The beams are no more independent than the aperture is long: an aperture of L wavelengths tells
    apart about 2 L sin(hfov / 2) directions.  With more beams than that, half of them even and half
    odd, each half is (beams / 2, modes) times (modes, beams / 2).  None where this saves no work.

    A beam gets errors of up to 1e-5 of its row's strongest number.
    """
    split = _split(mixing(sonar).astype(np.float64))
    if not split[1].size:
        return None
    made = [factors(half, int(_WORTH_IT * len(half))) for half in split]
    if made[0] is None or made[1] is None:
        return None
    (even, even_out), (odd, odd_out) = made[0], made[1]
    return _squared_up(even), _squared_up(odd), _filled_up(even_out), _filled_up(odd_out)


def factors(matrix: Matrix, most: int) -> tuple[Matrix, Matrix] | None:
    """(n, r) and (r, m) whose product is the (n, m) matrix to 1e-6 of its largest number.

    Gauss's elimination with complete pivoting, ended where nothing is left.  Unlike singular values
    it needs no library whose rounding depends on the processor.  None if r would be above `most`.
    """
    left = matrix.copy()
    columns: list[Matrix] = []
    rows: list[Matrix] = []
    least = _LEFT_OUT * np.abs(matrix).max()
    for _ in range(most + 1):
        row, column = divmod(int(np.abs(left).argmax()), matrix.shape[1])
        pivot = left[row, column]
        if abs(pivot) <= least:
            return (np.stack(columns, axis=1), np.stack(rows)) if rows else None
        columns.append(left[:, column] / pivot)
        rows.append(left[row].copy())
        left -= columns[-1][:, None] * rows[-1]
    return None


def _split(matrix: Matrix) -> tuple[Matrix, Matrix]:
    turned = matrix[::-1, ::-1]
    if np.abs(matrix - turned).max() > 1e-6 * matrix.max():
        return matrix, np.empty((0, 0))
    middle = (len(matrix) + 1) // 2  # of an odd number that beam is its own mirror
    matrix = (matrix + turned) / 2
    upper, lower = matrix[:middle, :middle], matrix[::-1][:middle, :middle]
    return (upper + lower) / 2, (upper - lower) / 2


def _squared_up(matrix: Matrix) -> Floats:
    rows, columns = matrix.shape
    return np.pad(matrix, ((0, -rows % 4), (0, -columns % 4))).astype(np.float32)


def _filled_up(matrix: Matrix) -> Floats:
    return np.pad(matrix, ((0, -len(matrix) % 4), (0, 0))).astype(np.float32)


def blurred(planes: Floats, kernel: Floats, sonar: SonarSettings, *, power: bool) -> Floats:
    """Planes (..., range_bins, beams) after pulse compression and beamforming.

    kernel: range response.  power: whether the planes are intensities, and not amplitudes.
    """
    from . import kernels  # loads numba

    factors = None if power else modes(sonar)
    rows, beams = planes.shape[-2:]
    out = np.empty_like(planes)
    for plane, made in zip(
        planes.reshape(-1, rows, beams), out.reshape(-1, rows, beams), strict=True
    ):
        if factors is None:
            even, odd = halves(sonar, power)
            pairs = beams // 2 if odd.size else 0
            sums, differences = _fold(along_range(plane, kernel), pairs, len(even))
            alike = _times(sums, even)
            unlike = _times(differences, odd) if pairs else alike
        else:
            # There are fewer modes than beams, so the pulse goes between.
            pairs = beams // 2
            folded = _fold(plane, pairs, len(factors[0]))
            alike, unlike = (
                _times(along_range(_times(part, into), kernel), out_of)
                for part, into, out_of in zip(folded, factors[:2], factors[2:], strict=True)
            )
        kernels.unfold(alike, unlike, pairs, made)
    return out


def along_range(plane: Floats, kernel: Floats) -> Floats:
    """Rows of (rows, n) correlated with `kernel`; nothing comes from beyond the ends."""
    if len(kernel) == 1:
        return plane
    rows, half = len(plane), len(kernel) // 2
    out = np.zeros_like(plane)
    for tap, weight in enumerate(kernel):
        first, last = max(half - tap, 0), min(rows, rows + half - tap)
        if first < last:
            out[first:last] += weight * plane[first + tap - half : last + tap - half]
    return out


def _fold(plane: Floats, pairs: int, width: int) -> tuple[Floats, Floats]:
    """Sums (the middle beam as it is) and differences of mirrored beams, filled up with zeros."""
    from . import kernels  # loads numba

    rows = len(plane)
    sums, differences = (np.zeros((rows + -rows % 4, width), np.float32) for _ in range(2))
    kernels.fold(plane, pairs, sums, differences)
    return sums, differences


def _times(rows: Floats, matrix: Floats) -> Floats:
    from . import kernels  # loads numba

    out = np.empty((len(rows), matrix.shape[1]), np.float32)
    kernels.products(rows, matrix, out)
    return out


_PATTERN_STEPS = 4096


def bin_centres_m(window: Window, sonar: SonarSettings) -> Floats:
    """(range_bins,) centres of the range bins, metres."""
    fraction = (np.arange(sonar.range_bins) + 0.5) / sonar.range_bins
    return np.asarray(window.range_min_m + fraction * window.range_span_m, np.float32)


@lru_cache(maxsize=8)
def vertical_table(sonar: SonarSettings) -> Floats:
    """(4097,) two-way vertical intensity pattern at equal steps of sin(elevation) from -1 to 1."""
    sine = np.linspace(-1, 1, _PATTERN_STEPS + 1)
    return array.vertical_pattern(sine, sonar.vfov_deg, sonar.array).astype(np.float32)
