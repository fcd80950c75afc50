"""Cells that hold scatterers: their names, and one point in each.

A name is a hash, and what is drawn for a cell (its coefficient, the place of its point) depends on
the name alone, so it is the same in every frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...common.array_types import Float32s, Float64s, Int64s, UInt32s

_STEPS = np.array([73856093, 19349663, 83492791], np.uint32)
# One word for each axis, to draw the place of a cell's point in the cell.
_AXIS_SALTS = np.array([0x68BC21EB, 0x02E5BE93, 0x967A889B], np.uint32)


class OccupiedCells(NamedTuple):
    """M cells that hold scatterers, as one point each.

    names: (M,) uint32.  powers: (M,) float32, sums over the scatterers of each.
    points_m: (M, 3) float64, in the axes of the cells.
    first: (M,) int64, a scatterer of each.
    """

    names: UInt32s
    powers: Float32s
    points_m: Float64s
    first: Int64s


def cell_names(cells: Int64s, salt: UInt32s | np.uint32) -> UInt32s:
    """(K,) names of (K, 3) cells.  salt: keeps apart what has axes of its own; one, or (K,)."""
    from . import kernels  # loads numba

    corners = (cells.astype(np.uint32) * _STEPS).sum(axis=1, dtype=np.uint32)
    return np.asarray(kernels.scrambled(corners ^ salt), np.uint32)


def places_in_cells(names: UInt32s) -> Float64s:
    """(3, K), where the point of each cell lies in it, 0 to 1: the top 24 bits of hashes."""
    from . import kernels  # loads numba

    return np.stack(
        [(kernels.scrambled(names ^ salt) >> np.uint32(8)) * 2.0**-24 for salt in _AXIS_SALTS]
    )


def occupied_cells(
    cells: Int64s, names: UInt32s, powers: Float32s, edges_m: Float64s
) -> OccupiedCells:
    """The cells of K scatterers, each once.

    cells: (K, 3), of the edges (K, 1).  names: (K,) by `cell_names`.  powers: (K,).
    """
    unique_names, first, cell_of = np.unique(names, return_index=True, return_inverse=True)
    sums = np.bincount(cell_of.reshape(-1), powers, len(unique_names)).astype(np.float32)
    points_m = (cells[first] + places_in_cells(unique_names).T) * edges_m[first]
    return OccupiedCells(unique_names, sums, points_m, first)
