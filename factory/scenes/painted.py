"""What readers of mesh files make: parts with names, whose textures are colours of corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .seabed.meshes import Mesh

Floats = npt.NDArray[np.float32]

_LEAST = 6000  # triangles of a textured part


@dataclass(frozen=True, eq=False)
class Part:
    """A mesh of a file and its name there; z up, in units of the file until it is scaled."""

    name: str
    mesh: Mesh


def linear(srgb: npt.NDArray[Any]) -> Floats:
    """Albedo of sRGB values 0 to 255."""
    return np.asarray((np.asarray(srgb, np.float32) / 255) ** 2.2, np.float32)


def painted(corners: Floats, places: npt.NDArray[Any], picture: Floats) -> Mesh:
    """A mesh with the colours of its texture, cut so fine that its corners show them.

    corners: (T, 3, 3).  places: (T, 3, 2) in widths and heights of the (H, W, 3) picture, whose
    top row has place 0.
    """
    cut = np.concatenate([corners, places], axis=-1).astype(np.float32)
    while 0 < len(cut) < _LEAST:
        a, b, c = cut[:, 0], cut[:, 1], cut[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        pieces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        cut = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
    points = cut.reshape(-1, 5)
    size = np.array(picture.shape[1::-1])
    # The far edge belongs to the picture, and what lies beyond it repeats it.
    inside = np.where(points[:, 3:] == 1, np.float32(1 - 1e-6), points[:, 3:]) % 1
    column, row = (np.floor(inside * size).astype(np.int64) % size).T
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    return Mesh(np.ascontiguousarray(points[:, :3]), picture[row, column], triangles)
