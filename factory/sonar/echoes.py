"""Echoes: the point cloud as the sonar measures it, in polar coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Echoes:
    """N echoes around the sonar (x forward, y left, z up).

    range_m: (N,) float32 slant range.
    azimuth_rad: (N,) float32, positive to the RIGHT, as a fan picture shows it.
    elevation_rad: (N,) float32, positive up.
    strength: (N,) float32 linear echo strength; 0 = a surface that the sound does not reach.
    """

    range_m: Floats
    azimuth_rad: Floats
    elevation_rad: Floats
    strength: Floats

    def __len__(self) -> int:
        return int(self.range_m.shape[0])

    def ground_range_m(self) -> Floats:
        """(N,) float32 horizontal distance: the range of an orthographic view from above."""
        return np.asarray(self.range_m * np.cos(self.elevation_rad), dtype=np.float32)

    def louder(self, factor: float) -> Echoes:
        """The same echoes, every strength times `factor`."""
        strength = self.strength * np.float32(factor)
        return Echoes(self.range_m, self.azimuth_rad, self.elevation_rad, strength)

    def xyz_m(self) -> npt.NDArray[np.float64]:
        """(N, 3) Cartesian coordinates in sonar axes, metres."""
        range_m = self.range_m.astype(np.float64)
        ground_m = range_m * np.cos(self.elevation_rad)
        return np.stack(
            [
                ground_m * np.cos(self.azimuth_rad),
                -ground_m * np.sin(self.azimuth_rad),
                range_m * np.sin(self.elevation_rad),
            ],
            axis=1,
        )


def from_xyz(points_m: npt.NDArray[np.floating], strength: npt.NDArray[np.floating]) -> Echoes:
    """Polar echoes from (N, 3) Cartesian points in sonar axes and their (N,) strengths."""
    x, y, z = np.asarray(points_m).reshape(-1, 3).T
    ground_m = np.hypot(x, y)
    return Echoes(
        np.hypot(ground_m, z).astype(np.float32),
        np.arctan2(-y, x).astype(np.float32),
        np.arctan2(z, ground_m).astype(np.float32),
        np.asarray(strength, dtype=np.float32).reshape(-1),
    )


def in_plane(
    range_m: npt.NDArray[np.floating],
    azimuth_rad: npt.NDArray[np.floating],
    strength: npt.NDArray[np.floating],
) -> Echoes:
    """Echoes at elevation 0: noise is placed in the picture, where elevation is lost anyway."""
    range_m = np.asarray(range_m, dtype=np.float32)
    return Echoes(
        range_m,
        np.asarray(azimuth_rad, dtype=np.float32),
        np.zeros_like(range_m),
        np.asarray(strength, dtype=np.float32),
    )


def join(*parts: Echoes) -> Echoes:
    """All echoes of all parts, in order."""
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Echoes(*(np.concatenate(column) for column in columns))
