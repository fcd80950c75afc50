"""Compiled loops over meshes: normals of points, and frames along tubes.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled
from ..loops.raster_loops import POINTS, TRIANGLES


@compiled(f"void({POINTS}, {TRIANGLES}, float32[:, ::1])")
def point_normals(points: Any, triangles: Any, normals: Any) -> None:
    """(V, 3) unit normals, the mean of the triangles around each point by their area."""
    total = np.zeros((len(points), 3))
    for k in range(len(triangles)):
        a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
        px, py, pz = (
            points[b, 0] - points[a, 0],
            points[b, 1] - points[a, 1],
            points[b, 2] - points[a, 2],
        )
        qx, qy, qz = (
            points[c, 0] - points[a, 0],
            points[c, 1] - points[a, 1],
            points[c, 2] - points[a, 2],
        )
        x, y, z = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
        for corner in (a, b, c):
            total[corner, 0] += x
            total[corner, 1] += y
            total[corner, 2] += z
    for k in range(len(points)):
        x, y, z = total[k, 0], total[k, 1], total[k, 2]
        scale = 1 / max(np.sqrt(x * x + y * y + z * z), 1e-20)
        normals[k, 0], normals[k, 1], normals[k, 2] = x * scale, y * scale, z * scale


@compiled("void(float64[:, ::1], float64[:, ::1], float64[:, ::1])")
def frames(tangents: Any, side: Any, up: Any) -> None:
    """Two unit vectors across each (N, 3) tangent that do not spin along the path.

    tangents: made unit.
    """
    least, x, y, z = np.inf, 0.0, 0.0, 0.0
    for k in range(len(tangents)):
        ax, ay, az = tangents[k, 0], tangents[k, 1], tangents[k, 2]
        scale = 1 / max(np.sqrt(ax * ax + ay * ay + az * az), 1e-12)
        ax, ay, az = ax * scale, ay * scale, az * scale
        tangents[k, 0], tangents[k, 1], tangents[k, 2] = ax, ay, az
        if k == 0:
            least = min(abs(ax), abs(ay), abs(az))
            if abs(ax) == least:
                x = 1.0
            elif abs(ay) == least:
                y = 1.0
            else:
                z = 1.0
        along = ax * x + ay * y + az * z
        x, y, z = x - ax * along, y - ay * along, z - az * along
        scale = 1 / max(np.sqrt(x * x + y * y + z * z), 1e-12)
        x, y, z = x * scale, y * scale, z * scale
        side[k, 0], side[k, 1], side[k, 2] = x, y, z
        up[k, 0], up[k, 1], up[k, 2] = ay * z - az * y, az * x - ax * z, ax * y - ay * x


@compiled(
    f"void(Array(float64, 2, 'C', readonly=True), Array(float64, 1, 'C', readonly=True), {POINTS}, "
    "boolean, float64[::1], float64[::1], float32[:, ::1], float32[:, ::1])"
)
def bend_tube(
    path: Any,
    radii: Any,
    colours: Any,
    closed: Any,
    cosines: Any,
    sines: Any,
    vertices: Any,
    painted: Any,
) -> None:
    """Rings of points around an (N, 3) path, and their colours; see `meshes.tube`.

    radii, colours: (N,), (N, 3), or one for all.  cosines, sines: (S,) of the angles of a ring.
    Written: vertices, painted (R S, 3), N rings, four more where the path is not closed: one of
    radius 0 at either end, and the rims twice to keep their edges.
    """
    count, segments = len(path), len(cosines)
    more = 0 if closed else 2
    rings = count + 2 * more
    tangents = np.empty((rings, 3))
    side, up = np.empty((rings, 3)), np.empty((rings, 3))
    for ring in range(rings):
        k = min(max(ring - more, 0), count - 1)
        for axis in range(3):
            if closed:
                tangents[ring, axis] = path[(k + 1) % count, axis] - path[(k - 1) % count, axis]
            elif k == 0 or k == count - 1:
                low = 0 if k == 0 else count - 2
                tangents[ring, axis] = path[low + 1, axis] - path[low, axis]
            else:
                tangents[ring, axis] = (path[k + 1, axis] - path[k - 1, axis]) / 2
    frames(tangents, side, up)
    for ring in range(rings):
        k = min(max(ring - more, 0), count - 1)
        radius = radii[min(k, len(radii) - 1)]
        if not closed and (ring == 0 or ring == rings - 1):
            radius = 0.0
        paint = min(k, len(colours) - 1)
        for turn in range(segments):
            at = ring * segments + turn
            for axis in range(3):
                beside = side[ring, axis] * cosines[turn] + up[ring, axis] * sines[turn]
                vertices[at, axis] = path[k, axis] + radius * beside
                painted[at, axis] = colours[paint, axis]
