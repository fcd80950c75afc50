"""A frame made ready for rendering, and the shading law that all renderers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..frame import Frame, Intrinsics
from . import shading
from . import traced as traced_light
from .albedo import albedo
from .base import RenderSettings
from .cloud import directions
from .cloud import joints as edges

# Traced and closed-form light differ by rounding; a ratio of anything fainter tells nothing.
_FAINTEST = 1e-12


@dataclass(frozen=True, eq=False)
class Surface:
    """What every n-th pixel of a frame shows, in camera axes.

    points_m: (h, w, 3) float32.  normals: (h, w, 3) float32, unit, towards the camera.
    albedo: (h, w) float32 in [0, 1].  mask: (h, w) bool, pixels that are surface.
    intrinsics: of a camera with these pixels alone.
    """

    points_m: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    albedo: npt.NDArray[np.float32]
    mask: npt.NDArray[np.bool_]
    intrinsics: Intrinsics


@dataclass(frozen=True, eq=False)
class Pixels:
    """A frame at full resolution: which pixels are surface, and how strongly each scatters.

    depth_m, albedo: (H, W) float32.  mask: (H, W) bool.  joints: (H, W) uint8, see
    `simnfnd.factory.render.cloud.joints`.
    edge_ratio: see `RenderSettings`.  stride: every how-manieth row and column is traced.
    """

    depth_m: npt.NDArray[np.float32]
    intrinsics: Intrinsics
    albedo: npt.NDArray[np.float32]
    joints: npt.NDArray[np.uint8]
    mask: npt.NDArray[np.bool_]
    edge_ratio: float
    stride: int

    @property
    def traced(self) -> slice:
        """The rows and columns that are traced: the middle one of each `stride`."""
        return slice((self.stride - 1) // 2, None, self.stride)

    @property
    def traced_edge_ratio(self) -> float:
        """`edge_ratio` between traced pixels: on the same slope their steps are larger."""
        return min(1.0, self.edge_ratio * self.stride)

    def surface(self) -> Surface:
        """Points and normals of the traced pixels; the normals are those of full resolution."""
        first = (self.stride - 1) // 2
        chosen = self.albedo[self.traced, self.traced]
        points_m = np.empty((*chosen.shape, 3), np.float32)
        normals = np.empty_like(points_m)
        across, down = directions(self.intrinsics, *self.depth_m.shape)
        shading.orient(
            self.depth_m, self.joints, across, down, first, self.stride, points_m, normals
        )
        mask = np.ascontiguousarray(self.mask[self.traced, self.traced])
        if self.stride > 1:
            # At this distance what hangs loose could join a surface that it is no part of.
            points_m[~mask] = 0
        camera = self.intrinsics
        return Surface(
            points_m,
            normals,
            np.ascontiguousarray(chosen),
            mask,
            Intrinsics(
                camera.fx / self.stride,
                camera.fy / self.stride,
                (camera.cx - first) / self.stride,
                (camera.cy - first) / self.stride,
            ),
        )

    def radiance(self, sonar_m: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float32]:
        """(H, W) float32 of `shade` at full resolution, in compiled loops: no shadows."""
        across, down = directions(self.intrinsics, *self.depth_m.shape)
        x, y, z = np.asarray(sonar_m, np.float32)
        return shading.shade(
            self.depth_m, self.joints, self.mask, self.albedo, across, down, x, y, z
        )

    def apply(
        self,
        radiance: npt.NDArray[np.float32],
        traced: npt.NDArray[np.float32],
        known: npt.NDArray[np.bool_],
    ) -> npt.NDArray[np.float32]:
        """(H, W) float32 full-resolution light from the closed form and the traced pixels.

        radiance: (H, W) of `radiance`.  traced: (h, w), what tracing found where `known`.
        The closed form has each pixel's own detail, tracing knows what is in shadow: their ratio
        is what is spread over the pixels in between.
        """
        coarse = radiance[self.traced, self.traced]
        known = known & (coarse > _FAINTEST)
        ratio = np.where(known, traced / np.where(known, coarse, 1), 0).astype(np.float32)
        first, limit = (self.stride - 1) // 2, np.float32(self.traced_edge_ratio)
        return traced_light.apply_traced(
            radiance, self.depth_m, known, ratio, first, self.stride, limit
        )


def pixels_of(frame: Frame, settings: RenderSettings, stride: int = 1) -> Pixels:
    """Albedo and surface pixels of a frame of which every `stride`-th row and column is traced."""
    depth_m = np.ascontiguousarray(frame.depth_m, np.float32)
    joined = edges.joints(depth_m, settings.edge_ratio)
    return Pixels(
        depth_m,
        frame.intrinsics,
        albedo(frame.rgb, frame.valid, settings.albedo),
        joined,
        edges.surface_mask(joined),
        settings.edge_ratio,
        stride,
    )


def shade(surface: Surface, sonar_m: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.float32]:
    """Lambert's and the inverse-square law: albedo * max(cos(incidence), 0) / range^2, no shadows.

    sonar_m: (3,) position of the sonar in camera axes.  Returns (h, w) float32, 0 off the surface.
    """
    to_sonar_m = np.asarray(sonar_m, np.float32) - surface.points_m
    square_m2 = np.einsum("hwc,hwc->hw", to_sonar_m, to_sonar_m)
    facing_m = np.maximum(np.einsum("hwc,hwc->hw", surface.normals, to_sonar_m), np.float32(0))
    lit = surface.mask & (square_m2 > 0)
    square_m2 = np.where(lit, square_m2, np.float32(1))
    radiance = surface.albedo * facing_m / (square_m2 * np.sqrt(square_m2))
    return np.where(lit, radiance, np.float32(0))
