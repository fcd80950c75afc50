"""From the pixels of a rendered frame to the echoes that a sonar's window holds.

A pixel's point is P = z K^-1 (u, v, 1)^T (Yang et al. 2024, Eq. 2), seen from the sonar's mount.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Bools, Float32s, Float64s, Int32s
from ..frames.frame import Frame
from ..render.base import Mount, Rendered
from . import array, polar
from .polar import Echoes
from .settings import SonarSettings
from .window import Extent, Window

# Cosine below which a surface is seen edge on, so that its area is not known.
_GRAZING_COSINE = 0.05
_EDGE_RATIO = 0.1
LABELLED_BEAM_DB = 20.0
"""Two-way loss of the vertical beam, dB, up to which echoes are labelled: the main lobe without
its foot, and no sidelobe."""


class Insonified(NamedTuple):
    """The lit surface inside a window.

    echoes: strength = radiance * range ** (tvg_db_per_decade / 10), in the order of the pixels.
    pixel: (N,) int32 flat camera pixel of each.
    hit: (range_bins, beams) bool, the bins that hold one.
    """

    echoes: Echoes
    pixel: Int32s
    hit: Bools


@dataclass(frozen=True, eq=False)
class LitSurface:
    """A rendered frame behind a window of the sonar.

    conical: whether the sonar's beams are cones about a line of elements, not vertical planes;
        see `Echoes.in_conical_beams`.
    class_echoes: backscatter coefficients of the classes, by which surfaces of a complex field
        echo; empty for the paper's points, which know no materials.
    """

    frame: Frame
    rendered: Rendered
    window: Window
    sonar: SonarSettings
    conical: bool = False
    class_echoes: tuple[float, ...] = ()

    @cached_property
    def insonified(self) -> Insonified:
        """The echoes within `vfov_deg`, computed on first use."""
        return self._within(None)

    @cached_property
    def shown(self) -> Insonified:
        """The echoes that the image shows, which labels are made of.

        Of a complex field these are all that the vertical beam pattern lets through with at most
        LABELLED_BEAM_DB of loss, each as strong as pattern and material make it; of points those
        of `insonified`.
        """
        if not self.conical:
            return self.insonified
        surface = self._within(labelled_half_angle_rad(self.sonar))
        strength = surface.echoes.strength * vertical_weight(
            surface.echoes.elevation_rad, self.sonar
        )
        if self.frame.segmentation is not None and self.class_echoes:
            coefficients = np.array(self.class_echoes, np.float32)
            strength *= coefficients[self.frame.segmentation.reshape(-1)[surface.pixel]]
        echoes = replace(surface.echoes, strength=np.asarray(strength, np.float32))
        return surface._replace(echoes=echoes)

    def _within(self, half_vfov_rad: float | None) -> Insonified:
        surface = insonified(self.frame, self.rendered, self.window, self.sonar, half_vfov_rad)
        echoes = surface.echoes
        if not self.sonar.mount.colocated:
            weight = mount_weight(self.frame, self.sonar.mount, 2).reshape(-1)
            echoes = replace(echoes, strength=echoes.strength * weight[surface.pixel])
        if self.conical:
            echoes = echoes.in_conical_beams()
        return surface._replace(echoes=echoes)


def vertical_table(sonar: SonarSettings) -> Float32s:
    """(4097,) two-way vertical intensity pattern at equal steps of sin(elevation) from -1 to 1."""
    return array.vertical_table(sonar.vfov_deg, sonar.array)


def vertical_weight(elevation_rad: Float32s, sonar: SonarSettings) -> Float32s:
    """(N,) two-way intensity that the vertical beam passes from (N,) elevations, 0 to 1."""
    table = vertical_table(sonar)
    step = (np.sin(elevation_rad) + 1) / 2 * (len(table) - 1)
    weight: Float32s = table[np.rint(step).astype(np.intp)]
    return weight


def labelled_half_angle_rad(sonar: SonarSettings) -> float:
    """Elevation at which the main lobe of the two-way beam has lost LABELLED_BEAM_DB."""
    pattern = vertical_table(sonar)
    upper_half = pattern[len(pattern) // 2 :]
    faint = np.flatnonzero(upper_half < 10 ** (-LABELLED_BEAM_DB / 10))
    if not len(faint):
        return math.pi / 2
    return math.asin(float(faint[0]) / (len(upper_half) - 1))


def extent(frame: Frame, rendered: Rendered, sonar: SonarSettings) -> Extent:
    """What the window of an image is fitted to."""
    from . import kernels  # loads numba

    lit_m = np.empty(frame.depth_m.size + 1, np.float32)
    limits = sonar.range
    half_hfov, half_vfov, near_m, far_m = map(
        np.float32, (*np.deg2rad([sonar.hfov_deg, sonar.vfov_deg]) / 2, limits.min_m, limits.max_m)
    )
    pixels = _pixels(frame, rendered, sonar)
    top_view = sonar.projection == "top_view"
    lit, *edges_rad = kernels.list_lit_distances(
        pixels, half_hfov, half_vfov, top_view, near_m, far_m, lit_m
    )
    return Extent(lit_m[: int(lit)], *edges_rad)


def insonified(
    frame: Frame,
    rendered: Rendered,
    window: Window,
    sonar: SonarSettings,
    half_vfov_rad: float | None = None,
) -> Insonified:
    """The lit surface inside the window, with time-varying gain.

    half_vfov_rad: largest elevation; None: half of `vfov_deg`.
    """
    from . import kernels  # loads numba

    size = frame.depth_m.size + 1
    if half_vfov_rad is None:
        half_vfov_rad = math.radians(sonar.vfov_deg) / 2
    echo_values = tuple(np.empty(size, np.float32) for _ in range(4))
    pixel = np.empty(size, np.int32)
    hit = np.zeros(sonar.range_bins * sonar.beams + 1, np.bool_)
    grid = polar.polar_grid(window, sonar)
    count = kernels.insonified(
        _pixels(frame, rendered, sonar),
        np.float32(half_vfov_rad),
        tuple(grid.even),
        grid.edges_rad,
        sonar.tvg_db_per_decade / 10,
        echo_values,
        pixel,
        hit,
    )
    echoes = Echoes(*(values[:count] for values in echo_values))
    in_bins = hit[:-1].reshape(sonar.range_bins, sonar.beams)
    return Insonified(echoes, pixel[:count], in_bins)


def mount_weight(frame: Frame, mount: Mount, exponent: float | Float64s) -> Float32s:
    """(H, W) float32: what the render times a pixel's solid angle lacks of the sonar's echo.

    The render is albedo cos_s / r_s^2 with the sonar's incidence and range, a pixel sees the area
    r_c^2 dO / cos_c with the camera's, and backscatter by cos_s^n leaves cos_s^n / r_s^4 of it:
    cos_s^(n - 1) / cos_c (r_c / r_s)^2.  exponent: n, of all pixels or (H, W).
    """
    from ..render import kernels  # loads numba, as the next
    from ..render.surface import grid_of

    sonar_m = mount.position_camera_m().astype(np.float32)
    filled = tuple(np.empty(frame.depth_m.shape, np.float32) for _ in range(3))
    # Frames of a cache have lost what was no surface, so every neighbour here may be joined.
    kernels.facing(grid_of(frame.depth_m, frame.intrinsics, _EDGE_RATIO), sonar_m, filled)
    cosine_camera, cosine, nearer = filled
    cosine_camera = np.maximum(cosine_camera, np.float32(_GRAZING_COSINE))
    cosine = np.maximum(cosine, np.float32(_GRAZING_COSINE))
    power = np.float32(exponent - 1)
    return np.asarray(cosine**power / cosine_camera * nearer, np.float32)


def _pixels(frame: Frame, rendered: Rendered, sonar: SonarSettings) -> tuple[Any, ...]:
    across, down = frame.intrinsics.directions(*frame.depth_m.shape)
    return (
        np.ascontiguousarray(frame.depth_m, dtype=np.float32),
        np.ascontiguousarray(rendered.radiance, dtype=np.float32),
        np.ascontiguousarray(rendered.surface),
        across.astype(np.float32),
        down.astype(np.float32),
        *sonar.mount.axes(),
    )
