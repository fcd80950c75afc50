"""Bayesian shrinkage of complex wavelets in the logarithm: Isar, Moga and Isar (2009).

EURASIP Journal on Image and Video Processing, "A New Denoising System for SONAR Images": logarithm,
complex wavelets, a maximum a posteriori filter, exponential, correction of the mean.  The filter is
the bivariate one of Sendur and Selesnick (IEEE SPL 9(12), 2002), in which a coefficient is kept
when its parent is large, too.

The dual-tree complex wavelet transform: two orthonormal wavelet trees whose wavelets are nearly a
Hilbert pair (Kingsbury, ACHA 10, 2001; Selesnick, Baraniuk and Kingsbury, IEEE SPM 22(6), 2005).
In two dimensions four real transforms (tree of the rows x tree of the columns) make six oriented
complex bands a level; together they are a tight frame, four times redundant.  The first level has
the 10-tap nearly symmetric pair of Abdelnour and Selesnick (ICASSP 2001), one sample apart between
the trees; further levels have the 10-tap quarter-shift filter of Kingsbury (ICIP 2000).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ..base import Gray
from .logarithm import in_logarithm

Floats = npt.NDArray[np.float32]
Complex = npt.NDArray[np.complex64]
Filters = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]

_MARGIN = 8
_WINDOW = 7  # for the local power, as in the paper on the bivariate filter
_RAYLEIGH_MEDIAN = float(np.sqrt(np.log(4)))
"""Median of the magnitude of complex noise over the standard deviation of one of its parts."""


def dtcwt_map(image: Gray, strength: float, levels: int) -> Gray:
    """(H, W) in 0..1 denoised.  strength: multiple of the estimated noise's standard deviation."""
    return in_logarithm(image, partial(_shrunk, strength=strength, levels=levels))


def _shrunk(values: Floats, strength: float, levels: int) -> Floats:
    """The picture with its details shrunk, by the noise that its finest level shows."""
    height, width = values.shape
    whole = 2 ** (levels + 1)
    after = [-(size + 2 * _MARGIN) % whole + _MARGIN for size in values.shape]
    padded = np.pad(values, [(_MARGIN, extra) for extra in after], mode="symmetric")
    # One level more than is shrunk: the parents of the coarsest.
    found = forward(padded, levels + 1)
    noise = strength * _noise(found.bands[0])
    bands = [
        _map(band, parent, noise)
        for band, parent in zip(found.bands[:-1], found.bands[1:], strict=True)
    ]
    result = inverse(Coefficients([*bands, found.bands[-1]], found.lows))
    return result[_MARGIN : _MARGIN + height, _MARGIN : _MARGIN + width]


def _noise(finest: Complex) -> float:
    """Robust standard deviation of a part (real or imaginary) of the finest coefficients.

    Of what is not exactly 0: outside of the fan there is no noise.
    """
    magnitude = np.abs(finest)
    some = magnitude[magnitude > 1e-5]
    return float(np.median(some)) / _RAYLEIGH_MEDIAN if some.size else 0.0


def _map(band: Complex, parent: Complex, noise: float) -> Complex:
    """Bivariate MAP: y max(R - sqrt(3) noise^2 / sigma, 0) / R, R the length of child and parent.

    noise, sigma: standard deviations of a real part; sigma, the signal's, is taken from the power
    around a coefficient.
    """
    magnitude = np.abs(band)
    above = np.abs(parent).repeat(2, axis=1).repeat(2, axis=2)
    length = np.hypot(magnitude, above)
    power = ndimage.uniform_filter(magnitude**2 / 2, (1, _WINDOW, _WINDOW), mode="wrap")
    sigma = np.sqrt(np.maximum(power - noise**2, 1e-12))
    part = np.maximum(length - np.sqrt(3) * noise**2 / sigma, 0) / np.maximum(length, 1e-12)
    return np.asarray(band * part, dtype=np.complex64)


_A, _B, _C = 0.08838834764832, 0.69587998903400, 0.01122679215254
_FIRST = np.array([0, -_A, _A, _B, _B, _A, -_A, _C, _C, 0])
_FURTHER = np.array(
    [0.03516384, 0, -0.08832942, 0.23389032, 0.76027237, 0.58751830, 0, -0.11430184, 0, 0]
)


@dataclass(frozen=True)
class Coefficients:
    """bands: a level each, the finest first: (6, H / 2^j, W / 2^j) complex.

    lows: the four rests, (4, H / 2^J, W / 2^J): tree of rows and columns aa, ab, ba, bb.
    """

    bands: list[Complex]
    lows: Floats


def forward(image: Floats, levels: int) -> Coefficients:
    """The transform of (H, W), both divisible by 2^levels; the picture repeats periodically."""
    trees = [_forward(image, levels, rows, columns) for rows in (0, 1) for columns in (0, 1)]
    bands = []
    for level in range(levels):
        aa, ab, ba, bb = (tree[0][level] for tree in trees)
        # (ha + i hb)(ga + i gb) and (ha + i hb)(ga - i gb): wavelets of opposite orientation.
        one, other = (aa - bb) + 1j * (ab + ba), (aa + bb) + 1j * (ba - ab)
        # Each of the four is half of an isometry, and sum and difference double: 1 / sqrt 8.
        bands.append((np.concatenate([one, other]) / np.sqrt(8)).astype(np.complex64))
    return Coefficients(bands, np.stack([tree[1] for tree in trees]) / np.float32(2))


def inverse(coefficients: Coefficients) -> Floats:
    """The picture of coefficients, (H, W) float32; the exact inverse of `forward`."""
    parts: list[list[Floats]] = [[], [], [], []]
    for band in coefficients.bands:
        one, other = band[:3] * np.sqrt(8), band[3:] * np.sqrt(8)
        separate = (
            one.real + other.real,
            one.imag - other.imag,
            one.imag + other.imag,
            other.real - one.real,
        )
        for part, values in zip(parts, separate, strict=True):
            part.append((values / 2).astype(np.float32))
    pairs = [(rows, columns) for rows in (0, 1) for columns in (0, 1)]
    pictures = [
        _inverse(part, low * np.float32(2), *pair)
        for part, low, pair in zip(parts, coefficients.lows, pairs, strict=True)
    ]
    return np.asarray(np.mean(pictures, axis=0), dtype=np.float32)


def filters(level: int, tree: int) -> Filters:
    """Low pass and high pass of a level (0 is the finest) of tree 0 or 1."""
    low = _FIRST if level == 0 else _FURTHER
    if tree == 1:
        # The mirrored quarter-shift filter is half a sample later; the first level's pair is one.
        low = np.roll(low[::-1], -1) if level == 0 else low[::-1]
    signs = (-1.0) ** np.arange(low.size)
    high = signs * low[::-1]
    return low, high


def _forward(image: Floats, levels: int, rows: int, columns: int) -> tuple[list[Floats], Floats]:
    """One real transform: ((3, h, w) details of each level, rest)."""
    bands, rest = [], image
    for level in range(levels):
        down, right = filters(level, rows), filters(level, columns)
        low, high = (_analysed(rest, one, 0) for one in down)
        details = [_analysed(low, right[1], 1)]
        details += [_analysed(high, one, 1) for one in right]
        bands.append(np.stack(details))
        rest = _analysed(low, right[0], 1)
    return bands, rest


def _inverse(bands: list[Floats], rest: Floats, rows: int, columns: int) -> Floats:
    for level in reversed(range(len(bands))):
        down, right = filters(level, rows), filters(level, columns)
        low_high, high_low, high_high = bands[level]
        low = _synthesised(rest, right[0], 1) + _synthesised(low_high, right[1], 1)
        high = _synthesised(high_low, right[0], 1) + _synthesised(high_high, right[1], 1)
        rest = _synthesised(low, down[0], 0) + _synthesised(high, down[1], 0)
    return rest


def _analysed(values: Floats, taps: npt.NDArray[np.float64], axis: int) -> Floats:
    """Sum over k of taps[k] values[2n + k], all round."""
    phases = [values[0::2], values[1::2]] if axis == 0 else [values[:, 0::2], values[:, 1::2]]
    result = np.zeros(phases[0].shape, dtype=np.float32)
    for k in np.nonzero(taps)[0]:
        result += np.float32(taps[k]) * np.roll(phases[k % 2], -(k // 2), axis)
    return result


def _synthesised(values: Floats, taps: npt.NDArray[np.float64], axis: int) -> Floats:
    """The transpose of `_analysed`, which for orthonormal filters undoes it."""
    shape = tuple(size * (2 if axis == number else 1) for number, size in enumerate(values.shape))
    result = np.zeros(shape, dtype=np.float32)
    phases = [result[0::2], result[1::2]] if axis == 0 else [result[:, 0::2], result[:, 1::2]]
    for k in np.nonzero(taps)[0]:
        phases[k % 2] += np.float32(taps[k]) * np.roll(values, k // 2, axis)
    return result
