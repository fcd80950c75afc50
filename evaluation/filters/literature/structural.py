"""Non-local structured sparsity, after the abstract of Jin, Ku, Ahn, Kim and Ko (2019).

IEEE GRSL 16(8), "Nonhomogeneous Noise Removal From Side-Scan Sonar Images Using Structural
Sparsity".  Public is that a local and a non-local model work together on structural features of
patches, and that the weights of the patches follow noise that is not everywhere the same.  Here:
patches of 8x8 pixels, the likes of each in a window of 39x39 (the matching of `bm3d`); the
non-local model is their mean, weighted by likeness against the noise of that place; the structural
features are the principal components of what the likes differ from it, and the local model keeps
of each component what is more than that noise.  The noise of a place is what the finest cosines of
the patches around it show.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ..base import Gray
from ..bm3d import _alike, _all_blocks, _dct

Floats = npt.NDArray[np.float32]

_BLOCK, _STEP = 8, 4
_LIKE = 6.0  # patches that differ by more than so many times their noise power are others
_AROUND = 25  # pixels over which the noise is taken to be the same


def structural(image: Gray, strength: float, patches: int) -> Gray:
    """(H, W) in 0..1 denoised.

    strength: multiple of the noise's estimated standard deviation.  patches: most likes of a
    patch, itself among them; as many are used as the largest power of two that is found.
    """
    height, width = image.shape
    padded = np.pad(image, _BLOCK, mode="symmetric").astype(np.float32)
    blocks = _all_blocks(padded)
    noise = np.float32(strength) * noise_map(blocks)
    total, weights = _filter(blocks, noise, patches, _dct())
    result: Gray = total / weights
    return result[_BLOCK : _BLOCK + height, _BLOCK : _BLOCK + width]


def noise_map(blocks: Floats) -> Floats:
    """(R, C, 64) cosines of the block at each pixel -> (R, C) standard deviation of the noise.

    The mean magnitude of the cosines with both frequencies in the upper half, over that of a
    normal variable of deviation 1.
    """
    fine = np.abs(blocks.reshape(*blocks.shape[:2], _BLOCK, _BLOCK)[..., 4:, 4:]).mean(axis=(2, 3))
    around = ndimage.uniform_filter(fine, _AROUND, mode="nearest")
    return np.asarray(around / np.float32(np.sqrt(2 / np.pi)), dtype=np.float32)


@numba.njit(cache=True, fastmath=True)
def _filter(blocks, noise, patches, basis):  # type: ignore[no-untyped-def]
    """Sum of all filtered blocks with their weights, and the sum of the weights."""
    rows, columns, size = blocks.shape
    side = basis.shape[0]
    total = np.zeros((rows + side - 1, columns + side - 1), dtype=np.float32)
    weights = np.zeros_like(total)
    places = np.zeros((patches, 2), dtype=np.int64)
    distances = np.zeros(patches, dtype=np.float32)
    group = np.zeros((patches, size), dtype=np.float32)
    for row_number in range((rows - 1 + _STEP - 1) // _STEP + 1):
        row = min(row_number * _STEP, rows - 1)
        for column_number in range((columns - 1 + _STEP - 1) // _STEP + 1):
            column = min(column_number * _STEP, columns - 1)
            power = noise[row, column] ** 2
            tau = max(np.float32(_LIKE * 2 * size) * power, np.float32(1e-6))
            count = _alike(blocks, row, column, tau, places, distances)
            # The non-local model: two equal patches differ by 2 * size * power on average.
            mean = np.zeros(size, dtype=np.float32)
            whole = np.float32(0)
            for i in range(count):
                unlike = max(distances[i], np.float32(0)) / max(
                    np.float32(2 * size) * power, np.float32(1e-12)
                )
                likeness = np.exp(-max(unlike - np.float32(1), np.float32(0)))
                whole += likeness
                for k in range(size):
                    mean[k] += likeness * blocks[places[i, 0], places[i, 1], k]
            mean /= whole
            for i in range(count):
                for k in range(size):
                    group[i, k] = blocks[places[i, 0], places[i, 1], k] - mean[k]
            # The local model: components of the group by its Gram matrix, G = U S V'.
            few = group[:count]
            shrunk = np.zeros_like(few)
            kept = np.float32(0)
            # Noise alone gives components of up to (sqrt size + sqrt count)^2 times its power.
            limit = (np.sqrt(np.float32(size)) + np.sqrt(np.float32(count))) ** 2 * power
            if (few * few).sum() > limit:  # else no component is above it
                # Components from the smaller of the two matrices that have them.
                wide = count <= size
                values, vectors = np.linalg.eigh(few @ few.T if wide else few.T @ few)
                parts = np.zeros(len(values), dtype=np.float32)
                for i in range(len(values)):
                    if values[i] > limit:
                        parts[i] = 1 - limit / values[i]
                        kept += parts[i] ** 2
                kernel = (vectors * parts) @ vectors.T
                shrunk = kernel @ few if wide else few @ kernel
            weight = np.float32(1) / (np.float32(1) + kept)
            for i in range(count):
                block = basis.T @ (shrunk[i] + mean).reshape(side, side) @ basis
                for y in range(side):
                    for x in range(side):
                        total[places[i, 0] + y, places[i, 1] + x] += weight * block[y, x]
                        weights[places[i, 0] + y, places[i, 1] + x] += weight
    return total, weights
