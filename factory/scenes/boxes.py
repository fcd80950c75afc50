"""The oriented box around each object that a camera sees, and how much of it is hidden."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..frame import BOX_FIELDS
from .seabed.camera import Objects, Optics, Pose, ZBuffer
from .seabed.kernels import paint

_SIDE_PX = 64  # of the picture in which an object's outline is counted
_NEAREST_M = 0.05

Numbers = npt.NDArray[np.float64]


def boxes_of(
    where: Pose, optics: Optics, objects: Objects, seen: ZBuffer, number: npt.NDArray[np.uint16]
) -> Numbers:
    """(N, 11) of the instances in a view, whose pixels are `number`; see `Frame.boxes`."""
    shown = np.unique(number)
    rows = []
    for instance in shown[shown > 0]:
        which = int(np.flatnonzero(objects.instances == instance)[0])
        first, _, last, _ = objects.parts[which]
        points = (objects.mesh.vertices[first:last] - where.eye) @ where.rotation
        box = oriented(np.stack([points[:, 2], -points[:, 0], -points[:, 1]], axis=-1))
        counted = _outline(where, optics, objects, which, points, seen)
        rows.append([int(instance), int(objects.labels[which]), *box, *counted])
    return np.array(rows, np.float64).reshape(-1, BOX_FIELDS)


def oriented(points: npt.NDArray[np.floating]) -> tuple[float, ...]:
    """Centre (3), length, width, height and yaw (rad) of the box around (V, 3) points, z upright.

    The yaw, to .05 degrees, is that with the least ground: from x to y, of the longer side.
    """
    flat = points[:, :2].astype(np.float64)
    middle = flat.mean(axis=0)
    coarse, _, _ = _narrowest(flat - middle, np.arange(0.0, 90.0))
    yaw_deg, extent, centre = _narrowest(flat - middle, coarse + 0.05 * np.arange(-20, 21))
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    yaw = np.deg2rad((yaw_deg + (0 if extent[0] >= extent[1] else 90) + 90) % 180 - 90)
    x, y = (centre + middle).tolist()
    return x, y, (low + high) / 2, *sorted(extent.tolist(), reverse=True), high - low, float(yaw)


def _narrowest(flat: Numbers, yaws_deg: Numbers) -> tuple[float, Numbers, Numbers]:
    """Of the rectangles around (V, 2) points at some yaws the one of least area.

    Its yaw, its extent along and across that, and its centre.
    """
    cosine, sine = np.cos(np.deg2rad(yaws_deg)), np.sin(np.deg2rad(yaws_deg))
    axes = np.array([[cosine, -sine], [sine, cosine]])
    seen = np.tensordot(flat, axes, 1)
    least, most = seen.min(axis=0), seen.max(axis=0)
    at = int(np.argmin(np.prod(most - least, axis=0)))
    centre = axes[:, :, at] @ (most + least)[:, at] / 2
    return float(yaws_deg[at]), (most - least)[:, at], centre


def _outline(
    where: Pose, optics: Optics, objects: Objects, which: int, points: Numbers, seen: ZBuffer
) -> tuple[float, float]:
    """Pixels that an object alone would cover, beyond the picture too, and those hidden by others.

    points: (V, 3) its own, camera axes.
    """
    ahead = points[points[:, 2] > _NEAREST_M]
    if not len(ahead):
        return 0.0, 0.0
    fx, fy, cx, cy = optics.lens
    height, width = seen.inverse.shape
    places = ahead[:, :2] / ahead[:, 2:] * (fx, fy) + (cx, cy)
    # Of what reaches beside the lens, as far as three pictures.
    limits = np.array([width, height])
    left, top = np.clip(places.min(axis=0), -limits, 2 * limits)
    right, bottom = np.clip(places.max(axis=0), -limits, 2 * limits)
    step = max((right - left) / _SIDE_PX, (bottom - top) / _SIDE_PX, 0.25)
    shape = int((bottom - top) / step) + 2, int((right - left) / step) + 2
    alone = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
    lens = np.array([fx / step, fy / step, (cx - left) / step, (cy - top) / step])
    part = np.ascontiguousarray(objects.parts[which : which + 1])
    sight = where.eye, where.rotation, lens
    paint(objects.mesh.vertices, objects.mesh.triangles, part, 0, sight, alone)
    rows, columns = np.nonzero(alone[0])
    near = alone[0][rows, columns]
    rows, columns = (np.rint(v).astype(int) for v in (top + step * rows, left + step * columns))
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    front = seen.inverse[rows[inside], columns[inside]]
    hidden = np.count_nonzero(front > near[inside] * np.float32(1.02))
    return len(near) * step**2, hidden * step**2
