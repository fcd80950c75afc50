"""Faces of many corners: those that are concave are cut by clipping ears.

A fan from one corner, which is right for convex faces, fills the notches of others.  An ear is a
triangle of three neighbouring corners that lies in the face and has no other corner in it; every
simple polygon has two (Meisters 1975), so cutting off one after another covers it.
"""

from __future__ import annotations

import numpy as np

from ...common.array_types import Float64s, Int64s
from ...common.errors import FactoryError

_MOST_CORNERS = 5000
"""Of a concave face; the time to cut it grows with the square of the number."""
# Cross products below this part of the face's own are those of straight corners.
_STRAIGHT = 1e-9


def cut_concave_faces(vertices: Float64s, polygons: Int64s, corners: Int64s, uv: Int64s) -> None:
    """Replace the fans of concave faces by triangles inside them, in place.

    vertices: (V, 3).  polygons: (P, 2), first triangle and number of corners of each face of more
    than three.  corners, uv: (T, 3), numbers of vertices and texture coordinates of triangles.
    Raises FactoryError for a concave face of too many corners.
    """
    for count in np.unique(polygons[:, 1]):
        firsts = polygons[polygons[:, 1] == count, 0]
        # A fan names its corners in order: 0 1 2, 0 2 3, and so on.
        order = np.concatenate([corners[firsts, :2], *_third_corners(corners, firsts, count)], 1)
        flat, scale = _flattened(vertices[order])
        is_concave = (_turns(flat) < -_STRAIGHT * scale[:, None]).any(axis=1)
        if is_concave.any() and count > _MOST_CORNERS:
            raise FactoryError(
                f"has a concave face of {count:,} corners, at most {_MOST_CORNERS:,} are cut; "
                "triangulate it first"
            )
        for face in np.flatnonzero(is_concave):
            first = firsts[face]
            rows = slice(first, first + count - 2)
            ears = _ears(flat[face])
            face_uv = np.concatenate([uv[first, :2], uv[rows, 2]])
            corners[rows] = order[face][ears]
            uv[rows] = face_uv[ears]


def _third_corners(corners: Int64s, firsts: Int64s, count: int) -> list[Int64s]:
    return [corners[firsts + step, 2:] for step in range(count - 2)]


def _flattened(points: Float64s) -> tuple[Float64s, Float64s]:
    """Faces (P, N, 3) along their normals, counter-clockwise: (P, N, 2), and twice their areas."""
    following = np.roll(points, -1, axis=1)
    normals = np.cross(points - points[:, :1], following - points[:, :1]).sum(axis=1)
    lengths = np.linalg.norm(normals, axis=1)
    axis = np.abs(normals).argmax(axis=1)
    sides = np.array([[1, 2], [2, 0], [0, 1]])[axis]
    flat = np.take_along_axis(points, sides[:, None, :], axis=2)
    is_clockwise = np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] < 0
    flat[is_clockwise, :, 0] *= -1
    return flat, lengths


def _turns(flat: Float64s) -> Float64s:
    """(P, N) cross product of the sides that meet at each corner, positive to the left."""
    before = flat - np.roll(flat, 1, axis=1)
    after = np.roll(flat, -1, axis=1) - flat
    return np.asarray(before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0])


def _ears(flat: Float64s) -> Int64s:
    """(N - 2, 3): corners of the triangles that cover a counter-clockwise face (N, 2)."""
    remaining = list(range(len(flat)))
    triangles = []
    index = 0
    tried = 0
    while len(remaining) > 3:
        around = [remaining[(index + step) % len(remaining)] for step in (-1, 0, 1)]
        # One that crosses itself has no ear: any triangle will do.
        if tried > len(remaining) or _is_ear(flat, around, remaining):
            triangles.append(around)
            del remaining[index % len(remaining)]
            tried = 0
            index += 1  # ears from all sides make no slivers at one corner
        else:
            index += 1
            tried += 1
        index %= len(remaining)
    return np.array([*triangles, remaining])


def _is_ear(flat: Float64s, around: list[int], remaining: list[int]) -> bool:
    a, b, c = flat[around]
    if _cross(a, b, c) <= 0:
        return False
    others = flat[remaining]
    inside = (_cross(a, b, others) >= 0) & (_cross(b, c, others) >= 0) & (_cross(c, a, others) >= 0)
    # Corners at the same points are of the ear itself, or of a bridge to a hole.
    is_own = (others[:, None] == flat[around]).all(axis=2).any(axis=1)
    return not (inside & ~is_own).any()


def _cross(a: Float64s, b: Float64s, c: Float64s) -> Float64s:
    """Twice the area of the triangles a, b, c; positive counter-clockwise."""
    along = b - a
    across = c - a
    return np.asarray(along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0])
