"""The camera of procedural frames: FLSea's field of view, or as wide as a sonar's sector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...frame import Intrinsics

FOCAL_PER_WIDTH = 1168.0 / 968.0
"""Of the FLSea camera, which sees 45 degrees across."""
HFOV_DEG, VFOV_DEG = 45.0, 29.2
"""What it sees at 968x608 pixels."""
_MARGIN_DEG = 1.0  # beyond each edge of a sonar's sector


@dataclass(frozen=True)
class Optics:
    """A pinhole camera without distortion, the principal point in the middle.

    across: how many times wider than the FLSea camera's its view is, in angle.
    """

    intrinsics: Intrinsics
    width: int
    height: int
    across: float


def camera(
    width: int, height: int, hfov_deg: float | None = None, vfov_deg: float | None = None
) -> Optics:
    """The camera whose pictures are width x height pixels when it sees what FLSea's camera sees.

    hfov_deg, vfov_deg: the sector to see instead, elevation |e| <= vfov_deg / 2 at every azimuth
    |a| <= hfov_deg / 2.  A flat picture of it needs tan(e) / cos(a) upwards, so it shows more in
    its corners; pixels are spread so thin that their number grows as the sector's solid angle,
    2 hfov sin(vfov / 2), and no faster.
    """
    if hfov_deg is None or vfov_deg is None:
        focal = FOCAL_PER_WIDTH * width
        return Optics(_centred(focal, width, height), width, height, 1.0)
    azimuth = np.deg2rad(hfov_deg / 2 + _MARGIN_DEG)
    elevation = np.deg2rad(vfov_deg / 2 + _MARGIN_DEG)
    half_width = np.tan(azimuth)
    half_height = np.tan(elevation) / np.cos(azimuth)
    pixels = width * height * _solid_angle(hfov_deg, vfov_deg) / _solid_angle(HFOV_DEG, VFOV_DEG)
    focal = float(np.sqrt(pixels / (4 * half_width * half_height)))
    columns, rows = (int(np.ceil(2 * half * focal)) for half in (half_width, half_height))
    return Optics(_centred(focal, columns, rows), columns, rows, hfov_deg / HFOV_DEG)


def _centred(focal: float, width: int, height: int) -> Intrinsics:
    return Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2)


def _solid_angle(hfov_deg: float, vfov_deg: float) -> float:
    return float(2 * np.deg2rad(hfov_deg) * np.sin(np.deg2rad(vfov_deg / 2)))
