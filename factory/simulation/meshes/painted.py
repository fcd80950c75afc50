"""Textures as colours of vertices: triangles are cut so fine that their corners show the image."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

# Triangles of a textured part.
_LEAST_TRIANGLES = 6000


def linear_albedo(srgb: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Albedo of sRGB values 0 to 255, by a gamma of 2.2."""
    return np.asarray((np.asarray(srgb, np.float32) / 255) ** 2.2, np.float32)


class PaintedSurface(NamedTuple):
    """Triangles with the colours of a texture at their vertices: (V, 3), (V, 3) and (T, 3)."""

    vertices: npt.NDArray[np.float64]
    colours: npt.NDArray[np.float32]
    triangles: npt.NDArray[np.int32]


def paint_surface(
    corners: npt.NDArray[Any], places: npt.NDArray[Any], albedo: npt.NDArray[np.float32]
) -> PaintedSurface:
    """Cut a textured surface into small triangles and give their vertices the texture's colours.

    corners: (T, 3, 3).  places: (T, 3, 2) in widths and heights of the (H, W, 3) texture, whose top
    row has place 0.
    """
    # Points of 32 bits lie apart by a millimetre in ten kilometres, so they start from the middle.
    middle = np.zeros(3)
    if len(corners):
        centre = corners.reshape(-1, 3).mean(axis=0)
        middle = np.where(np.abs(centre) > 1000, np.round(centre), 0.0)
    cut = np.concatenate([corners - middle, places], axis=-1).astype(np.float32)
    while 0 < len(cut) < _LEAST_TRIANGLES:
        cut = _quartered(cut)
    points = cut.reshape(-1, 5)

    size = np.array(albedo.shape[1::-1])
    # The far edge belongs to the image, and what lies beyond it repeats it.
    inside = np.where(points[:, 3:] == 1, np.float32(1 - 1e-6), points[:, 3:]) % 1
    column, row = (np.floor(inside * size).astype(np.int64) % size).T
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    vertices = points[:, :3].astype(np.float64) + middle
    return PaintedSurface(vertices, albedo[row, column], triangles)


def _quartered(triangles: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(4 T, 3, N): each of the (T, 3, N) triangles cut at the middles of its sides."""
    a = triangles[:, 0]
    b = triangles[:, 1]
    c = triangles[:, 2]
    ab = (a + b) / 2
    bc = (b + c) / 2
    ca = (c + a) / 2
    pieces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(piece, axis=1) for piece in pieces])
