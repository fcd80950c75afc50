"""The ground: swells, slopes, rock outcrops, canyon walls, ripples, and relief down to centimetres.

The surface is a pure function of (x, y).  Each view samples it finely where the camera looks
(`view_mesh`), so every view of a spot shows the same ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .fields import (
    Arrays,
    Floats,
    Waves,
    smoothstep,
    tiles,
)

FAR_M = 36.0  # the ground ends here; water hides it long before


@dataclass(frozen=True, eq=False)
class Banks:
    """Rock walls on one or both sides of a winding axis through the origin.

    heading_rad: direction of the axis.  half_width_m: from the axis to the foot of the walls.
    sides: of +1 (left of the axis) and -1.  profile: (K, 2) distance behind the foot and height, m.
    """

    heading_rad: float
    half_width_m: float
    sides: tuple[int, ...]
    profile: npt.NDArray[np.float64]
    winding: Waves
    winding_m: float
    ragged: Waves
    ragged_m: float

    def axis_offset_m(self, along_m: Arrays) -> Floats:
        """How far the winding axis is to the left of a straight line, at distances along it."""
        zero = np.zeros_like(along_m)
        return np.asarray(self.winding_m * (self.winding(along_m, zero) - self.winding(*_ZERO)))

    def behind_foot_m(self, x: Arrays, y: Arrays) -> Floats:
        """Distance behind the foot of the nearest wall, negative in front of it."""
        c, s = np.float32(np.cos(self.heading_rad)), np.float32(np.sin(self.heading_rad))
        along, across = c * x + s * y, -s * x + c * y
        across = across - self.axis_offset_m(along)
        ragged = np.float32(self.ragged_m) * self.ragged(x, y)
        behind = np.full_like(across, -np.inf)
        for side in self.sides:
            behind = np.maximum(behind, side * across - self.half_width_m + ragged)
        return behind


_ZERO = (np.zeros(1, dtype=np.float32), np.zeros(1, dtype=np.float32))


@dataclass(frozen=True, eq=False)
class Terrain:
    """A ground of one location.  Heights and lengths in metres; slope is dz/dx, dz/dy.

    outcrop_cover: share of the ground that is bare rock.  gravel_cover: of the rest, gravel.
    offset_m: where this ground lies on the noise pictures.
    """

    slope: tuple[float, float]
    swell: Waves
    swell_m: float
    outcrop: Waves
    outcrop_cover: float
    outcrop_m: float
    gravel: Waves
    gravel_cover: float
    ripples: Ripples | None
    banks: Banks | None
    rock_relief_m: float
    sand_relief_m: float
    offset_m: tuple[float, float]

    def height_m(self, x: Arrays, y: Arrays) -> Floats:
        """(...) float32 height without the fine relief."""
        x, y = np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)
        behind = None if self.banks is None else self.banks.behind_foot_m(x, y)
        return self._height_m(x, y, self.outcrop(x, y), behind)

    @property
    def _level(self) -> float:
        # Quantiles of a unit normal field, near enough for a share of the ground.
        return 1.6 * (0.5 - self.outcrop_cover) * 2

    def _height_m(self, x: Floats, y: Floats, outcrop: Floats, behind: Floats | None) -> Floats:
        height = np.float32(self.slope[0]) * x + np.float32(self.slope[1]) * y
        height = height + np.float32(self.swell_m) * self.swell(x, y)
        level = self._level
        ledge = smoothstep(level - 0.25, level + 0.5, outcrop)
        height += np.float32(self.outcrop_m) * ledge * (1 + 0.35 * np.clip(outcrop - level, 0, 2))
        if self.banks is not None and behind is not None:
            profile = self.banks.profile
            height += np.interp(behind, profile[:, 0], profile[:, 1]).astype(np.float32)
        return np.asarray(height, dtype=np.float32)

    def _rockiness(self, outcrop: Floats, behind: Floats | None) -> Floats:
        """0 on loose ground, 1 on rock."""
        rock = smoothstep(self._level - 0.15, self._level + 0.25, outcrop)
        return rock if behind is None else np.maximum(rock, smoothstep(-0.15, 0.2, behind))

    def surface(self, x: Arrays, y: Arrays) -> tuple[Floats, Floats]:
        """Points of the ground with all relief, for a (R, C) grid of parameters.

        Returns (R, C, 3) positions, and (R, C, 3) attributes: rockiness, gravel share, relief (in
        units of its standard deviation, negative in crevices).
        """
        from .kernels import relieve

        x, y = np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32)
        outcrop = self.outcrop(x, y)
        behind = None if self.banks is None else self.banks.behind_foot_m(x, y)
        rock = self._rockiness(outcrop, behind)
        level = 1.6 * (0.5 - self.gravel_cover) * 2
        gravel = smoothstep(level - 0.3, level + 0.3, self.gravel(x, y)) * (1 - rock)
        points = np.stack([x, y, self._height_m(x, y, outcrop, behind)], axis=-1)
        crest = np.zeros_like(rock)
        if self.ripples is not None:
            crest = self.ripples.height(x, y) * (1 - rock) * (1 - 0.8 * gravel)
        heights = (
            self.rock_relief_m,
            self.sand_relief_m,
            0.0 if self.ripples is None else self.ripples.amplitude_m,
        )
        noise, attributes = tiles(), np.empty_like(points)
        relieve(
            points, grid_normals(points), (rock, gravel, crest), (noise.rock, noise.sand),
            np.array(self.offset_m, dtype=np.float32), np.array(heights, dtype=np.float32),
            attributes,
        )  # fmt: skip
        return points, attributes


@dataclass(frozen=True, eq=False)
class Ripples:
    """Sand ripples with sharp crests and broad troughs, in patches."""

    wavelength_m: float
    amplitude_m: float
    heading_rad: float
    bend: Waves
    bend_rad: float
    patches: Waves
    cover: float

    def height(self, x: Floats, y: Floats) -> Floats:
        """From -1 (trough) to 1 (crest), 0 outside the patches."""
        rate = 2 * np.pi / self.wavelength_m
        phase = np.float32(rate * np.cos(self.heading_rad)) * x
        phase = phase + np.float32(rate * np.sin(self.heading_rad)) * y
        phase += np.float32(self.bend_rad) * self.bend(x, y)
        crest = 1 - 2 * np.sqrt(0.02 + 0.98 * np.sin(phase / 2) ** 2)
        level = 1.6 * (0.5 - self.cover) * 2
        return np.asarray(crest * smoothstep(level - 0.4, level + 0.4, self.patches(x, y)))


def grid_normals(points: Floats) -> Floats:
    """(R, C, 3) unit normals of a (R, C, 3) grid of points, turned upward."""
    from .kernels import normals_of_grid

    normals = np.empty_like(points)
    normals_of_grid(points, normals)
    return normals


@dataclass(frozen=True, eq=False)
class GroundMesh:
    """points, normals: (R, C, 3) float32.  attributes: (R, C, 3), see `Terrain.surface`."""

    points: Floats
    normals: Floats
    attributes: Floats


def view_mesh(
    terrain: Terrain,
    eye: npt.NDArray[np.float64],
    azimuths_rad: tuple[float, float],
    elevations_rad: tuple[float, float],
    shape: tuple[int, int],
) -> GroundMesh:
    """A fan of ground under a camera at `eye`, as fine in each direction as the camera sees it.

    azimuths_rad, elevations_rad: what the camera sees, world directions.  shape: rows (outward) and
    columns (across) of the grid.
    """
    rows, columns = shape
    coarse = max(columns // 4, 8)
    ranges = np.geomspace(0.15, FAR_M, 160)
    headings = np.linspace(*azimuths_rad, coarse)
    grid_r, grid_a = np.meshgrid(ranges, headings, indexing="ij")
    heights = terrain.height_m(eye[0] + grid_r * np.cos(grid_a), eye[1] + grid_r * np.sin(grid_a))
    # Rows are dealt out by the angle that each stretch of ground fills in the view, hidden or not.
    seen = np.clip(np.arctan2(heights - eye[2], grid_r), *elevations_rad)
    angle = np.abs(np.diff(seen, axis=0))
    share = 0.72 * angle / np.maximum(angle.sum(axis=0), 1e-6) + 0.28 / (len(ranges) - 1)
    # Neighbouring columns get nearly the same rows: a sheared grid has bad normals.
    share = _mean_along(_mean_along(share, coarse // 2 | 1, 1), 5, 0)
    share /= share.sum(axis=0)
    reached = np.concatenate([np.zeros((1, coarse)), np.cumsum(share, axis=0)])
    even = np.linspace(0, 1, rows)
    log_r = np.stack(
        [np.interp(even, reached[:, k], np.log(ranges)) for k in range(coarse)], axis=-1
    )
    between = np.clip((np.arange(columns) + 0.5) * coarse / columns - 0.5, 0, coarse - 1)
    low = np.minimum(between.astype(np.int64), coarse - 2)
    radius = np.exp(log_r[:, low] + (between - low) * (log_r[:, low + 1] - log_r[:, low]))
    heading = np.linspace(*azimuths_rad, columns)
    points, attributes = terrain.surface(
        eye[0] + radius * np.cos(heading), eye[1] + radius * np.sin(heading)
    )
    return GroundMesh(points, grid_normals(points), attributes)


def _mean_along(values: npt.NDArray[np.float64], width: int, axis: int) -> npt.NDArray[np.float64]:
    """Mean over `width` (odd) neighbours along an axis, the border repeated."""
    sides = [(0, 0), (0, 0)]
    sides[axis] = (width // 2 + 1, width // 2)
    total = np.cumsum(np.pad(values, sides, mode="edge"), axis=axis)
    count = values.shape[axis]
    low = np.take(total, np.arange(count), axis=axis)
    return np.asarray((np.take(total, np.arange(count) + width, axis=axis) - low) / width)
