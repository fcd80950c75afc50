"""Ghosts of one bounce as the sonar hears them.

Let r be the range of a surface and r' that of its mirror image.  The path that touches the mirror
once, on the way out or on the way back, is r + r' long: its echo arrives at range (r + r') / 2,
from the direction of the surface where the mirror was met on the way out, and from that of the
mirror image on the reverse path (image method: Allen & Berkley, J. Acoust. Soc. Am. 65 (1979),
943).  Levels: docs/physics.md, Ghosts between surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...common.array_types import Float64s, Int32s
from .polar import Echoes, from_xyz
from .surface import LitSurface, mount_weight


@dataclass(frozen=True, eq=False)
class GhostPaths:
    """N paths of one bounce; places in sonar axes (x forward, y left, z up), metres.

    image_m: (N, 3), mirror images of the second surfaces.  second_m: (N, 3), the second surfaces.
    radiance: (N,), that of a lit pixel of equal echo.
    solid_angle: (N,) of the path's bundle of rays, in those of the pixel in the image's middle.
    second_pixel: (N,) int32 flat camera pixel.  pixels_each: camera pixels in a bundle.
    """

    image_m: Float64s
    second_m: Float64s
    radiance: Float64s
    solid_angle: Float64s
    second_pixel: Int32s
    pixels_each: int

    def arrivals_m(self) -> tuple[Float64s, Float64s]:
        """(N, 3) each: where the echoes of the reverse paths and of the paths appear."""
        return arrivals_m(self.image_m, self.second_m)


def arrivals_m(image_m: Float64s, second_m: Float64s) -> tuple[Float64s, Float64s]:
    """(N, 3) each: at half the path, towards the mirror image and towards the surface."""
    image_range_m = lengths(image_m)
    second_range_m = lengths(second_m)
    range_m = (image_range_m + second_range_m) / 2
    return (
        image_m * (range_m / image_range_m)[:, None],
        second_m * (range_m / second_range_m)[:, None],
    )


def lengths(points_m: Float64s) -> Float64s:
    """(N,) distances of (N, 3) points from the origin, above 0."""
    x, y, z = points_m.T
    return np.asarray(np.maximum(np.sqrt(x * x + y * y + z * z), 1e-6))


def ghost_paths(surface: LitSurface) -> GhostPaths | None:
    """The paths of one bounce in a rendered frame; None where it has none."""
    bounces = surface.rendered.bounces
    if bounces is None or not len(bounces.mirror):
        return None
    frame = surface.frame
    mount = surface.sonar.mount
    width = frame.depth_m.shape[1]
    across, down = frame.intrinsics.directions(*frame.depth_m.shape)
    depth_m = frame.depth_m.reshape(-1).astype(np.float64)

    def place_m(pixel: Int32s) -> Float64s:
        row, column = np.divmod(pixel, width)
        ray = np.stack([across[column], down[row], np.ones(len(pixel))], axis=-1)
        return mount.in_sonar_axes(ray * depth_m[pixel][:, None])

    mirror_m = place_m(bounces.mirror)
    mirror_range_m = lengths(mirror_m)
    image_range_m = mirror_range_m + bounces.distance_m
    reflected = 10 ** (-bounces.reflection_loss_db / 10)
    radiance = reflected * surface.rendered.radiance.reshape(-1)[bounces.second].astype(np.float64)
    if not mount.colocated:
        # What the sonar sees of the mirror's pixel, over what the camera sees of it.
        radiance *= mount_weight(frame, mount, 2).reshape(-1)[bounces.mirror]
    mirror_row, mirror_column = np.divmod(bounces.mirror, width)
    oblique = 1 + across[mirror_column] ** 2 + down[mirror_row] ** 2
    return GhostPaths(
        image_m=mirror_m * (image_range_m / mirror_range_m)[:, None],
        second_m=place_m(bounces.second),
        radiance=radiance,
        solid_angle=bounces.pixels_each / (oblique * np.sqrt(oblique)),
        second_pixel=bounces.second,
        pixels_each=bounces.pixels_each,
    )


def ghost_echoes(surface: LitSurface) -> Echoes | None:
    """The echoes of both directions of each path, one for each camera pixel that it stands for.

    Strengths are those of `insonified`, with time-varying gain.  None where there are none.
    """
    paths = ghost_paths(surface)
    if paths is None:
        return None
    sonar = surface.sonar
    half_hfov_rad, half_vfov_rad = np.deg2rad([sonar.hfov_deg, sonar.vfov_deg]) / 2
    echoes = [from_xyz(points_m, paths.radiance) for points_m in paths.arrivals_m()]
    # The sonar sends and hears in its sector alone.
    is_inside = np.ones(len(paths.radiance), np.bool_)
    for direction in echoes:
        is_inside &= np.abs(direction.azimuth_rad) <= half_hfov_rad
        is_inside &= np.abs(direction.elevation_rad) <= half_vfov_rad
    chosen = np.repeat(np.flatnonzero(is_inside), paths.pixels_each)
    if not len(chosen):
        return None
    range_m, azimuth_rad, elevation_rad, strength = (
        np.concatenate([values[chosen] for values in directions])
        for directions in zip(*(vars(direction).values() for direction in echoes), strict=True)
    )
    gain = range_m ** np.float32(sonar.tvg_db_per_decade / 10)
    return Echoes(range_m, azimuth_rad, elevation_rad, strength * gain)
