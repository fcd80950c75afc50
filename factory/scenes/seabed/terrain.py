"""The ground, a pure function of (x, y), and the random fields that it is made of.

`Waves` give the shape of the ground (smooth, exact at every point, so two views of one spot agree);
`tiles` give fine relief and colour, looked up as fast as a picture can be resampled.  Each view
samples the ground finely where the camera looks (`view_mesh`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...seeds import stream

Floats = npt.NDArray[np.float32]
Arrays = npt.NDArray[np.floating[Any]]  # any precision

WORLD_SEED = 0  # the procedural world is one and the same; a location number is a place in it
TILE = 1024  # pixels a side of every noise picture


@dataclass(frozen=True, eq=False)
class Waves:
    """A sum of plane waves: a smooth random field with mean 0 and unit variance.

    vectors: (K, D) rad/m.  phases: (K,) rad.  amplitudes: (K,).
    """

    vectors: npt.NDArray[np.float64]
    phases: npt.NDArray[np.float64]
    amplitudes: npt.NDArray[np.float64]

    def __call__(self, *coordinates_m: Arrays) -> Floats:
        """The field at D coordinate arrays (metres, one shape), float32 of that shape."""
        # Reading a configuration imports this module; only making frames needs numba.
        from .kernels import add_waves

        first = np.asarray(coordinates_m[0])
        axes = np.stack([np.asarray(axis, dtype=np.float32).ravel() for axis in coordinates_m])
        total = np.zeros(first.size, dtype=np.float32)
        vectors, phases, amplitudes = self._singles
        add_waves(axes, vectors, phases, amplitudes, total)
        return total.reshape(first.shape)

    @functools.cached_property
    def _singles(self) -> tuple[Floats, Floats, Floats]:
        parts = (self.vectors, self.phases, self.amplitudes)
        vectors, phases, amplitudes = (np.ascontiguousarray(p, dtype=np.float32) for p in parts)
        return vectors, phases, amplitudes


def waves(
    rng: np.random.Generator,
    longest_m: float,
    shortest_m: float,
    roughness: float = 1.0,
    dimensions: int = 2,
    per_octave: int = 5,
) -> Waves:
    """Draw a fractal field with wavelengths from `longest_m` to `shortest_m`.

    roughness: amplitude goes as wavelength ** roughness (1 is a natural landscape, 0 is white).
    """
    octaves = max(np.log2(longest_m / shortest_m), 0.5)
    count = max(round(per_octave * octaves), 3)
    # One wave in each equal step of log wavelength, so that no octave is left out by chance.
    steps = (np.arange(count) + rng.random(count)) / count
    wavelengths = longest_m * (shortest_m / longest_m) ** steps
    directions = rng.standard_normal((count, dimensions))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    amplitudes = wavelengths**roughness
    amplitudes *= np.sqrt(2 / np.sum(amplitudes**2))
    vectors = directions * (2 * np.pi / wavelengths)[:, None]
    return Waves(vectors, rng.uniform(0, 2 * np.pi, count), amplitudes)


def smoothstep(low: float | Arrays, high: float | Arrays, x: Arrays) -> Floats:
    """0 below `low`, 1 above `high`, a smooth ramp between."""
    t = np.clip((x - low) / (high - low), 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


@dataclass(frozen=True, eq=False)
class Tiles:
    """Noise pictures, TILE pixels a side, that repeat without a seam; each channel has std 1.

    texture: (S / 2, S / 2) int32, four channels of 8 bits, the first the lowest: broad clouds,
    fine grain, cells (dark seams between lumps), speckle, in steps of 1 / STEPS: a picture looks up
    a million places all over it, which must be near, and all channels of one at once.
    rock, sand: (S, S) relief, mean 0.
    """

    texture: npt.NDArray[np.int32]
    rock: Floats
    sand: Floats


@functools.cache
def tiles() -> Tiles:
    """The noise pictures, drawn once a process; every location uses them at its own offset."""
    from .kernels import STEPS

    rng = stream(WORLD_SEED, "seabed", "tiles")
    broad, grain = _fractal(rng, 2, 64, 1.3), _fractal(rng, 24, 400, 0.5)
    cells, speckle = _cells(rng, 26), _fractal(rng, 60, 500, 0.0)
    ridged = _unit(-np.abs(_fractal(rng, 3, 80, 1.0)))
    rock = _unit(ridged + 0.6 * _fractal(rng, 3, 160, 0.9) + 0.35 * _cells(rng, 22))
    sand = _unit(_fractal(rng, 6, 120, 0.9))
    words = np.zeros((TILE // 2, TILE // 2), dtype=np.uint32)
    for k, channel in enumerate((broad, grain, cells, speckle)):
        steps = np.clip(np.rint(channel[::2, ::2] * STEPS), -127, 127).astype(np.int8)
        words |= steps.view(np.uint8).astype(np.uint32) << np.uint32(8 * k)
    return Tiles(words.view(np.int32), rock, sand)


def _fractal(
    rng: np.random.Generator, fewest_cycles: float, most_cycles: float, roughness: float
) -> Floats:
    """Periodic spectral noise whose amplitude goes as frequency ** -(1 + roughness)."""
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None]) * TILE
    band = (frequency >= fewest_cycles) & (frequency <= most_cycles)
    gain = np.where(band, np.maximum(frequency, 1) ** -(1 + roughness), 0)
    white = np.fft.rfft2(rng.standard_normal((TILE, TILE), dtype=np.float32))
    return _unit(np.fft.irfft2(white * gain, s=(TILE, TILE)))


def _cells(rng: np.random.Generator, across: int) -> Floats:
    """Periodic lumps: how much nearer the nearest of across x across scattered points is."""
    side = TILE // 2
    scattered = rng.random((across, across, 2), dtype=np.float32)  # one in each square of a grid
    at = (np.arange(side, dtype=np.float32) + np.float32(0.5)) * np.float32(across / side)
    own = at.astype(np.int64)
    first, second = (np.full((side, side), np.inf, np.float32) for _ in range(2))
    for down in (-2, -1, 0, 1, 2):
        for right in (-2, -1, 0, 1, 2):
            point = scattered[((own + down) % across)[:, None], (own + right) % across]
            dy = point[..., 0] + (own + down - at).astype(np.float32)[:, None]
            dx = point[..., 1] + (own + right - at).astype(np.float32)
            apart = dx * dx + dy * dy
            second = np.minimum(second, np.maximum(first, apart))
            first = np.minimum(first, apart)
    lumps = np.sqrt(second) - np.sqrt(first)
    for axis in (0, 1):  # twice as fine: each new value a quarter of a pixel from an old one
        sides = [0.75 * lumps + 0.25 * np.roll(lumps, turn, axis) for turn in (1, -1)]
        shape = (TILE, side) if axis == 0 else (TILE, TILE)
        lumps = np.stack(sides, axis=axis + 1).reshape(shape)
    return _unit(np.sqrt(np.maximum(lumps, 0)))


def _unit(field: Arrays) -> Floats:
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


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
        crest_m = 0.0 if self.ripples is None else self.ripples.amplitude_m
        heights = self.rock_relief_m, self.sand_relief_m, crest_m
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
    columns_of = (np.interp(even, column, np.log(ranges)) for column in reached.T)
    log_r = np.stack(list(columns_of), axis=-1)
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
