"""Compiled loops of the random fields: sums of waves and lumps around points.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled

_F = np.float32
_TURNS = _F(1 / (2 * np.pi))
_ROUND = _F(12582912)  # added and taken off again, it rounds a float32 to whole numbers
_ZERO, _HALF = _F(0), _F(0.5)
# sin(2 pi t) for |t| <= 1/4 by its series, within 6e-8.
_S1, _S3, _S5 = (_F(v) for v in (2 * np.pi, -((2 * np.pi) ** 3) / 6, (2 * np.pi) ** 5 / 120))
_S7, _S9 = _F(-((2 * np.pi) ** 7) / 5040), _F((2 * np.pi) ** 9 / 362880)
_S11 = _F(-((2 * np.pi) ** 11) / 39916800)
_BLOCK = 1024

READ = "Array(float32, 1, 'C', readonly=True)"
ROWS = "Array(float32, 2, 'C', readonly=True)"


@compiled()
def sine_of_turns(turns: Any) -> Any:
    """Sine of an angle in turns, float32, |turns| < 2^21."""
    part = turns - ((turns + _ROUND) - _ROUND)
    size = abs(part)
    size = min(size, _HALF - size)
    t = size if part >= _F(0) else -size
    u = t * t
    return t * (_S1 + u * (_S3 + u * (_S5 + u * (_S7 + u * (_S9 + u * _S11)))))


@compiled(f"void({ROWS}, {ROWS}, {READ}, {READ}, float32[::1])")
def add_waves(axes: Any, vectors: Any, phases: Any, amplitudes: Any, total: Any) -> None:
    """Add to `total` (N,) the waves at `axes` (D, N), D of 2 or 3.

    vectors: (K, D) rad/m.  phases, amplitudes: (K,).
    """
    for begin in range(0, axes.shape[1], _BLOCK):
        # Cut out, so that the compiler sees that no index is negative, and does several at a time.
        x, y = axes[0, begin : begin + _BLOCK], axes[1, begin : begin + _BLOCK]
        z = axes[axes.shape[0] - 1, begin : begin + _BLOCK]
        part = total[begin : begin + _BLOCK]
        for k in range(len(phases)):
            start, height = phases[k] * _TURNS, amplitudes[k]
            a, b = vectors[k, 0] * _TURNS, vectors[k, 1] * _TURNS
            c = vectors[k, 2] * _TURNS if axes.shape[0] == 3 else _ZERO
            for i in range(len(part)):
                part[i] += height * sine_of_turns(start + a * x[i] + b * y[i] + c * z[i])


@compiled("void(float64[:, ::1], float32[:, ::1])")
def cell_borders(points: Any, lumps: Any) -> None:
    """Distance to the second-nearest point less that to the nearest, on a periodic unit square.

    points: (N, 2) in [0, 1).  lumps: (S, S), written.
    """
    side, count = lumps.shape[0], len(points)
    cells = max(int(np.sqrt(count / 2)), 3)
    starts = np.zeros(cells * cells + 1, np.int64)
    cell = np.empty(count, np.int64)
    for i in range(count):
        cell[i] = int(points[i, 1] * cells) * cells + int(points[i, 0] * cells)
        starts[cell[i] + 1] += 1
    for k in range(cells * cells):
        starts[k + 1] += starts[k]
    order, filled = np.empty(count, np.int64), starts.copy()
    for i in range(count):
        order[filled[cell[i]]] = i
        filled[cell[i]] += 1
    for row in range(side):
        y = (row + 0.5) / side
        for column in range(side):
            x = (column + 0.5) / side
            first, second, ring = 9.0, 9.0, 0
            # A ring of cells further out cannot hold a nearer point than its distance.
            while ring <= cells // 2 and second > ((ring - 1) / cells) ** 2:
                for dy in range(-ring, ring + 1):
                    step = 1 if abs(dy) == ring else max(2 * ring, 1)
                    for dx in range(-ring, ring + 1, step):
                        at = (int(y * cells) + dy) % cells * cells + (int(x * cells) + dx) % cells
                        for k in range(starts[at], starts[at + 1]):
                            ex = abs(points[order[k], 0] - x)
                            ey = abs(points[order[k], 1] - y)
                            ex, ey = min(ex, 1 - ex), min(ey, 1 - ey)
                            distance = ex * ex + ey * ey
                            if distance < first:
                                first, second = distance, first
                            elif distance < second:
                                second = distance
                ring += 1
            lumps[row, column] = np.sqrt(second) - np.sqrt(first)


@compiled(f"void({ROWS}, {READ}, {READ}, float32, float32[::1])")
def look_up(tile: Any, u_m: Any, v_m: Any, period_m: Any, values: Any) -> None:
    """Values (N,) of a periodic (S, S) tile, one period every `period_m`, between its pixels.

    S is a power of two.
    """
    side, scale = tile.shape[0], _F(1) / period_m
    for i in range(len(values)):
        x, y = u_m[i] * scale, v_m[i] * scale
        x, y = (x - np.floor(x)) * _F(side), (y - np.floor(y)) * _F(side)
        column, row = int(x), int(y)
        right, down = x - _F(column), y - _F(row)
        column, row = column & (side - 1), row & (side - 1)
        after, below = (column + 1) & (side - 1), (row + 1) & (side - 1)
        upper = tile[row, column] + right * (tile[row, after] - tile[row, column])
        lower = tile[below, column] + right * (tile[below, after] - tile[below, column])
        values[i] = upper + down * (lower - upper)
