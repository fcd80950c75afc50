"""The scene as scatterers: every lit pixel has a power and polar bins.

A pixel of solid angle dO sees the area r^2 dO / cos(incidence).  Its echo is, over the source
level and without absorption,

    albedo * mu * cos^n * (r^2 dO / cos) * b(elevation) / r^4

(Urick 1983, ch. 8).  The render is albedo * cos / r^2, so with Lambert's n = 2 and the sonar at the
camera the echo is render * mu * dO * b: the area is in the number of pixels, and is not counted
twice.  Only for another exponent or a sonar elsewhere are the cosines themselves needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Array, Bools, Float32s, Float64s, Int32s, UInt32s
from ...common.errors import FrameError
from ..frames.frame import Frame
from ..sonar.array import WaterSettings
from ..sonar.ghosts import ghost_paths, lengths
from ..sonar.settings import SonarSettings
from ..sonar.surface import LitSurface, mount_weight, vertical_table
from ..sonar.window import Window
from .ghosts import GhostScatterers
from .settings import CoherentSettings

_BEAM_STEPS = 16_384


@dataclass(frozen=True, eq=False)
class Scatterers:
    """What echoes in one frame.

    echoes: (H, W) float32, intensity of each camera pixel over the source level, without
    absorption; 0 where nothing echoes.  count: how many pixels echo.
    joins_below: (H, W) bool, of a pixel that echoes, whether the one below shows the same surface.
    surface_power: (range_bins, beams) float32, the sum of the echoes a bin.
    power: the same with ghosts and absorption: the sonar equation.
    owner: (range_bins, beams) int32, a pixel that lies in the bin, -1 where none does.
    in_beam: (range_bins, beams) bool, whether one within vfov_deg does.
    loss: (range_bins,) float32 two-way absorption as a factor on intensity.
    world_from_camera: (4, 4) float64; the identity where the recording has no pose.
    ghosts: what surfaces mirror once.
    """

    echoes: Float32s
    count: int
    joins_below: Bools
    surface_power: Float32s
    power: Float32s
    owner: Int32s
    in_beam: Bools
    loss: Float32s
    frame: Frame
    world_from_camera: Float64s
    ghosts: GhostScatterers | None = None

    def moving_pixels(self) -> tuple[Int32s, Int32s, Float64s, UInt32s]:
        """Pixels of moving objects, as `grain_kernels.strew` wants them.

        Flat pixels, bodies, (M, 3) places in their own axes, and what keeps the names of each body
        apart.
        """
        moving = self.frame.moving
        if moving is None:
            none = np.empty(0, np.int32)
            return none, none, np.empty((0, 3)), np.empty(0, np.uint32)
        salts = np.array([body.salt for body in moving.bodies], np.uint32)
        return (
            np.ascontiguousarray(moving.pixel, np.int32),
            np.ascontiguousarray(moving.body, np.int32),
            np.ascontiguousarray(moving.own_m, np.float64),
            salts,
        )

    @cached_property
    def surface(self) -> tuple[Int32s, Float32s]:
        """(M,) int32 flat polar bins in which a surface lies, and (3, M) float32 a point of it.

        Points are in camera axes, metres.
        """
        bins = np.flatnonzero(self.owner.ravel() >= 0).astype(np.int32)
        pixel = self.owner.ravel()[bins]
        width = self.frame.depth_m.shape[1]
        row = pixel // width  # by one number: faster than divmod
        column = pixel - row * width
        rays = camera_rays(self.frame)
        z = rays.depth_m.ravel()[pixel]
        return bins, np.stack([rays.across[column] * z, rays.down[row] * z, z])


def scatterers(
    surface: LitSurface, water: WaterSettings, acoustics: CoherentSettings
) -> Scatterers:
    """All that echoes in a frame.

    Raises FrameError when nothing lies in the sonar's sector.
    """
    from . import kernels  # loads numba

    frame = surface.frame
    sonar = surface.sonar
    window = surface.window
    shape = (sonar.range_bins, sonar.beams)
    power = np.zeros(shape, np.float32)
    owner = np.full(shape, -1, np.int32)
    in_beam = np.zeros(shape, np.bool_)
    echoes = np.zeros(frame.depth_m.shape, np.float32)
    joins_below = np.zeros(frame.depth_m.shape, np.bool_)
    labels = np.empty((0, 0), np.uint8) if frame.segmentation is None else frame.segmentation
    echo, exponents = np.array(acoustics.of_classes()).T
    echo = echo / (frame.intrinsics.fx * frame.intrinsics.fy)  # the middle pixel's solid angle
    count = kernels.place_scatterers(
        tuple(camera_rays(frame)), surface.rendered.radiance, labels, _factor(surface, exponents),
        echo.astype(np.float32), sonar.mount.axes(), grid_of(window, sonar),
        vertical_table(sonar), float(np.sin(np.deg2rad(sonar.vfov_deg) / 2)),
        (power.reshape(-1), owner.reshape(-1), in_beam.reshape(-1)),
        echoes, joins_below,
    )  # fmt: skip
    if not count:
        raise FrameError(f"{frame.ref.name}: no echo inside the sonar's sector; check sonar.mount")
    pose = np.eye(4) if frame.world_from_camera is None else frame.world_from_camera
    ghosts = _place_ghosts(surface, echo, pose)
    surface_power = power.copy()
    if ghosts is not None:
        power += np.bincount(ghosts.bins, ghosts.powers, power.size).reshape(shape)
    range_m = bin_centres_m(window, sonar).astype(np.float64)
    absorption = water.absorption_db_per_m(sonar.frequency_khz)
    loss = (10 ** (-2 * absorption * range_m / 10)).astype(np.float32)
    power *= loss[:, None]
    return Scatterers(
        echoes=echoes,
        count=count,
        joins_below=joins_below,
        surface_power=surface_power,
        power=power,
        owner=owner,
        in_beam=in_beam,
        loss=loss,
        frame=frame,
        world_from_camera=np.asarray(pose, np.float64),
        ghosts=ghosts,
    )


def _place_ghosts(surface: LitSurface, echo: Float64s, pose: Float64s) -> GhostScatterers | None:
    """The ghosts of one bounce; None where there are none.

    The second surface scatters by Lambert's law, whatever its exponent; a bundle of rays that is
    mirrored with the loss R then echoes as R render mu dO b, render of the second surface and dO of
    the mirror's pixel (docs/physics.md).  b is the one-way pattern towards either end.
    echo: of each class, mu over the focal lengths in pixels.  pose: (4, 4) world from camera.
    """
    paths = ghost_paths(surface)
    if paths is None:
        return None
    frame = surface.frame
    sonar = surface.sonar
    classes: Array = np.zeros(len(paths.radiance), np.uint8)
    if frame.segmentation is not None:
        classes = frame.segmentation.reshape(-1)[paths.second_pixel]
    pattern = vertical_table(sonar)
    sine = np.linspace(-1, 1, len(pattern))
    beam = np.ones(len(paths.radiance))
    for end_m in (paths.image_m, paths.second_m):
        beam *= np.interp(end_m[:, 2] / lengths(end_m), sine, pattern)
    powers = paths.radiance * paths.solid_angle * echo[np.minimum(classes, len(echo) - 1)]
    powers *= np.sqrt(beam)

    bins = np.stack(
        [polar_bins(points_m.T, surface.window, sonar) for points_m in paths.arrivals_m()]
    )
    # The sonar sends and hears in its sector alone.
    chosen = np.flatnonzero((bins >= 0).all(axis=0))
    if not len(chosen):
        return None
    turn = sonar.mount.rotation_sonar_from_camera()
    camera_from_sonar = np.column_stack([turn.T, sonar.mount.position_camera_m()])
    world_from_sonar = pose[:3, :3] @ camera_from_sonar
    world_from_sonar[:, 3] += pose[:3, 3]
    return GhostScatterers(
        bins=bins[:, chosen].reshape(-1),
        powers=np.tile(powers[chosen], 2).astype(np.float32),
        image_m=np.tile(paths.image_m[chosen], (2, 1)),
        second_m=np.tile(paths.second_m[chosen], (2, 1)),
        direction=np.repeat([0, 1], len(chosen)),
        world_from_sonar=world_from_sonar,
    )


def polar_bins(sonar_m: Float64s, window: Window, sonar: SonarSettings) -> Int32s:
    """(N,) int32 flat polar bins of (3, N) places in sonar axes; -1 outside the window."""
    ahead_m, left_m, up_m = sonar_m
    ground_squared = ahead_m * ahead_m + left_m * left_m
    range_m = np.sqrt(ground_squared + up_m * up_m)
    distance_m = np.sqrt(ground_squared) if window.projection == "top_view" else range_m
    bins_per_m = sonar.range_bins / window.range_span_m
    row = np.floor((distance_m - window.range_min_m) * bins_per_m)
    beam_edges, _ = beam_table(sonar)
    beam = np.searchsorted(beam_edges, -left_m / range_m, side="right") - 1

    in_rows = (row >= 0) & (row < sonar.range_bins)
    in_beams = (beam >= 0) & (beam < sonar.beams)
    is_inside = (ahead_m > 0) & in_rows & in_beams
    bins = np.full(len(range_m), -1, np.int32)
    bins[is_inside] = row[is_inside].astype(np.int32) * sonar.beams + beam[is_inside]
    return bins


class CameraRays(NamedTuple):
    """Where the pixels of a frame lie in camera axes; the compiled loops take it as a plain tuple.

    depth_m: (H, W) float32, z.  across: (W,) float32, x / z of the columns.
    down: (H,) float32, y / z of the rows.
    """

    depth_m: Float32s
    across: Float32s
    down: Float32s


def camera_rays(frame: Frame) -> CameraRays:
    """Depth of each pixel, and directions of columns and rows."""
    across, down = frame.intrinsics.directions(*frame.depth_m.shape)
    return CameraRays(frame.depth_m, across.astype(np.float32), down.astype(np.float32))


def grid_of(window: Window, sonar: SonarSettings) -> tuple[Any, ...]:
    """The polar bins as `kernels` want them."""
    edges, first_beam = beam_table(sonar)
    return (
        window.projection == "top_view", window.range_min_m,
        sonar.range_bins / window.range_span_m, sonar.range_bins, edges, first_beam,
        _BEAM_STEPS / float(edges[-1] - edges[0]),
    )  # fmt: skip


def _factor(surface: LitSurface, exponents: Float64s) -> Float32s:
    """(H, W): what the render lacks for other exponents than 2 or a sonar elsewhere, or (0, 0)."""
    frame = surface.frame
    mount = surface.sonar.mount
    if (exponents == 2).all() and mount.colocated:
        return np.empty((0, 0), np.float32)
    if frame.segmentation is None or (exponents == exponents[0]).all():
        return mount_weight(frame, mount, float(exponents[0]))
    return mount_weight(frame, mount, exponents[frame.segmentation])


@lru_cache(maxsize=8)
def beam_table(sonar: SonarSettings) -> tuple[Float32s, Int32s]:
    """Sines of the beams' edges, and the beam at each of equal steps of the sine."""
    centres = sonar.beam_centres_rad()
    half = min(np.deg2rad(sonar.hfov_deg) / 2, np.deg2rad(89.9))
    between = (centres[1:] + centres[:-1]) / 2
    edges = np.sin(np.concatenate([[-half], between, [half]])).astype(np.float32)
    steps = np.linspace(edges[0], edges[-1], _BEAM_STEPS + 1)[:-1]
    # One step back, for float32 may put a sine into the step before its own.
    first = np.searchsorted(edges, steps - (steps[1] - steps[0]), side="right") - 1
    return edges, np.clip(first, 0, sonar.beams - 1).astype(np.int32)


def bin_centres_m(window: Window, sonar: SonarSettings) -> Float32s:
    """(range_bins,) centres of the range bins, metres."""
    fraction = (np.arange(sonar.range_bins) + 0.5) / sonar.range_bins
    return np.asarray(window.range_min_m + fraction * window.range_span_m, np.float32)
