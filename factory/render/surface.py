"""A frame made ready for rendering, and the shading law that all renderers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from factory.cloud import back_project, normals, surface_mask
from factory.frame import Frame
from factory.render.albedo import albedo
from factory.render.base import RenderSettings


@dataclass(frozen=True, eq=False)
class Surface:
    """What one frame's pixels show, in camera axes.

    points_m: (H, W, 3) float32.  normals: (H, W, 3) float32, unit, towards the camera.
    albedo: (H, W) float32 in [0, 1].  mask: (H, W) bool, pixels that are surface.
    """

    points_m: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    albedo: npt.NDArray[np.float32]
    mask: npt.NDArray[np.bool_]


def surface_of(frame: Frame, settings: RenderSettings) -> Surface:
    """Points, normals, albedo and surface pixels of a frame."""
    points_m = back_project(frame.depth_m, frame.intrinsics)
    return Surface(
        points_m,
        normals(points_m, settings.edge_ratio),
        albedo(frame.rgb, frame.valid, settings.albedo),
        surface_mask(frame.depth_m, settings.edge_ratio),
    )


def shade(surface: Surface, sonar_m: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float32]:
    """Lambert's and the inverse-square law: albedo * max(cos(incidence), 0) / range^2, no shadows.

    sonar_m: (3,) position of the sonar in camera axes.  Returns (H, W) float32, 0 off the surface.
    """
    to_sonar_m = np.asarray(sonar_m, np.float32) - surface.points_m
    square_m2 = np.einsum("hwc,hwc->hw", to_sonar_m, to_sonar_m)
    facing_m = np.maximum(np.einsum("hwc,hwc->hw", surface.normals, to_sonar_m), np.float32(0))
    lit = surface.mask & (square_m2 > 0)
    square_m2 = np.where(lit, square_m2, np.float32(1))
    radiance = surface.albedo * facing_m / (square_m2 * np.sqrt(square_m2))
    return np.where(lit, radiance, np.float32(0))
