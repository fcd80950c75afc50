"""Triangle meshes made from a few shapes: turned profiles, tubes, boxes, prisms and spheres."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numpy.typing import ArrayLike

from ...common.array_types import Colour, Draws, Float32s, Float64s, Int32s
from .waves import Waves

GREY: Colour = (0.5, 0.5, 0.5)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh with colours.

    vertices: (V, 3) float32 metres, z up.  colours: (V, 3) float32 albedo.
    triangles: (T, 3) int32.
    """

    vertices: Float32s
    colours: Float32s
    triangles: Int32s

    def moved(
        self, offset: ArrayLike = (0.0, 0.0, 0.0), scale: float | Sequence[float] = 1.0
    ) -> Mesh:
        """The mesh scaled, then shifted by `offset` metres."""
        points = self.vertices * np.asarray(scale, dtype=np.float32)
        return replace(self, vertices=points + np.asarray(offset, dtype=np.float32))

    def turned(self, axes: str, *angles_rad: float) -> Mesh:
        """The mesh turned about the origin; see `rotation`."""
        return self.rotated(rotation(axes, *angles_rad))

    def rotated(self, matrix: npt.NDArray[np.floating]) -> Mesh:
        """The mesh turned by a (3, 3) matrix."""
        turn = np.asarray(matrix, dtype=np.float32)
        x, y, z = self.vertices.T
        rows = [turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z for k in range(3)]
        return replace(self, vertices=np.stack(rows, axis=-1))

    def tinted(self, colour: ArrayLike) -> Mesh:
        """The mesh in one colour."""
        return replace(self, colours=np.full_like(self.colours, colour))

    def standing(self) -> Mesh:
        """The same mesh with its lowest point at z = 0."""
        return self.moved((0, 0, -float(self.vertices[:, 2].min())))


def rotation(axes: str, *angles_rad: float) -> Float64s:
    """(3, 3) product of right-handed turns about axes such as "x" or "zyz", the last one first."""
    matrices = np.tile(np.eye(3), (len(axes), 1, 1))
    for matrix, axis, angle_rad in zip(matrices, axes, angles_rad, strict=True):
        c = np.cos(angle_rad)
        s = np.sin(angle_rad)
        first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
        matrix[first, first] = matrix[second, second] = c
        matrix[first, second] = -s
        matrix[second, first] = s
    return functools.reduce(np.matmul, matrices)


def circle(points: int) -> Float64s:
    """(points, 3) unit circle about z."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])


def mesh(vertices: ArrayLike, triangles: ArrayLike, colour: ArrayLike = GREY) -> Mesh:
    """A mesh of one colour, or of one colour a vertex."""
    points = np.asarray(vertices, dtype=np.float32)
    colours = np.broadcast_to(np.asarray(colour, dtype=np.float32), points.shape).copy()
    return Mesh(points, colours, np.asarray(triangles, dtype=np.int32))


def join(parts: Iterable[Mesh]) -> Mesh:
    """All parts as one mesh."""
    parts = list(parts)
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]], dtype=np.int32)
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.colours for part in parts]),
        np.concatenate([part.triangles + at for part, at in zip(parts, starts, strict=True)]),
    )


def vertex_normals(vertices: Float32s, triangles: Int32s) -> Float32s:
    """(V, 3) unit normals, the area-weighted mean of the triangles around each vertex."""
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    areas = np.repeat(np.cross(b - a, c - a), 3, axis=0).T
    total = np.array(
        [np.bincount(triangles.ravel(), component, len(vertices)) for component in areas]
    )
    lengths = np.maximum(np.sqrt((total**2).sum(axis=0)), 1e-20)
    return np.ascontiguousarray((total * (1 / lengths)).T, np.float32)


@functools.cache
def grid_triangles(rows: int, columns: int, closed: bool = False) -> Int32s:
    """Triangles (T, 3) of a rows x columns vertex grid; `closed` joins its last and first columns.

    Cell (i, j) is triangle 2 * (i * cells + j) and the next: (a, b, c) and (a, c, d) of its corners
    a = (i, j), b = (i + 1, j), c = (i + 1, j + 1), d = (i, j + 1).
    """
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    if closed:
        number = np.append(number, number[:, :1], axis=1)
    a = number[:-1, :-1]
    b = number[1:, :-1]
    c = number[1:, 1:]
    d = number[:-1, 1:]
    triangles: Int32s = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    triangles.setflags(write=False)
    return triangles


def lathe(
    profile: ArrayLike, segments: int, colour: ArrayLike = GREY, crease: bool = False
) -> Mesh:
    """Turn an (P, 2) profile of (radius, height) about the z axis.

    colour: one, or one a profile point.  crease: keep the profile's corners sharp.
    """
    points = np.asarray(profile, dtype=np.float32)
    colours = np.broadcast_to(np.asarray(colour, dtype=np.float32), (len(points), 3))
    if crease:
        pairs = (slice(k, k + 2) for k in range(len(points) - 1))
        return join(lathe(points[pair], segments, colours[pair]) for pair in pairs)
    angle = np.arange(segments) * (2 * np.pi / segments)
    radius = points[:, :1]
    height = np.repeat(points[:, 1:], segments, axis=1)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
    triangles = grid_triangles(len(points), segments, closed=True)[:, ::-1]
    return mesh(vertices.reshape(-1, 3), triangles, np.repeat(colours, segments, axis=0))


def tube(
    path: Float64s, radius: ArrayLike, segments: int, closed: bool = False, colour: ArrayLike = GREY
) -> Mesh:
    """A round bar along an (N, 3) path; radius and colour may change along it; ends are capped."""
    points = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(points))
    colours = np.broadcast_to(np.asarray(colour, dtype=np.float32), points.shape)
    if closed:
        tangents = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    else:  # a ring of radius 0 at either end, and the rims twice to keep their edges
        rings = np.array([0, 0, *range(len(points)), -1, -1])
        tangents = np.gradient(points, axis=0)[rings]
        points = points[rings]
        radii = radii[rings]
        colours = colours[rings]
        radii[[0, -1]] = 0
    tangents /= np.maximum(np.sqrt((tangents**2).sum(axis=1, keepdims=True)), 1e-12)
    side = _sides(tangents)
    up = np.cross(tangents, side)
    angle = np.arange(segments) * (2 * np.pi / segments)
    around = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * up[:, None]
    vertices = (points[:, None] + radii[:, None, None] * around).reshape(-1, 3)
    triangles = grid_triangles(len(points) + closed, segments, closed=True) % len(vertices)
    return mesh(vertices, triangles[:, ::-1], np.repeat(colours, segments, axis=0))


def _sides(tangents: Float64s) -> Float64s:
    """(N, 3) unit vectors across unit tangents that do not spin along the path."""
    sides = np.empty_like(tangents)
    x, y, z = np.eye(3)[np.argmin(np.abs(tangents[0]))].tolist()
    for k, (ax, ay, az) in enumerate(tangents.tolist()):
        along = ax * x + ay * y + az * z
        x = x - ax * along
        y = y - ay * along
        z = z - az * along
        scale = 1 / max(math.sqrt(x * x + y * y + z * z), 1e-12)
        x = x * scale
        y = y * scale
        z = z * scale
        sides[k] = x, y, z
    return sides


def bars(ends: Iterable[tuple[ArrayLike, ArrayLike]], radius: float, segments: int = 8) -> Mesh:
    """Straight round bars between pairs of points."""
    return join(tube(np.array(pair), radius, segments) for pair in ends)


def sheet(points: Float64s, colour: ArrayLike = GREY, turned: bool = False) -> Mesh:
    """A (R, C, 3) grid of points as a sheet.  turned: it looks the other way."""
    triangles = grid_triangles(*points.shape[:2])
    return mesh(points.reshape(-1, 3), triangles[:, ::-1] if turned else triangles, colour)


def box(
    size: Sequence[float], centre: Sequence[float] = (0, 0, 0), colour: ArrayLike = GREY
) -> Mesh:
    """A box with sharp edges."""
    outline = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * size[:2]
    x, y, z = centre
    return prism(outline, size[2], colour).moved((x, y, z - size[2] / 2))


def prism(outline: ArrayLike, height: float, colour: ArrayLike = GREY) -> Mesh:
    """A counter-clockwise (P, 2) outline raised from z = 0 to `height`, edges sharp.

    The middle of the outline must see all its corners.
    """
    flat = np.asarray(outline, dtype=np.float64)
    count = len(flat)
    low = np.column_stack([flat, np.zeros(count)])
    high = low + np.array([0, 0, height])
    fan = np.array([[count, k, (k + 1) % count] for k in range(count)])
    lids = [np.append(lid, lid.mean(axis=0, keepdims=True), axis=0) for lid in (low, high)]
    quads = np.stack([low, np.roll(low, -1, 0), np.roll(high, -1, 0), high], axis=1)
    sides = (mesh(quad, [[0, 1, 2], [0, 2, 3]], colour) for quad in quads)
    return join([mesh(lids[1], fan, colour), mesh(lids[0], fan[:, ::-1], colour), *sides])


@functools.cache
def sphere(subdivisions: int) -> Mesh:
    """A unit icosphere; 20 * 4 ** subdivisions triangles."""
    golden = (1 + np.sqrt(5)) / 2
    corners = np.array([(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([corners, corners[:, [1, 2, 0]], corners[:, [2, 0, 1]]])
    # Faces are the triples of corners that are all as close to each other as corners can be.
    distance = np.linalg.norm(points[:, None] - points[None], axis=-1)
    is_side = np.abs(distance - distance[distance > 0].min()) < 1e-9
    triples = itertools.combinations(range(len(points)), 3)
    face_corners = [list(t) for t in triples if all(is_side[t[k], t[k - 1]] for k in range(3))]
    outward = [t if np.linalg.det(points[t]) > 0 else t[::-1] for t in face_corners]
    faces = np.array(outward, np.int32)
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        unique, which = np.unique(edges, axis=0, return_inverse=True)
        middle = (len(points) + which.reshape(-1, 3)).astype(np.int32)
        points = np.concatenate([points, points[unique].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = middle.T
        corners_of = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = np.concatenate([np.stack(corner, axis=-1) for corner in corners_of])
        points = points / np.linalg.norm(points, axis=1, keepdims=True)
    return mesh(points / np.linalg.norm(points, axis=1, keepdims=True), faces)


def rough(smooth: Mesh, rng: Draws, depth_m: float, longest_m: float, shortest_m: float) -> Mesh:
    """The mesh with fractal bumps of standard deviation `depth_m` along its normals."""
    field = Waves(rng, longest_m, shortest_m, 0.8, dimensions=3)
    bumps = field(*smooth.vertices.T) * np.float32(depth_m)
    normals = vertex_normals(smooth.vertices, smooth.triangles)
    return Mesh(smooth.vertices + normals * bumps[:, None], smooth.colours, smooth.triangles)
