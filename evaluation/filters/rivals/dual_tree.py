"""Bayesian shrinkage of dual-tree complex wavelets in the logarithm: Isar, Moga and Isar (2009).

EURASIP Journal on Image and Video Processing, "A New Denoising System for SONAR Images", reference
[11] of the SimNFND paper: logarithm, complex wavelets, a maximum a posteriori filter, exponential,
correction of the mean.  The filter is the bivariate one of Sendur and Selesnick (IEEE SPL 9(12),
2002), which keeps a coefficient when its parent is large too.  Written from these papers.

The dual-tree transform is two orthonormal wavelet trees whose wavelets are nearly a Hilbert pair
(Kingsbury, ACHA 10, 2001; Selesnick, Baraniuk and Kingsbury, IEEE SPM 22(6), 2005).  In two
dimensions four real transforms (tree of the rows x tree of the columns) make six oriented complex
bands a level, a tight frame, four times redundant.  The first level has the 10-tap nearly symmetric
pair of Abdelnour and Selesnick (ICASSP 2001), one sample apart between the trees; further levels
have the 10-tap quarter-shift filter of Kingsbury (ICIP 2000).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ....factory.common.array_types import Complex64s, Float32s, Float64s
from ...metrics.measure import Grey
from .logarithm import denoise_logarithm

_MARGIN_PX = 8
_WINDOW_PX = 7  # of the local power, as in the paper on the bivariate filter
_RAYLEIGH_MEDIAN = float(np.sqrt(np.log(4)))
"""Median magnitude of complex noise over the standard deviation of its real part."""

_A = 0.08838834764832
_B = 0.69587998903400
_C = 0.01122679215254
_FIRST_LOW = np.array([0, -_A, _A, _B, _B, _A, -_A, _C, _C, 0])
_FURTHER_LOW = np.array(
    [0.03516384, 0, -0.08832942, 0.23389032, 0.76027237, 0.58751830, 0, -0.11430184, 0, 0]
)
_TREES = [(rows, columns) for rows in (0, 1) for columns in (0, 1)]


class Filters(NamedTuple):
    """Low-pass and high-pass taps of a level."""

    low: Float64s
    high: Float64s


class RealTransform(NamedTuple):
    """One of the four real transforms: (3, h, w) details of each level, and the coarse rest."""

    details: list[Float32s]
    rest: Float32s


@dataclass(frozen=True)
class Coefficients:
    """The coefficients of an image.

    bands: a level each, the finest first: (6, H / 2^j, W / 2^j) complex.

    rests: the four coarse rests, (4, H / 2^J, W / 2^J), in the order of `_TREES`.
    """

    bands: list[Complex64s]
    rests: Float32s


def dual_tree(image: Grey, strength: float, levels: int) -> Grey:
    """(H, W) in 0..1 denoised.  strength: multiple of the estimated noise's standard deviation."""
    return denoise_logarithm(image, lambda values: _denoise(values, strength, levels))


def _denoise(values: Float32s, strength: float, levels: int) -> Float32s:
    """(H, W) with its details shrunk by the noise that the finest level shows."""
    height, width = values.shape
    divisor = 2 ** (levels + 1)
    padding = [
        (_MARGIN_PX, -(side + 2 * _MARGIN_PX) % divisor + _MARGIN_PX) for side in values.shape
    ]
    padded = np.pad(values, padding, mode="symmetric")

    # One level more than is shrunk: the parents of the coarsest.
    coefficients = transform(padded, levels + 1)
    noise = strength * _estimate_deviation(coefficients.bands[0])
    shrunk = []
    for level in range(levels):
        parents = coefficients.bands[level + 1]
        shrunk.append(_shrink(coefficients.bands[level], parents, noise))
    shrunk.append(coefficients.bands[-1])

    denoised = invert(Coefficients(shrunk, coefficients.rests))
    return denoised[_MARGIN_PX : _MARGIN_PX + height, _MARGIN_PX : _MARGIN_PX + width]


def _estimate_deviation(finest: Complex64s) -> float:
    """Robust standard deviation of a real or imaginary part of the finest coefficients.

    Exact zeros, outside the fan, do not count.
    """
    magnitudes = np.abs(finest)
    magnitudes = magnitudes[magnitudes > 1e-5]
    return float(np.median(magnitudes)) / _RAYLEIGH_MEDIAN if magnitudes.size else 0.0


def _shrink(band: Complex64s, parents: Complex64s, noise: float) -> Complex64s:
    """Bivariate MAP: y max(R - sqrt(3) noise^2 / sigma, 0) / R, R the length of child and parent.

    noise, sigma: standard deviations of a real part; sigma, the signal's, comes from the power
    around a coefficient.
    """
    magnitude = np.abs(band)
    parent_magnitude = np.abs(parents).repeat(2, axis=1).repeat(2, axis=2)
    length = np.hypot(magnitude, parent_magnitude)
    power = ndimage.uniform_filter(magnitude**2 / 2, (1, _WINDOW_PX, _WINDOW_PX), mode="wrap")
    sigma = np.sqrt(np.maximum(power - noise**2, 1e-12))
    shrunk = np.maximum(length - np.sqrt(3) * noise**2 / sigma, 0)
    return np.asarray(band * shrunk / np.maximum(length, 1e-12), np.complex64)


def transform(image: Float32s, levels: int) -> Coefficients:
    """The transform of (H, W), both divisible by 2^levels; the image repeats periodically."""
    transforms = [_transform_tree(image, levels, rows, columns) for rows, columns in _TREES]
    bands = []
    for level in range(levels):
        aa, ab, ba, bb = (tree.details[level] for tree in transforms)
        # (ha + i hb)(ga + i gb) and (ha + i hb)(ga - i gb): wavelets of opposite orientation.
        rising = (aa - bb) + 1j * (ab + ba)
        falling = (aa + bb) + 1j * (ba - ab)
        # Each of the four is half of an isometry, and sum and difference double: 1 / sqrt 8.
        bands.append((np.concatenate([rising, falling]) / np.sqrt(8)).astype(np.complex64))
    rests = np.stack([tree.rest for tree in transforms]) / np.float32(2)
    return Coefficients(bands, rests)


def invert(coefficients: Coefficients) -> Float32s:
    """The image of coefficients, (H, W) float32; the exact inverse of `transform`."""
    details: list[list[Float32s]] = [[], [], [], []]
    for band in coefficients.bands:
        rising = band[:3] * np.sqrt(8)
        falling = band[3:] * np.sqrt(8)
        sums = (
            rising.real + falling.real,
            rising.imag - falling.imag,
            rising.imag + falling.imag,
            falling.real - rising.real,
        )
        for tree, values in enumerate(sums):
            details[tree].append((values / 2).astype(np.float32))

    images = []
    for tree, (rows, columns) in enumerate(_TREES):
        rest = coefficients.rests[tree] * np.float32(2)
        images.append(_invert_tree(RealTransform(details[tree], rest), rows, columns))
    return np.asarray(np.mean(images, axis=0), np.float32)


def filters_of(level: int, tree: int) -> Filters:
    """The filters of a level (0 is the finest) of tree 0 or 1."""
    low = _FIRST_LOW if level == 0 else _FURTHER_LOW
    if tree == 1:
        # The mirrored quarter-shift filter is half a sample later; the first level's pair is one.
        low = np.roll(low[::-1], -1) if level == 0 else low[::-1]
    signs = (-1.0) ** np.arange(low.size)
    return Filters(low, signs * low[::-1])


def _transform_tree(image: Float32s, levels: int, rows: int, columns: int) -> RealTransform:
    details = []
    rest = image
    for level in range(levels):
        down = filters_of(level, rows)
        across = filters_of(level, columns)
        low = _analyse(rest, down.low, 0)
        high = _analyse(rest, down.high, 0)
        bands = [
            _analyse(low, across.high, 1),
            _analyse(high, across.low, 1),
            _analyse(high, across.high, 1),
        ]
        details.append(np.stack(bands))
        rest = _analyse(low, across.low, 1)
    return RealTransform(details, rest)


def _invert_tree(tree: RealTransform, rows: int, columns: int) -> Float32s:
    rest = tree.rest
    for level in reversed(range(len(tree.details))):
        down = filters_of(level, rows)
        across = filters_of(level, columns)
        low_high, high_low, high_high = tree.details[level]
        low = _synthesise(rest, across.low, 1) + _synthesise(low_high, across.high, 1)
        high = _synthesise(high_low, across.low, 1) + _synthesise(high_high, across.high, 1)
        rest = _synthesise(low, down.low, 0) + _synthesise(high, down.high, 0)
    return rest


def _analyse(values: Float32s, taps: Float64s, axis: int) -> Float32s:
    """Sum over k of taps[k] values[2n + k], periodic."""
    phases = [values[0::2], values[1::2]] if axis == 0 else [values[:, 0::2], values[:, 1::2]]
    analysed = np.zeros(phases[0].shape, np.float32)
    for k in np.nonzero(taps)[0]:
        analysed += np.float32(taps[k]) * np.roll(phases[k % 2], -(k // 2), axis)
    return analysed


def _synthesise(values: Float32s, taps: Float64s, axis: int) -> Float32s:
    """The transpose of `_analyse`, which undoes it for orthonormal filters."""
    height, width = values.shape
    shape = (2 * height, width) if axis == 0 else (height, 2 * width)
    image = np.zeros(shape, np.float32)
    phases = [image[0::2], image[1::2]] if axis == 0 else [image[:, 0::2], image[:, 1::2]]
    for k in np.nonzero(taps)[0]:
        phases[k % 2] += np.float32(taps[k]) * np.roll(values, k // 2, axis)
    return image
