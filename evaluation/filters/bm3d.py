"""BM3D, written from the paper: Dabov, Foi, Katkovnik and Egiazarian, IEEE TIP 16(8), 2007.

Two passes.  Each takes reference blocks, finds the blocks that look alike, stacks them, shrinks
the stack's coefficients (2D DCT in the block, Walsh-Hadamard across the stack) and puts all blocks
back as a weighted mean.  The first pass shrinks by a hard threshold; the second is a Wiener filter
whose signal power is the first pass's image.  Parameters are the paper's normal profile: block 8,
step 3, search 39x39, stacks of up to 16 and 32, 2.7 sigma, Kaiser window with beta = 2.  Different:
a DCT instead of biorthogonal wavelets in the first pass.
"""

from __future__ import annotations

import numba
import numpy as np

from ...factory.common.array_types import Float32s
from ..metrics.measure import Grey

_BLOCK = 8
_STEP = 3
_REACH = 19
_HARD = 2.7
_STACK_HARD = 16
_STACK_WIENER = 32
# Mean squared difference of blocks that are alike, up to a sigma of 40 and above.
_ALIKE_HARD = (2500 / 255**2, 5000 / 255**2)
_ALIKE_WIENER = (400 / 255**2, 3500 / 255**2)
_LOUD = 40 / 255
_COARSE = 2.0  # threshold in units of sigma before comparing blocks of a loud image


def bm3d(image: Grey, sigma: float) -> Grey:
    """(H, W) float32 with noise of standard deviation `sigma` (fraction of full scale) removed."""
    height, width = image.shape
    # At least one block, and the far border is covered by reflection.
    padded = np.pad(image, _BLOCK, mode="symmetric").astype(np.float32)
    noisy = _all_blocks(padded)
    loud = sigma > _LOUD
    compared = np.where(np.abs(noisy) < _COARSE * sigma, 0, noisy) if loud else noisy
    compared[..., 0] = noisy[..., 0]
    kaiser = np.kaiser(_BLOCK, 2).astype(np.float32)
    window = np.outer(kaiser, kaiser)

    def filtered(
        compared: Float32s, pilot: Float32s, tau: float, stack: int, wiener: bool
    ) -> Float32s:
        """One pass over (R, C, 64) coefficients -> (R + 7, C + 7) image."""
        limit = np.float32(tau * _BLOCK**2)
        noise = np.float32(sigma)
        total, weights = _filter(
            noisy, compared, pilot, noise, limit, stack, wiener, _dct(), window
        )
        return np.asarray(total / weights, dtype=np.float32)

    basic = filtered(compared, noisy, _ALIKE_HARD[loud], _STACK_HARD, False)
    pilot = _all_blocks(basic)
    final = filtered(pilot, pilot, _ALIKE_WIENER[loud], _STACK_WIENER, True)
    return final[_BLOCK : _BLOCK + height, _BLOCK : _BLOCK + width]


def _dct() -> Float32s:
    """(8, 8) orthonormal DCT-II, one basis vector a row."""
    k, n = np.mgrid[0:_BLOCK, 0:_BLOCK]
    basis = np.cos(np.pi * (2 * n + 1) * k / (2 * _BLOCK)) * np.sqrt(2 / _BLOCK)
    basis[0] /= np.sqrt(2)
    return np.asarray(basis, dtype=np.float32)


def _all_blocks(image: Float32s) -> Float32s:
    """(H - 7, W - 7, 64) DCT of the block at every pixel."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (_BLOCK, _BLOCK))
    basis = _dct()
    result = np.empty((*windows.shape[:2], _BLOCK * _BLOCK), dtype=np.float32)
    for row, line in enumerate(windows):  # row by row: all at once would take a second copy
        result[row] = (basis @ line @ basis.T).reshape(-1, _BLOCK * _BLOCK)
    return result


@numba.njit(cache=True, fastmath=True)
def _hadamard(values, count):  # type: ignore[no-untyped-def]
    """Orthonormal Walsh-Hadamard transform across the first `count` blocks, in place."""
    half = 1
    while half < count:
        for start in range(0, count, 2 * half):
            for i in range(start, start + half):
                for k in range(values.shape[1]):
                    a, b = values[i, k], values[i + half, k]
                    values[i, k] = a + b
                    values[i + half, k] = a - b
        half *= 2
    scale = np.float32(1 / np.sqrt(count))
    for i in range(count):
        for k in range(values.shape[1]):
            values[i, k] *= scale


@numba.njit(cache=True, fastmath=True)
def _alike(compared, row, column, tau, places, distances):  # type: ignore[no-untyped-def]
    """Fill `places` with the nearest blocks, the reference first; returns how many (2^n)."""
    rows, columns, size = compared.shape
    room = distances.shape[0]
    block_count = 0
    for r in range(max(0, row - _REACH), min(rows, row + _REACH + 1)):
        for c in range(max(0, column - _REACH), min(columns, column + _REACH + 1)):
            limit = tau if block_count < room else min(tau, distances[block_count - 1])
            distance = np.float32(0)
            if r == row and c == column:
                distance = np.float32(-1)  # the block itself always stays
            else:
                k = 0
                while k < size and distance < limit:
                    for j in range(k, k + 16):
                        step = compared[row, column, j] - compared[r, c, j]
                        distance += step * step
                    k += 16
            if distance >= limit:
                continue
            i = block_count if block_count < room else room - 1
            while i > 0 and distances[i - 1] > distance:
                distances[i] = distances[i - 1]
                places[i, 0] = places[i - 1, 0]
                places[i, 1] = places[i - 1, 1]
                i -= 1
            distances[i] = distance
            places[i, 0] = r
            places[i, 1] = c
            block_count = min(block_count + 1, room)
    count = 1
    while 2 * count <= block_count:
        count *= 2
    return count


@numba.njit(cache=True, fastmath=True)
def _filter(noisy, compared, pilot, sigma, tau, stack, wiener, basis, window):  # type: ignore[no-untyped-def]
    """Sum of all filtered blocks with their weights, and the sum of the weights."""
    rows, columns, size = noisy.shape
    side = basis.shape[0]
    total = np.zeros((rows + side - 1, columns + side - 1), dtype=np.float32)
    weights = np.zeros_like(total)
    places = np.zeros((stack, 2), dtype=np.int64)
    distances = np.zeros(stack, dtype=np.float32)
    group = np.zeros((stack, size), dtype=np.float32)
    guide = np.zeros((stack, size), dtype=np.float32)
    threshold = np.float32(_HARD) * sigma
    for row_number in range((rows - 1 + _STEP - 1) // _STEP + 1):
        row = min(row_number * _STEP, rows - 1)
        for column_number in range((columns - 1 + _STEP - 1) // _STEP + 1):
            column = min(column_number * _STEP, columns - 1)
            count = _alike(compared, row, column, tau, places, distances)
            for i in range(count):
                for k in range(size):
                    group[i, k] = noisy[places[i, 0], places[i, 1], k]
                    guide[i, k] = pilot[places[i, 0], places[i, 1], k]
            _hadamard(group, count)
            power = np.float32(0)
            if wiener:
                _hadamard(guide, count)
                for i in range(count):
                    for k in range(size):
                        squared = guide[i, k] * guide[i, k]
                        part = squared / (squared + sigma * sigma)
                        group[i, k] *= part
                        power += part * part
            else:
                for i in range(count):
                    for k in range(size):
                        if abs(group[i, k]) < threshold:
                            group[i, k] = 0
                        else:
                            power += np.float32(1)
            _hadamard(group, count)
            weight = np.float32(1) / max(power, np.float32(1e-3 if wiener else 1))
            for i in range(count):
                block = basis.T @ group[i].copy().reshape(side, side) @ basis
                for y in range(side):
                    for x in range(side):
                        share = weight * window[y, x]
                        total[places[i, 0] + y, places[i, 1] + x] += share * block[y, x]
                        weights[places[i, 0] + y, places[i, 1] + x] += share
    return total, weights
