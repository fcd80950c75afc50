"""Compiled loops over meshes: normals of points, and frames along tubes.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simnfnd.factory.compiled import compiled
from simnfnd.factory.scenes.seabed.loops.raster_loops import POINTS, TRIANGLES


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
