"""The triangle mesh that the ray tracers see: the pixel grid, finished half a pixel past its edges.

A pixel is a small area, but a vertex is a point: at a silhouette the ray through a pixel's centre
meets the outermost vertex of a grid mesh and slips past it half of the time.  So where a triangle
of the grid is missing, its corners' surfaces are continued half way towards each other, along their
tangent planes.  Every surface pixel is then an interior point of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...frame import Intrinsics
from . import Quads, cut_quads, joined_pixels

# A tangent plane seen edge-on runs away: the rim keeps this part of the edge ratio to its pixel.
_RIM_REACH = 0.25

# Shadows are cast by the mesh moved away from the camera by this part of the distance.  A shadow
# ray starts on the very surface that could block it, and rounding decides whether it does; so
# moved, the surface is behind every one of its own points, and shadows begin a pixel's width late
# (1 mm at 1 m).
SHADOW_BIAS = 1e-3


@dataclass(frozen=True, eq=False)
class SurfaceMesh:
    """A triangle mesh in camera axes.

    vertices_m: (N, 3) float32; the first ones are the surface pixels in image order.
    triangles: (M, 3) int32, faces towards the camera; the grid's first, then the rim's.
    pixel: (N,) int64, flat index of the pixel whose surface a vertex belongs to.
    """

    vertices_m: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int32]
    pixel: npt.NDArray[np.int64]


def surface_mesh(
    points_m: npt.NDArray[np.float32],
    normals: npt.NDArray[np.float32],
    intrinsics: Intrinsics,
    edge_ratio: float,
) -> SurfaceMesh:
    """Mesh of a frame: `surface_triangles` of the pixel grid and the rim around them.

    points_m, normals: (H, W, 3) from `render.cloud`.  Frames without surface give empty arrays.
    """
    depth_m = points_m[..., 2]
    quads = cut_quads(depth_m, edge_ratio)
    mask = quads.mask()
    pixel = np.flatnonzero(mask)
    vertex_of = np.zeros(mask.size, np.int32)
    vertex_of[pixel] = np.arange(len(pixel), dtype=np.int32)
    grid = vertex_of[quads.triangles()]

    owner, towards = _rim(depth_m, quads, edge_ratio)
    is_half = towards[..., 0] >= -1
    rim = vertex_of[owner]
    rim[is_half] = len(pixel) + np.arange(is_half.sum(), dtype=np.int32)
    half_m = _half_way(points_m, normals, owner[is_half], towards[is_half], intrinsics, edge_ratio)
    return SurfaceMesh(
        np.concatenate([points_m.reshape(-1, 3)[pixel], half_m]),
        np.concatenate([grid, rim]),
        np.concatenate([pixel, owner[is_half]]),
    )


def _rim(
    depth_m: npt.NDArray[np.float32], quads: Quads, edge_ratio: float
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Rim triangles, each corner a pixel or a place half way from a pixel to another one.

    Returns owner (R, 3), the pixel's flat index, and towards (R, 3, 2), row and column of the other
    one (which may lie just outside the image), or (-2, -2) where the corner is the pixel itself.
    """
    # One pixel of nothing all around gives the image border its rim too.
    depth_m, mask = np.pad(depth_m, 1), np.pad(quads.mask(), 1)
    quads = Quads(np.pad(quads.falls, 1), np.pad(quads.upper, 1), np.pad(quads.lower, 1))
    near_surface = mask[:-1, :-1] | mask[:-1, 1:] | mask[1:, :-1] | mask[1:, 1:]
    missing = np.concatenate(
        [
            quads.corners("upper", near_surface & ~quads.upper),
            quads.corners("lower", near_surface & ~quads.lower),
        ]
    )
    measured = mask.ravel()
    corner = np.concatenate([np.roll(missing, -turn, axis=1) for turn in range(3)]).T
    x, y, z = corner.astype(np.int64)

    def meets(p: npt.NDArray[np.int64], q: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        return measured[p] & measured[q] & joined_pixels(depth_m, p, q, edge_ratio)

    xy, yz, zx = meets(x, y), meets(y, z), meets(z, x)
    alone = measured[x] & ~xy & ~zx
    # An edge of the grid that ends the surface: the rim takes the same edge, vertex for vertex,
    # and nothing overlaps, so that no ray finds a crack and no shadow ray hits a double.
    pieces = [
        (alone, (x, x), (x, y), (x, z)),
        (xy & ~yz, (x, x), (y, y), (y, z)),
        (xy & ~yz & ~zx, (x, x), (y, z), (x, z)),
        (xy & yz & ~zx, (x, x), (y, y), (x, z)),
    ]
    owner = np.concatenate(
        [np.stack([at[chosen] for at, _ in corners], axis=-1) for chosen, *corners in pieces]
    )
    other = np.concatenate(
        [np.stack([to[chosen] for _, to in corners], axis=-1) for chosen, *corners in pieces]
    )
    width = mask.shape[1]
    towards = np.stack([other // width, other % width], axis=-1) - 1
    towards[other == owner] = -2
    return (owner // width - 1) * (width - 2) + owner % width - 1, towards


def _half_way(
    points_m: npt.NDArray[np.float32],
    normals: npt.NDArray[np.float32],
    owner: npt.NDArray[np.int64],
    towards: npt.NDArray[np.int64],
    intrinsics: Intrinsics,
    edge_ratio: float,
) -> npt.NDArray[np.float32]:
    """(N, 3) float32 points half a pixel from their owners (N,), on the owners' tangent planes."""
    width = points_m.shape[1]
    point_m = points_m.reshape(-1, 3)[owner].astype(np.float64)
    normal = normals.reshape(-1, 3)[owner]
    half = (np.stack([owner // width, owner % width], axis=-1) + towards) / 2
    ray = np.ones((len(owner), 3))
    ray[:, 0] = (half[:, 1] - intrinsics.cx) / intrinsics.fx
    ray[:, 1] = (half[:, 0] - intrinsics.cy) / intrinsics.fy
    with np.errstate(divide="ignore", invalid="ignore"):
        depth_m = (normal * point_m).sum(axis=-1) / (normal * ray).sum(axis=-1)
    reach_m = point_m[:, 2] * edge_ratio * _RIM_REACH
    depth_m = np.where(depth_m > 0, depth_m, np.inf)
    depth_m = np.clip(depth_m, point_m[:, 2] - reach_m, point_m[:, 2] + reach_m)
    half_way_m: npt.NDArray[np.float32] = (ray * depth_m[:, None]).astype(np.float32)
    return half_way_m
