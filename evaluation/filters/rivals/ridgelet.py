"""Finite ridgelets, after the abstract: shrinkage of what lies along straight lines.

Shang et al. (2008), reference [10] of the SimNFND paper: the orthonormal finite ridgelet transform
in blocks of one size with adaptive thresholds.  Block size, wavelet and threshold rule are not
public.  The transform is that of Do and Vetterli (IEEE TIP 12(1), 2003): the finite Radon transform
of a block of p x p pixels, p a prime, then a wavelet along each projection.

Chosen here: overlapping blocks whose borders count least; the unbalanced Haar wavelet (Girardi and
Sweldens 1997), orthonormal at any length; for each scale of each block the threshold of BayesShrink
(Chang, Yu and Vetterli, IEEE TIP 9(9), 2000); and the logarithm, because speckle is multiplicative.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ....factory.common.errors import FactoryError
from ...metrics.measure import Grey
from .logarithm import denoise_logarithm

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]

_BLOCKS_PER_SIDE = 4  # blocks that cover a pixel along each axis
_NORMAL_MEDIAN = 0.6745  # median magnitude of a normal variable of deviation 1


class Basis(NamedTuple):
    """The ridgelets of a block.

    ridgelets: (p^2, p^2), orthonormal, one a row; the first is constant.
    scales: the rows of each scale, from the widest to the finest.
    """

    ridgelets: Floats
    scales: tuple[slice, ...]


def ridgelet(image: Grey, strength: float, block_px: int) -> Grey:
    """(H, W) in 0..1 denoised.

    strength: multiple of the noise's estimated standard deviation.  block_px: side of a block.
    Raises FactoryError where that is no odd prime.
    """
    basis = build_basis(block_px)
    return denoise_logarithm(image, lambda values: _denoise_blocks(values, strength, basis))


@lru_cache(maxsize=8)
def build_basis(side: int) -> Basis:
    """The orthonormal ridgelets of a block of side x side pixels."""
    lines = _number_lines(side)
    steps, step_scales = _haar_steps(side)
    # A step along each line of a direction; its mean is 0, so the constant ridgelet is orthogonal.
    rows = [np.full(side * side, 1 / side)]
    for step in steps:
        for line in lines:
            rows.append((step[line] / np.sqrt(side)).ravel())

    directions = side + 1
    starts = [1 + step_scales.index(scale) * directions for scale in range(max(step_scales) + 1)]
    ends = [*starts[1:], len(rows)]
    scales = tuple(slice(start, end) for start, end in zip(starts, ends, strict=True))
    return Basis(np.stack(rows).astype(np.float32), scales)


def _number_lines(side: int) -> npt.NDArray[np.int64]:
    """(p + 1, p, p): for each direction the number, 0 to p - 1, of the line through every pixel.

    Lines are a i + b j = t modulo p.  Of the multiples of a normal (a, b) the shortest orders them,
    so neighbouring t are neighbouring lines (Do and Vetterli, section IV).
    """
    divisors = range(2, int(side**0.5) + 1)
    if side < 3 or any(side % divisor == 0 for divisor in divisors):
        raise FactoryError(f"ridgelet: block_px {side} is no odd prime; take 7, 11, 17 or 31")
    row, column = np.mgrid[0:side, 0:side]
    multiples = np.arange(1, side)
    directions = [(1, 0), *((slope, 1) for slope in range(side))]
    lines = []
    for normal in directions:
        a = (multiples * normal[0] + side // 2) % side - side // 2
        b = (multiples * normal[1] + side // 2) % side - side // 2
        shortest = int(np.argmin(a**2 + b**2))
        lines.append((a[shortest] * row + b[shortest] * column) % side)
    return np.stack(lines)


def _haar_steps(length: int) -> tuple[list[Doubles], list[int]]:
    """Orthonormal steps of mean 0 along a line, and the scale of each: how often it was halved."""
    steps = []
    scales = []
    intervals = [(0, length, 0)]
    while intervals:
        start, stop, scale = intervals.pop(0)
        if stop - start < 2:
            continue
        middle = (start + stop) // 2
        left = middle - start
        right = stop - middle
        step = np.zeros(length)
        step[start:middle] = np.sqrt(right / (left * (left + right)))
        step[middle:stop] = -np.sqrt(left / (right * (left + right)))
        steps.append(step)
        scales.append(scale)
        intervals += [(start, middle, scale + 1), (middle, stop, scale + 1)]
    return steps, scales


def _denoise_blocks(values: Floats, strength: float, basis: Basis) -> Floats:
    """(H, W) with the ridgelets of overlapping blocks shrunk, one strip of blocks at a time."""
    side = round(len(basis.ridgelets) ** 0.5)
    height, width = values.shape
    step = max(side // _BLOCKS_PER_SIDE, 1)
    # So many blocks that every pixel has as many as it can.
    rows = -(-(height + side) // step)
    columns = -(-(width + side) // step)
    below = step * (rows - 1) - height + side
    beside = step * (columns - 1) - width + side
    padded = np.pad(values, [(side, below), (side, beside)], mode="symmetric")

    noise = np.float32(strength * _estimate_deviation(values))
    # Raised cosine: a line that leaves a block comes back at its other side.
    bell = np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 2
    window = np.outer(bell, bell).astype(np.float32)
    total = np.zeros_like(padded)
    weights = np.zeros_like(padded)
    for top in range(0, rows * step, step):
        strip = np.lib.stride_tricks.sliding_window_view(padded[top : top + side], side, axis=1)
        blocks = strip[:, : columns * step : step].transpose(1, 0, 2).reshape(columns, -1)
        coefficients = blocks @ basis.ridgelets.T
        for scale in basis.scales:
            _shrink(coefficients[:, scale], noise)
        denoised = (coefficients @ basis.ridgelets).reshape(columns, side, side) * window
        for column in range(side):
            pixels = (slice(top, top + side), slice(column, column + columns * step, step))
            total[pixels] += denoised[:, :, column].T
            weights[pixels] += window[:, column, None]

    inside = (slice(side, side + height), slice(side, side + width))
    return np.asarray(total[inside] / weights[inside])


def _shrink(coefficients: Floats, noise: np.float32) -> None:
    """BayesShrink in place, (blocks, coefficients): soft, at noise^2 over the signal's sigma."""
    power = np.square(coefficients).mean(axis=1, keepdims=True) - noise**2
    threshold = noise**2 / np.sqrt(np.maximum(power, np.float32(1e-12)))
    shrunk = np.maximum(np.abs(coefficients) - threshold, 0)
    coefficients[:] = np.sign(coefficients) * shrunk


def _estimate_deviation(values: Floats) -> float:
    """Robust standard deviation of the finest diagonal details (Donoho 1995).

    Exact zeros, outside the fan, do not count.
    """
    details = np.abs(np.diff(np.diff(values, axis=0), axis=1) / 2)
    details = details[details > 1e-5]
    return float(np.median(details)) / _NORMAL_MEDIAN if details.size else 0.0
