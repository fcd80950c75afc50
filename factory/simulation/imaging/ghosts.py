"""The scatterers of ghosts: what the surfaces of a frame mirror once.

The grain of a ghost belongs to the mirror image of the surface that echoes: for a flat mirror that
stays where it is in the world while the sonar moves.  Both directions of a path have grain of
their own; real ones are equal, and would add in phase where both lie in one beam.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...common.array_types import Float32s, Float64s, Int32s, Int64s, UInt32s
from ..frames.frame import turned
from ..sonar.ghosts import arrivals_m, lengths
from .cells import cell_names, occupied_cells

if TYPE_CHECKING:
    from .grain import CellSizes

# Salts for the names of the cells of mirror images, one for each direction of their paths.
_DIRECTION_SALTS = np.array([0x3C6EF372, 0xA54FF53A], np.uint32)


class GhostPoints(NamedTuple):
    """Cells of mirror images as one point each.

    names: (M,) uint32.  powers: (M,) float32.  sonar_m: (3, M) places in sonar axes, metres.
    """

    names: UInt32s
    powers: Float32s
    sonar_m: Float64s


@dataclass(frozen=True, eq=False)
class GhostScatterers:
    """K ghosts in the bins of an image.

    bins: (K,) int32 flat polar bin.  powers: (K,) float32 intensity over the source level, without
    absorption.  image_m, second_m: (K, 3), see `GhostPaths`.
    direction: (K,) int64, 0 where the echo arrives from the mirror, 1 from the second surface.
    world_from_sonar: (3, 4).
    """

    bins: Int32s
    powers: Float32s
    image_m: Float64s
    second_m: Float64s
    direction: Int64s
    world_from_sonar: Float64s

    def points(self, sizes: CellSizes) -> GhostPoints:
        """The world cells of the mirror images as one point each.

        sizes: edges of the cells by the range of the mirror image.
        """
        edges_m = sizes.edge_at_m(lengths(self.image_m))[:, None]
        world_m = turned(self.world_from_sonar[:, :3], self.image_m) + self.world_from_sonar[:, 3]
        cells = np.asarray(np.floor(world_m / edges_m), np.int64)
        salts = _DIRECTION_SALTS[self.direction]
        occupied = occupied_cells(cells, cell_names(cells, salts), self.powers, edges_m)
        turn = self.world_from_sonar[:, :3]
        image_m = turned(turn.T, occupied.points_m - self.world_from_sonar[:, 3])
        second_m = self._beside_second_m(occupied.first, image_m)
        arrivals = np.stack(arrivals_m(image_m, second_m))
        direction = self.direction[occupied.first]
        sonar_m = arrivals[direction, np.arange(len(direction))].T
        return GhostPoints(occupied.names, occupied.powers, sonar_m)

    def _beside_second_m(self, index: Int64s, image_m: Float64s) -> Float64s:
        """(M, 3) the points whose mirror images are `image_m`, near those of the ghosts `index`."""
        across_m = self.image_m[index] - self.second_m[index]
        normal = across_m / lengths(across_m)[:, None]
        step_m = image_m - self.image_m[index]
        along_normal_m = (step_m * normal).sum(axis=1, keepdims=True)
        return np.asarray(self.second_m[index] + step_m - 2 * along_normal_m * normal)
