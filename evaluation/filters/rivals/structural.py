"""Non-local structured sparsity, after the abstract of Jin, Ku, Ahn, Kim and Ko (2019).

IEEE GRSL 16(8), "Nonhomogeneous Noise Removal From Side-Scan Sonar Images Using Structural
Sparsity", reference [13] of the SimNFND paper.  Public is that a local and a non-local model work
together on structural features of patches, weighted by noise that is not everywhere the same.

Here: patches of 8x8 pixels and the similar ones in a window of 39x39 (the matching of `bm3d`).  The
non-local model is their weighted mean.  The local model keeps, of each principal component of what
they differ by, the part above the noise of the place, which the finest cosines around it show.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ...metrics.measure import Grey
from ..bm3d import _alike, _all_blocks, _dct

Floats = npt.NDArray[np.float32]

_SIDE_PX = 8
_STEP_PX = 4
_LIKENESS = 6.0  # patches that differ by more than so many times their noise power do not count
_NOISE_WINDOW_PX = 25  # the noise is taken to be the same within such a window


def structural(image: Grey, strength: float, patches: int) -> Grey:
    """(H, W) in 0..1 denoised.

    strength: multiple of the noise's estimated standard deviation.  patches: most similar patches
    of a group; as many are used as the largest power of two that is found.
    """
    height, width = image.shape
    padded = np.pad(image, _SIDE_PX, mode="symmetric").astype(np.float32)
    blocks = _all_blocks(padded)
    noise = np.float32(strength) * estimate_noise(blocks)
    total, weights = _filter_groups(blocks, noise, patches, _dct())
    denoised: Grey = total / weights
    return denoised[_SIDE_PX : _SIDE_PX + height, _SIDE_PX : _SIDE_PX + width]


def estimate_noise(blocks: Floats) -> Floats:
    """(R, C, 64) cosines of the block at each pixel -> (R, C) standard deviation of the noise.

    The mean magnitude of the cosines whose frequencies both lie in the upper half, over that of a
    normal variable of deviation 1.
    """
    cosines = blocks.reshape(*blocks.shape[:2], _SIDE_PX, _SIDE_PX)
    half = _SIDE_PX // 2
    fine = np.abs(cosines[..., half:, half:]).mean(axis=(2, 3))
    mean = ndimage.uniform_filter(fine, _NOISE_WINDOW_PX, mode="nearest")
    return np.asarray(mean / np.float32(np.sqrt(2 / np.pi)), np.float32)


@numba.njit(cache=True, fastmath=True)
def _filter_groups(blocks, noise, patches, basis):  # type: ignore[no-untyped-def]
    """Sum of all denoised patches with their weights, and the sum of the weights."""
    rows, columns, size = blocks.shape
    side = basis.shape[0]
    total = np.zeros((rows + side - 1, columns + side - 1), dtype=np.float32)
    weights = np.zeros_like(total)
    places = np.zeros((patches, 2), dtype=np.int64)
    distances = np.zeros(patches, dtype=np.float32)
    group = np.zeros((patches, size), dtype=np.float32)
    for row_number in range((rows - 1 + _STEP_PX - 1) // _STEP_PX + 1):
        row = min(row_number * _STEP_PX, rows - 1)
        for column_number in range((columns - 1 + _STEP_PX - 1) // _STEP_PX + 1):
            column = min(column_number * _STEP_PX, columns - 1)
            power = noise[row, column] ** 2
            # Two patches of one structure differ by 2 * size * power on average.
            expected = np.float32(2 * size) * power
            tau = max(np.float32(_LIKENESS) * expected, np.float32(1e-6))
            count = _alike(blocks, row, column, tau, places, distances)

            # The non-local model: their mean, weighted by likeness.
            mean = np.zeros(size, dtype=np.float32)
            likeness_sum = np.float32(0)
            for i in range(count):
                unlike = max(distances[i], np.float32(0)) / max(expected, np.float32(1e-12))
                likeness = np.exp(-max(unlike - np.float32(1), np.float32(0)))
                likeness_sum += likeness
                for k in range(size):
                    mean[k] += likeness * blocks[places[i, 0], places[i, 1], k]
            mean /= likeness_sum
            for i in range(count):
                for k in range(size):
                    group[i, k] = blocks[places[i, 0], places[i, 1], k] - mean[k]

            # The local model: principal components, G = U S V', from the smaller Gram matrix.
            residual = group[:count]
            shrunk = np.zeros_like(residual)
            kept_power = np.float32(0)
            # Noise alone gives components of up to (sqrt size + sqrt count)^2 times its power.
            limit = (np.sqrt(np.float32(size)) + np.sqrt(np.float32(count))) ** 2 * power
            if (residual * residual).sum() > limit:
                is_wide = count <= size
                gram = residual @ residual.T if is_wide else residual.T @ residual
                values, vectors = np.linalg.eigh(gram)
                parts = np.zeros(len(values), dtype=np.float32)
                for i in range(len(values)):
                    if values[i] > limit:
                        parts[i] = 1 - limit / values[i]
                        kept_power += parts[i] ** 2
                kernel = (vectors * parts) @ vectors.T
                shrunk = kernel @ residual if is_wide else residual @ kernel

            weight = np.float32(1) / (np.float32(1) + kept_power)
            for i in range(count):
                patch = basis.T @ (shrunk[i] + mean).reshape(side, side) @ basis
                for y in range(side):
                    for x in range(side):
                        total[places[i, 0] + y, places[i, 1] + x] += weight * patch[y, x]
                        weights[places[i, 0] + y, places[i, 1] + x] += weight
    return total, weights
