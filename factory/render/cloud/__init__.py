"""From a depth image to a surface: points, the triangles between them, and their normals.

Everything is in camera axes (OpenCV: x right, y down, z forward) and metres.  The surface is the
pixel grid itself: neighbouring pixels are joined where their depths agree, and nothing is ever
stretched over a depth discontinuity or over unmeasured pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ...frame import Intrinsics

# A step between neighbours is large when over this part of the edge ratio.  At the default ratio
# that is 2 % of the depth, more than the steps in which structured-light cameras measure.
LARGE_STEP = 0.2

# A large step belongs to a slope when at most this many times the step before or after it.  The
# limb of a sphere, the steepest smooth outline there is, ends in steps of 1 : 2.4.
SLOPE_CHANGE = 3.0


@lru_cache(maxsize=8)
def directions(
    intrinsics: Intrinsics, height: int, width: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """(W,) and (H,): what depth is multiplied by to give x in each column and y in each row."""
    across = (np.arange(width) - intrinsics.cx) / intrinsics.fx
    down = (np.arange(height) - intrinsics.cy) / intrinsics.fy
    return across, down


def back_project(
    depth_m: npt.NDArray[np.floating[Any]], intrinsics: Intrinsics
) -> npt.NDArray[np.float32]:
    """Point of each pixel, P = z K^-1 (u, v, 1)^T (Yang et al. 2024, Eq. 2).

    depth_m: (H, W) depth along the optical axis, 0 = no measurement.  Pixel (u, v) stands for its
    centre, so the top left pixel's centre is (0, 0); lens distortion is not looked at.
    Returns (H, W, 3) float32; pixels without a measurement are (0, 0, 0).
    """
    height, width = depth_m.shape
    across, down = directions(intrinsics, height, width)
    points_m = np.empty((height, width, 3), np.float32)
    points_m[..., 0] = across * depth_m
    points_m[..., 1] = down[:, None] * depth_m
    points_m[..., 2] = depth_m
    return points_m


def joined(
    depth_m: npt.NDArray[np.floating[Any]], edge_ratio: float, down: int, across: int
) -> npt.NDArray[np.bool_]:
    """True where a pixel and the one `down` rows below, `across` columns right are one surface.

    Both are measured and differ by less than `edge_ratio` of the nearer depth.  Of such steps, a
    large one (over a fifth of that) must continue the slope on one of its sides at least: the
    ground seen at grazing incidence is a run of large steps and stays whole, while a low object's
    outline, where one step sticks out, is an edge.

    depth_m: (H, W).  (down, across): (0, 1), (1, 0), (1, 1) or (1, -1).  Returns one value for each
    pair inside the image, (H - down, W - |across|), in image order.
    """
    height, width = depth_m.shape
    left, right = max(0, -across), max(0, across)
    first = depth_m[: height - down, left : width - right]
    second = depth_m[down:, left + across : width - right + across]
    step, nearer = np.abs(second - first), np.minimum(first, second)
    same = step < edge_ratio * nearer
    rows, columns = np.nonzero(same & (step > LARGE_STEP * edge_ratio * nearer))
    start = rows * width + columns + left
    same[rows, columns] = joined_pixels(depth_m, start, start + down * width + across, edge_ratio)
    return np.asarray(same)


def joined_pixels(
    depth_m: npt.NDArray[np.floating[Any]],
    first: npt.NDArray[np.integer[Any]],
    second: npt.NDArray[np.integer[Any]],
    edge_ratio: float,
) -> npt.NDArray[np.bool_]:
    """`joined` for single pairs of neighbours: (N,) flat indices of either pixel -> (N,) bool."""
    flat_m = depth_m.ravel()
    step, nearer = flat_m[second] - flat_m[first], np.minimum(flat_m[first], flat_m[second])
    size = np.abs(step)
    small = size <= LARGE_STEP * edge_ratio * nearer
    upwards = np.sign(step)
    before = upwards * _continued(depth_m, second, first)
    after = -upwards * _continued(depth_m, first, second)
    goes_on = size <= SLOPE_CHANGE * np.maximum(before, after)
    return np.asarray((size < edge_ratio * nearer) & (small | goes_on))


def _continued(
    depth_m: npt.NDArray[np.floating[Any]],
    first: npt.NDArray[np.integer[Any]],
    second: npt.NDArray[np.integer[Any]],
) -> npt.NDArray[np.floating[Any]]:
    """Depth of `second` less that of the next pixel on the line through both; 0 where none is."""
    height, width = depth_m.shape
    row = 2 * (second // width) - first // width
    column = 2 * (second % width) - first % width
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    there_m = depth_m[np.where(inside, row, 0), np.where(inside, column, 0)]
    return np.asarray(np.where(inside & (there_m > 0), depth_m.ravel()[second] - there_m, 0))


@dataclass(frozen=True, eq=False)
class Quads:
    """The quads of four neighbouring pixels, cut into two triangles each; all (H-1, W-1) bool.

    A quad with corners a b over c d is cut along c-b into a-c-b and d-b-c or, where it `falls`,
    along a-d into a-d-b and d-a-c.  upper, lower: whether the triangle on its top side (a-b) and on
    its bottom side (c-d) is surface.
    """

    falls: npt.NDArray[np.bool_]
    upper: npt.NDArray[np.bool_]
    lower: npt.NDArray[np.bool_]

    def corners(
        self, side: Literal["upper", "lower"], chosen: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.int32]:
        """(N, 3) int32 flat pixel indices of the upper or lower triangle of the chosen quads.

        Wound so that the face looks at the camera.
        """
        rows, columns = np.nonzero(chosen)
        width = self.falls.shape[1] + 1
        a = (rows * width + columns).astype(np.int32)
        b, c, d = a + 1, a + width, a + width + 1
        falls = self.falls[rows, columns]
        if side == "upper":
            return np.stack([a, np.where(falls, d, c), b], axis=-1)
        return np.stack([d, np.where(falls, a, b), c], axis=-1)

    def triangles(self) -> npt.NDArray[np.int32]:
        """All surface triangles: (N, 3) int32 flat pixel indices."""
        return np.concatenate(
            [self.corners("upper", self.upper), self.corners("lower", self.lower)]
        )

    def mask(self) -> npt.NDArray[np.bool_]:
        """(H, W) bool: pixels that are a corner of at least one surface triangle."""
        rows, columns = self.falls.shape
        either = self.upper | self.lower
        mask = np.zeros((rows + 1, columns + 1), np.bool_)
        mask[:-1, :-1] |= self.upper | (either & self.falls)
        mask[:-1, 1:] |= self.upper | (either & ~self.falls)
        mask[1:, :-1] |= self.lower | (either & ~self.falls)
        mask[1:, 1:] |= self.lower | (either & self.falls)
        return mask


def cut_quads(depth_m: npt.NDArray[np.floating[Any]], edge_ratio: float) -> Quads:
    """Cut every quad of the (H, W) depth along the diagonal that keeps more of its surface.

    A triangle is surface when all its three sides are `joined`, so a quad with three pixels on a
    surface still gives the triangle between them.
    """
    across, down = joined(depth_m, edge_ratio, 0, 1), joined(depth_m, edge_ratio, 1, 0)
    falling, rising = joined(depth_m, edge_ratio, 1, 1), joined(depth_m, edge_ratio, 1, -1)
    top, bottom, left, right = across[:-1], across[1:], down[:, :-1], down[:, 1:]

    acb, dbc = top & left & rising, bottom & right & rising
    adb, dac = top & right & falling, bottom & left & falling
    falls = (adb & dac & ~(acb & dbc)) | ((adb | dac) & ~(acb | dbc))
    return Quads(falls, np.where(falls, adb, acb), np.where(falls, dac, dbc))


def surface_triangles(
    depth_m: npt.NDArray[np.floating[Any]], edge_ratio: float
) -> npt.NDArray[np.int32]:
    """The pixel-grid mesh: (N, 3) int32 flat pixel indices, faces towards the camera.

    depth_m: (H, W).  edge_ratio: see `joined`; no triangle has corners further apart in depth.
    """
    return cut_quads(depth_m, edge_ratio).triangles()


def surface_mask(
    depth_m: npt.NDArray[np.floating[Any]], edge_ratio: float
) -> npt.NDArray[np.bool_]:
    """(H, W) bool: pixels that are a corner of at least one surface triangle.

    A measured pixel that none of its neighbours supports is a flying pixel of the depth sensor, has
    no orientation, and is no surface.
    """
    return cut_quads(depth_m, edge_ratio).mask()


def normals(points_m: npt.NDArray[np.floating[Any]], edge_ratio: float) -> npt.NDArray[np.float32]:
    """Unit normal of each pixel's surface, towards the camera.

    points_m: (H, W, 3), from `back_project`.  Central differences over neighbours that are `joined`
    to the pixel, one-sided next to an edge.  Where a pixel has neighbours along one grid direction
    alone, its surface is taken to face the camera as far as that allows.

    Returns (H, W, 3) float32; (0, 0, 0) for pixels without measurement or without any neighbour.
    """
    depth_m = points_m[..., 2]
    planes = np.moveaxis(points_m, -1, 0)
    along = _differences(planes, joined(depth_m, edge_ratio, 0, 1))
    down = _differences(planes.swapaxes(1, 2), joined(depth_m, edge_ratio, 1, 0).T).swapaxes(1, 2)
    normal = np.empty(points_m.shape, np.float32)
    normal[..., 0] = down[1] * along[2] - down[2] * along[1]
    normal[..., 1] = down[2] * along[0] - down[0] * along[2]
    normal[..., 2] = down[0] * along[1] - down[1] * along[0]
    length = np.sqrt(np.einsum("hwc,hwc->hw", normal, normal))

    rows, columns = np.nonzero((length == 0) & (along.any(axis=0) | down.any(axis=0)))
    if len(rows):
        line = (along + down)[:, rows, columns].T
        line /= np.linalg.norm(line, axis=-1, keepdims=True)
        to_camera = -points_m[rows, columns]
        facing = to_camera - np.einsum("nc,nc->n", to_camera, line)[:, None] * line
        normal[rows, columns] = facing
        length[rows, columns] = np.linalg.norm(facing, axis=-1)
    normal /= np.where(length > 0, length, 1)[..., None]
    return normal


def _differences(
    planes: npt.NDArray[np.floating[Any]], same: npt.NDArray[np.bool_]
) -> npt.NDArray[np.floating[Any]]:
    """(3, H, W) sum of the steps along the last axis to either joined neighbour, 0 for none."""
    step = planes[..., 1:] - planes[..., :-1]
    step *= same
    total = np.zeros_like(planes)
    total[..., :-1] = step
    total[..., 1:] += step
    return total
