"""The scatterers of moving objects: their cells lie in the object's own coordinates.

The grain of an object moves, turns and bends with it, as the grain of the ground stays with the
ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.array_types import Float32s, Float64s, Int32s, Int64s, UInt32s
from ..frames.frame import Body, Frame, MovingPixels
from .cells import cell_names, occupied_cells


@dataclass(frozen=True, eq=False)
class MovingScatterers:
    """The scatterers of one moving object.

    index: (K,) int64, which of the frame's scatterers they are.  own_m: (K, 3) their places in the
    object's own axes, at rest.
    """

    body: Body
    index: Int64s
    own_m: Float64s

    def cells(self, edge_m: float) -> tuple[UInt32s, UInt32s]:
        """(K,) uint32 names of the cells of this edge, and their places in a table of cells."""
        names = self._names(np.floor(self.own_m / edge_m).astype(np.int64))
        from . import kernels  # loads numba

        return names, kernels.scrambled(names)

    def points(self, powers: Float32s, edge_m: float) -> MovingPoints:
        """The object's cells as one point each.

        powers: (K,) of the scatterers.
        """
        cells = np.floor(self.own_m / edge_m).astype(np.int64)
        occupied = occupied_cells(cells, self._names(cells), powers, edge_m)
        return MovingPoints(occupied.names, occupied.powers, self.body.camera_m(occupied.points_m))

    def _names(self, cells: Int64s) -> UInt32s:
        return cell_names(cells, np.uint32(self.body.salt))


@dataclass(frozen=True, eq=False)
class MovingPoints:
    """Cells of a moving object as one point each.

    names: (K,) uint32.  powers: (K,) float32.  camera_m: (K, 3) places in camera axes, metres.
    """

    names: UInt32s
    powers: Float32s
    camera_m: Float64s


def moving_scatterers(
    frame: Frame, pixels: Int32s, parts: Float32s
) -> tuple[MovingScatterers, ...]:
    """The scatterers of each moving object of a frame.

    pixels, parts: see `Scatterers`.
    """
    moving = frame.moving
    if moving is None or not len(moving.pixel):
        return ()
    place = np.searchsorted(moving.pixel, pixels).clip(max=len(moving.pixel) - 1)
    is_moving = moving.pixel[place] == pixels
    index = np.flatnonzero(is_moving)
    place = place[index]
    own_m = _between(moving, place, parts[index], frame.depth_m.shape[1])
    body_of = moving.body[place]
    scatterers = []
    for number in np.unique(body_of):
        chosen = body_of == number
        scatterers.append(MovingScatterers(moving.bodies[number], index[chosen], own_m[chosen]))
    return tuple(scatterers)


def _between(
    moving: MovingPixels,
    place: Int64s,
    parts: Float32s,
    width: int,
) -> Float64s:
    """(K, 3) places of scatterers between a pixel and the one below, where both are one object."""
    own_m = moving.own_m[place]
    pixel_below = moving.pixel[place] + width
    below = np.searchsorted(moving.pixel, pixel_below).clip(max=len(moving.pixel) - 1)
    is_same = (moving.pixel[below] == pixel_below) & (moving.body[below] == moving.body[place])
    step_m = np.where(is_same[:, None], moving.own_m[below] - own_m, 0.0)
    return np.asarray(own_m + parts[:, None] * step_m)


def static_index(moving: tuple[MovingScatterers, ...], count: int) -> Int64s | slice:
    """Which of `count` scatterers belong to the static scene."""
    if not moving:
        return slice(None)
    is_static = np.ones(count, np.bool_)
    for own in moving:
        is_static[own.index] = False
    return np.flatnonzero(is_static)
