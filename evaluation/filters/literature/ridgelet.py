"""Finite ridgelets: shrinkage of what lies along straight lines.

After the abstract of Shang et al. (2008), which the SimNFND paper names: the orthonormal finite
ridgelet transform in blocks of one size (monoscale) with adaptive thresholds, such that less comes
back at the other side of a block.  Size, wavelet and rule of the threshold are not public.

The transform is that of Do and Vetterli (IEEE TIP 12(1), 2003): the finite Radon transform of a
block of p x p pixels, p a prime, then a wavelet along each projection.  Chosen here: blocks that
overlap, their borders counting least; the unbalanced Haar wavelet (Girardi and Sweldens 1997),
orthonormal at any length; for each scale of each block the threshold of BayesShrink (Chang, Yu and
Vetterli, IEEE TIP 9(9), 2000); and the logarithm, because speckle is multiplicative.
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt

from ..base import BaselineError, Gray
from .logarithm import in_logarithm

Floats = npt.NDArray[np.float32]

_STEPS = 4  # blocks that cover a pixel along each axis
_NORMAL_MEDIAN = 0.6744897501960817  # of the magnitude of a normal variable of deviation 1


def ridgelet(image: Gray, strength: float, block_px: int) -> Gray:
    """(H, W) in 0..1 denoised.

    strength: multiple of the noise's estimated standard deviation.  block_px: side of a block.
    Raises BaselineError where that is no odd prime.
    """
    return in_logarithm(image, partial(_shrunk, strength=strength, side=block_px))


@lru_cache(maxsize=8)
def _lines(side: int) -> npt.NDArray[np.int64]:
    """(p + 1, p, p): for each direction the line, 0 to p - 1, of every pixel.

    Lines are a i + b j = t modulo p.  Of the multiples of a normal (a, b) the shortest orders them:
    neighbours in t are neighbours in the block (section IV of the paper).
    """
    if side < 3 or any(side % divisor == 0 for divisor in range(2, int(side**0.5) + 1)):
        raise BaselineError(f"ridgelet: block_px {side} is no odd prime; take 7, 11, 17 or 31")
    i, j = np.mgrid[0:side, 0:side]
    multiples = np.arange(1, side)
    found = []
    for normal in [(1, 0), *((k, 1) for k in range(side))]:
        a, b = ((multiples * part + side // 2) % side - side // 2 for part in normal)
        best = int(np.argmin(a**2 + b**2))
        found.append((a[best] * i + b[best] * j) % side)
    return np.stack(found)


def _haar(length: int) -> tuple[npt.NDArray[np.float64], list[int]]:
    """((length - 1, length), scales): orthonormal steps of mean 0, and the number of each halving.

    An interval is halved, and each half again, down to single places.
    """
    steps, scales = [], []
    parts = [(0, length, 0)]
    while parts:
        start, stop, scale = parts.pop(0)
        if stop - start < 2:
            continue
        middle = (start + stop) // 2
        left, right = middle - start, stop - middle
        step = np.zeros(length)
        step[start:middle] = np.sqrt(right / (left * (left + right)))
        step[middle:stop] = -np.sqrt(left / (right * (left + right)))
        steps.append(step)
        scales.append(scale)
        parts += [(start, middle, scale + 1), (middle, stop, scale + 1)]
    return np.stack(steps), scales


@lru_cache(maxsize=8)
def basis(side: int) -> tuple[Floats, tuple[slice, ...]]:
    """((p^2, p^2), scales): the ridgelets of a block, one a row, and the rows of each scale.

    Orthonormal; the first is the constant one, the rest go from the widest to the finest.
    """
    lines = _lines(side)
    steps, scales = _haar(side)
    # Back-projected: a ridge in each direction; steps of mean 0 leave nothing for the whole block.
    rows = [np.full(side * side, 1 / side)]
    rows += [(step[along] / np.sqrt(side)).ravel() for step in steps for along in lines]
    starts = [1 + scales.index(scale) * (side + 1) for scale in range(max(scales) + 1)]
    parts = zip(starts, [*starts[1:], len(rows)], strict=True)
    return np.stack(rows).astype(np.float32), tuple(slice(*part) for part in parts)


def _shrunk(values: Floats, strength: float, side: int) -> Floats:
    """The picture with its ridgelets shrunk, block by block."""
    ridgelets, scales = basis(side)
    step = max(side // _STEPS, 1)
    height, width = values.shape
    # So many blocks that every pixel has as many as it can.
    rows, columns = (-(-(size + side) // step) for size in (height, width))
    after = [
        step * (count - 1) - size + side
        for count, size in zip((rows, columns), values.shape, strict=True)
    ]
    padded = np.pad(values, [(side, extra) for extra in after], mode="symmetric")
    noise = np.float32(strength * _noise(values))
    # Raised cosine: a line that leaves a block comes back at its other side.
    bell = np.sin(np.pi * (np.arange(side) + 0.5) / side) ** 2
    window = np.outer(bell, bell).astype(np.float32)
    total, weights = np.zeros_like(padded), np.zeros_like(padded)
    for row in range(0, rows * step, step):
        strip = np.lib.stride_tricks.sliding_window_view(padded[row : row + side], side, axis=1)
        blocks = strip[:, : columns * step : step].transpose(1, 0, 2).reshape(columns, -1)
        found = blocks @ ridgelets.T
        for scale in scales:
            _shrink(found[:, scale], noise)
        kept = (found @ ridgelets).reshape(columns, side, side) * window
        for place in range(side):
            at = (slice(row, row + side), slice(place, place + columns * step, step))
            total[at] += kept[:, :, place].T
            weights[at] += window[:, place, None]
    inside = (slice(side, side + height), slice(side, side + width))
    return total[inside] / weights[inside]


def _shrink(found: Floats, noise: np.float32) -> None:
    """BayesShrink in place, (blocks, coefficients): soft, at noise^2 / deviation of the signal."""
    power = np.square(found).mean(axis=1, keepdims=True) - noise**2
    threshold = noise**2 / np.sqrt(np.maximum(power, np.float32(1e-12)))
    found[:] = np.sign(found) * np.maximum(np.abs(found) - threshold, 0)


def _noise(values: Floats) -> float:
    """Robust standard deviation of the finest diagonal details that are not 0 (Donoho 1995).

    Outside of the fan there is no noise.
    """
    details = np.diff(np.diff(values, axis=0), axis=1) / 2
    some = np.abs(details)[np.abs(details) > 1e-5]
    return float(np.median(some)) / _NORMAL_MEDIAN if some.size else 0.0
