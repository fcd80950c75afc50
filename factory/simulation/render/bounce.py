"""One bounce between surfaces: rays from the sonar that one surface mirrors onto another.

Each lit pixel mirrors the sonar's ray about its normal; where the mirrored ray meets a second
surface that the sonar insonifies, there is a path sonar -> mirror -> second surface -> sonar, and
its reverse (docs/physics.md, Ghosts between surfaces).  Whether the second surface is insonified
is known from its own radiance, so a path costs one ray.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...common.array_types import Float32s, Float64s, Int64s
from ..frames.frame import Frame, Intrinsics
from .base import Bounces, RenderSettings
from .ray_caster import RayCaster
from .surface import pixels_of

# Every third row and second column is traced, on a mesh of these pixels alone: a sixth of the work,
# and still several paths in a beam and in a range bin.
_ROW_STRIDE = 3
_COLUMN_STRIDE = 2


def trace_bounces(
    open3d: Any,
    frame: Frame,
    settings: RenderSettings,
    radiance: Float32s,
    sonar_m: Float64s,
) -> Bounces | None:
    """The paths of one bounce in a frame; None where there are none.

    open3d: the module.  radiance: (H, W) of the frame's render, 0 in shadow.
    sonar_m: (3,) in camera axes, metres.
    """
    coarse_settings = replace(
        settings, albedo="constant", edge_ratio=min(1.0, _ROW_STRIDE * settings.edge_ratio)
    )
    pixels = pixels_of(_traced_pixels(frame), coarse_settings)
    is_lit = pixels.mask & (radiance[::_ROW_STRIDE, ::_COLUMN_STRIDE] > 0)
    if not is_lit.any():
        return None
    caster = RayCaster(open3d, pixels)
    normals = caster.surface.normals.reshape(-1, 3)
    width = radiance.shape[1]

    mirror = np.flatnonzero(is_lit)
    mirror_m = caster.surface.points_m.reshape(-1, 3)[mirror]
    mirrored = _mirrored(_unit(mirror_m - sonar_m.astype(np.float32)), normals[mirror])
    hits = caster.first_hits(mirror_m, mirrored)

    second = _full_resolution(hits.pixel, width)
    is_in_front = _dot(normals[hits.pixel], mirrored[hits.ray]) < 0
    is_insonified = radiance.reshape(-1)[second] > 0
    chosen = np.flatnonzero(is_in_front & is_insonified)
    if not len(chosen):
        return None
    ray = hits.ray[chosen]
    apart_m = hits.place_m[chosen] - mirror_m[ray]
    return Bounces(
        mirror=_full_resolution(mirror[ray], width).astype(np.int32),
        second=second[chosen].astype(np.int32),
        distance_m=np.sqrt(_dot(apart_m, apart_m)),
        reflection_loss_db=settings.reflection_loss_db,
        pixels_each=_ROW_STRIDE * _COLUMN_STRIDE,
    )


def _traced_pixels(frame: Frame) -> Frame:
    """The frame of the traced pixels alone."""
    lens = frame.intrinsics
    return replace(
        frame,
        rgb=frame.rgb[::_ROW_STRIDE, ::_COLUMN_STRIDE],
        depth_m=np.ascontiguousarray(frame.depth_m[::_ROW_STRIDE, ::_COLUMN_STRIDE]),
        intrinsics=Intrinsics(
            fx=lens.fx / _COLUMN_STRIDE,
            fy=lens.fy / _ROW_STRIDE,
            cx=lens.cx / _COLUMN_STRIDE,
            cy=lens.cy / _ROW_STRIDE,
            distortion=lens.distortion,
        ),
        segmentation=None,
        instance=None,
    )


def _full_resolution(pixel: Int64s, width: int) -> Int64s:
    """Flat numbers in an image of this width of flat numbers among its traced pixels."""
    row, column = np.divmod(pixel, -(-width // _COLUMN_STRIDE))
    return np.asarray(_ROW_STRIDE * row * width + _COLUMN_STRIDE * column)


def _mirrored(directions: Float32s, normals: Float32s) -> Float32s:
    """(N, 3) unit vectors reflected about (N, 3) unit normals."""
    return np.asarray(directions - 2 * _dot(directions, normals)[:, None] * normals)


def _unit(vectors: Float32s) -> Float32s:
    return np.asarray(vectors / np.sqrt(_dot(vectors, vectors))[:, None])


def _dot(left: Float32s, right: Float32s) -> Float32s:
    """(N,) products, summed in one order on every machine."""
    return np.asarray(
        left[:, 0] * right[:, 0] + left[:, 1] * right[:, 1] + left[:, 2] * right[:, 2]
    )
