"""Textures as colours of vertices: triangles are cut so fine that their corners show the image."""

from __future__ import annotations

import io
from typing import NamedTuple

import numpy as np

from ...common.array_types import Array, Float32s, Float64s, Int32s, UInt8s
from ...common.errors import FactoryError

# Triangles of a textured part.
_LEAST_TRIANGLES = 6000


def linear_albedo(srgb: Array) -> Float32s:
    """Albedo of sRGB values 0 to 255, by a gamma of 2.2."""
    return np.asarray((np.asarray(srgb, np.float32) / 255) ** 2.2, np.float32)


def read_image(content: bytes) -> UInt8s:
    """(H, W, 3) of an image file.  Raises OSError or ValueError for what is none."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content)) as image:
            return np.array(image.convert("RGB"))
    except Image.DecompressionBombError as error:
        raise ValueError("a texture is too large") from error


# Largest float colours that are fractions, which may overshoot a little, and those of 8 bits.
_LARGEST_FRACTION = 2.0
_LARGEST_BYTE = float(np.iinfo(np.uint8).max)
_LARGEST_SHORT = float(np.iinfo(np.uint16).max)


def unit_colours(stored: Array) -> Float64s:
    """Colours as fractions of full scale, in 0 to 1.

    stored: integers of full scale, or floating-point numbers, which are fractions, or 0 to 255, or
    0 to 65535, as the largest of them tells.
    Raises FactoryError for colours that are no numbers, negative or larger.
    """
    if stored.dtype.kind == "u":
        return np.asarray(stored / np.iinfo(stored.dtype).max, np.float64)
    colours = np.asarray(stored, np.float64)
    if not np.isfinite(colours).all() or colours.min(initial=0) < 0:
        raise FactoryError("has colours that are negative or no numbers; export it again")
    largest = colours.max(initial=0)
    if largest > _LARGEST_SHORT:
        raise FactoryError(f"has colours up to {largest:.6g}; give 0 to 1, or 0 to 255")
    if largest > _LARGEST_BYTE:
        return np.asarray(colours / _LARGEST_SHORT)
    if largest > _LARGEST_FRACTION:
        return np.asarray(colours / _LARGEST_BYTE)
    return np.minimum(colours, 1.0)


class PaintedSurface(NamedTuple):
    """Triangles with the colours of a texture at their vertices: (V, 3), (V, 3) and (T, 3)."""

    vertices: Float64s
    colours: Float32s
    triangles: Int32s


def paint_surface(
    corners: Array,
    uv: Array,
    albedo: Float32s,
    tints: Float32s | None = None,
) -> PaintedSurface:
    """Cut a textured surface into small triangles and give their vertices the texture's colours.

    corners: (T, 3, 3).  uv: (T, 3, 2) in widths and heights of the (H, W, 3) texture, whose top
    row has v = 0.  tints: (T, 3, 3), factors of the texture's colours at the corners.
    """
    # Points of 32 bits lie apart by a millimetre in ten kilometres, so they start from the middle.
    middle = np.zeros(3)
    if len(corners):
        centre = corners.reshape(-1, 3).mean(axis=0)
        middle = np.where(np.abs(centre) > 1000, np.round(centre), 0.0)
    columns = [corners - middle, uv, *([] if tints is None else [tints])]
    cut = np.concatenate(columns, axis=-1).astype(np.float32)
    while 0 < len(cut) < _LEAST_TRIANGLES:
        cut = _quartered(cut)
    points = cut.reshape(-1, cut.shape[-1])

    size = np.array(albedo.shape[1::-1])
    # The far edge belongs to the image, and what lies beyond it repeats it.
    inside = np.where(points[:, 3:5] == 1, np.float32(1 - 1e-6), points[:, 3:5]) % 1
    column, row = (np.floor(inside * size).astype(np.int64) % size).T
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    vertices = points[:, :3].astype(np.float64) + middle
    colours = albedo[row, column]
    if tints is not None:
        colours = colours * points[:, 5:]
    return PaintedSurface(vertices, colours, triangles)


def _quartered(triangles: Float32s) -> Float32s:
    """(4 T, 3, N): each of the (T, 3, N) triangles cut at the middles of its sides."""
    a = triangles[:, 0]
    b = triangles[:, 1]
    c = triangles[:, 2]
    ab = (a + b) / 2
    bc = (b + c) / 2
    ca = (c + a) / 2
    pieces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(piece, axis=1) for piece in pieces])
