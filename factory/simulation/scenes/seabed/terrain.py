"""Kinds of places: their ground, a function of (x, y), its random fields, colours and water.

`Waves` give the shape of the ground (smooth, exact at every point, so two views of one spot agree);
`tiles` give fine relief and colour, looked up as fast as an image can be resampled.  Each view
samples the ground finely where the camera looks (`seen_from`).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from ....common.array_types import Colour, Draws, Float32s, Float64s, Floats, Int32s
from ....common.seeds import stream
from ...meshes.camera import WORLD_SEED
from ...meshes.waves import Waves
from ..moving import FARTHEST_M

Range = tuple[float, float]
Place = Mapping[str, Any]  # a kind of place, as `places.yaml` describes it

TILE = 1024  # pixels a side of every noise image

# The order is the order in which locations 0, 1, 2, ... take them.
PlaceName = Literal[
    "debris", "canyon", "reef", "pier", "pipeline", "rubble", "quay", "sand", "garden", "wall"
]

PLACE_NAMES: tuple[PlaceName, ...] = get_args(PlaceName)
"""Places that datasets take in turn where the user names none."""

ObjectPlaceName = Literal["tank", "harbour", "flat_sand", "mud"]
"""Flat places where objects are looked for; those that the user names alone."""

FITTED_PLACES: frozenset[str] = frozenset({"tank", "harbour"})
"""Places with fittings: things that belong there and are no objects to be found."""


@functools.cache
def catalogue() -> dict[str, Any]:
    """The content of `places.yaml`."""
    import yaml

    text = Path(__file__).with_name("places.yaml").read_text("utf-8")
    document: dict[str, Any] = yaml.safe_load(text)
    return document


def pick(rng: Draws, colours: Sequence[Colour], shades: Range = (0.75, 1.2)) -> Float64s:
    """One of the colours, a little lighter or darker."""
    return np.array(colours[int(rng.integers(len(colours)))]) * rng.uniform(*shades)


def smoothstep(low: float | Floats, high: float | Floats, x: Floats) -> Float32s:
    """0 below `low`, 1 above `high`, a smooth ramp between."""
    t = np.clip((x - low) / (high - low), 0, 1).astype(np.float32)
    return t * t * (3 - 2 * t)


class NoiseTiles(NamedTuple):
    """Noise for images and reliefs.

    texture: (TILE / 2, TILE / 2) of four channels of 8 bits, the first the lowest: broad clouds,
        fine grain, cells (dark seams between lumps), speckle, in steps of 1 / STEPS.  An image
        looks up a million places in it, so the channels lie side by side.
    rock_relief, sand_relief: (TILE, TILE).
    """

    texture: Int32s
    rock_relief: Float32s
    sand_relief: Float32s


@functools.cache
def tiles() -> NoiseTiles:
    """Noise images that repeat without a seam, each with mean 0 and standard deviation 1.

    Every location uses them at its own offset.
    """
    from .kernels import STEPS

    rng = stream(WORLD_SEED, "seabed", "tiles")
    broad = _fractal(rng, 2, 64, 1.3)
    grain = _fractal(rng, 24, 400, 0.5)
    cells = _cells(rng, 26)
    speckle = _fractal(rng, 60, 500, 0.0)
    ridged = _unit(-np.abs(_fractal(rng, 3, 80, 1.0)))
    rock = _unit(ridged + 0.6 * _fractal(rng, 3, 160, 0.9) + 0.35 * _cells(rng, 22))
    sand = _unit(_fractal(rng, 6, 120, 0.9))
    channels = np.stack([broad, grain, cells, speckle], axis=-1)[::2, ::2]
    steps = np.clip(np.rint(channels * STEPS), -127, 127).astype(np.int8)
    return NoiseTiles(steps.view("<i4")[..., 0], rock, sand)


def _fractal(rng: Draws, fewest_cycles: float, most_cycles: float, roughness: float) -> Float32s:
    """Periodic spectral noise whose amplitude goes as frequency ** -(1 + roughness)."""
    frequency = np.hypot(np.fft.fftfreq(TILE)[:, None], np.fft.rfftfreq(TILE)[None]) * TILE
    band = (frequency >= fewest_cycles) & (frequency <= most_cycles)
    gain = np.where(band, np.maximum(frequency, 1) ** -(1 + roughness), 0)
    white = np.fft.rfft2(rng.standard_normal((TILE, TILE), dtype=np.float32))
    return _unit(np.fft.irfft2(white * gain, s=(TILE, TILE)))


def _cells(rng: Draws, across: int) -> Float32s:
    """Periodic lumps: how much nearer the nearest of across x across scattered points is."""
    side = TILE // 2
    scattered = rng.random((across, across, 2), dtype=np.float32)  # one in each square of a grid
    at = (np.arange(side, dtype=np.float32) + np.float32(0.5)) * np.float32(across / side)
    own = at.astype(np.int64)
    first, second = (np.full((side, side), np.inf, np.float32) for _ in range(2))
    for down, right in itertools.product(range(-2, 3), repeat=2):
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


def _unit(field: Floats) -> Float32s:
    return np.asarray((field - field.mean()) / field.std(), dtype=np.float32)


class Banks:
    """Rock walls on one or both sides of a winding axis through the origin.

    profile: (K, 2) distance behind the foot and height, m.
    """

    def __init__(self, rng: Draws, place: Place, heading_rad: float) -> None:
        self._turn = np.float32(np.cos(heading_rad)), np.float32(np.sin(heading_rad))
        self._sides = place["sides"]
        self._half_width_m, height = (rng.uniform(*span) for span in place["banks"])
        # Ledges: steep faces and narrow steps take turns up the wall.
        faces = int(rng.integers(2, 5))
        knots = [(-1.2, 0.0), (0.0, 0.22)]
        behind = 0.0
        level = 0.22
        for step in rng.dirichlet(np.full(faces, 3.0)) * height:
            behind = behind + step * rng.uniform(0.12, 0.4)
            level = level + float(step)
            knots.append((behind, level))
            behind = behind + rng.uniform(0.15, 0.7)
            level = level + rng.uniform(0.03, 0.15)
            knots.append((behind, level))
        knots += [(behind + 6, level + rng.uniform(0.3, 1.5)), (behind + 40, level + 2.5)]
        sharp = np.array(knots)
        fine = np.arange(-1.6, behind + 12, 0.04)
        padded = np.pad(np.interp(fine, *sharp.T), 4, mode="edge")
        rounded = np.column_stack([fine, np.convolve(padded, np.ones(9) / 9, "valid")])
        self.profile = np.concatenate([rounded, sharp[-1:]])
        self._winding = Waves(rng, 26.0, 9.0, 1.2)
        self._winding_m = rng.uniform(0.3, 1.2)
        self._ragged = Waves(rng, 3.5, 0.5, 0.9)
        self._ragged_m = rng.uniform(0.15, 0.26)

    def axis_offset_m(self, along_m: Floats) -> Float32s:
        """How far the winding axis is to the left of a straight line, at distances along it."""
        winding = self._winding(along_m, np.zeros_like(along_m)) - self._winding([0], [0])
        return np.asarray(self._winding_m * winding)

    def behind_foot_m(self, x: Floats, y: Floats) -> Float32s:
        """Distance behind the foot of the nearest wall, negative in front of it."""
        c, s = self._turn
        along = c * x + s * y
        across = -s * x + c * y
        across = across - self.axis_offset_m(along)
        ragged = np.float32(self._ragged_m) * self._ragged(x, y)
        behind = np.full_like(across, -np.inf)
        for side in self._sides:
            behind = np.maximum(behind, side * across - self._half_width_m + ragged)
        return behind


class Ripples:
    """Sand ripples with sharp crests and broad troughs, in patches."""

    def __init__(self, rng: Draws, cover: Range) -> None:
        wavelength = rng.uniform(0.14, 0.55)
        self.amplitude_m = wavelength * rng.uniform(0.045, 0.085)
        rate = 2 * np.pi / wavelength
        heading = rng.uniform(0, 2 * np.pi)
        self._rates = np.float32(rate * np.cos(heading)), np.float32(rate * np.sin(heading))
        self._bend = Waves(rng, 7.0, 0.8, 0.9)
        self._bend_rad = rng.uniform(1.2, 2.6)
        self._patches = Waves(rng, 8.0, 1.5, 0.8)
        self._level = _level(rng.uniform(*cover))

    def height(self, x: Float32s, y: Float32s) -> Float32s:
        """Relative height from -1 (trough) to 1 (crest), 0 outside the patches."""
        phase = self._rates[0] * x + self._rates[1] * y
        phase += np.float32(self._bend_rad) * self._bend(x, y)
        crest = 1 - 2 * np.sqrt(0.02 + 0.98 * np.sin(phase / 2) ** 2)
        patches = smoothstep(self._level - 0.4, self._level + 0.4, self._patches(x, y))
        return np.asarray(crest * patches)


def _level(cover: float) -> float:
    """Level that about a share `cover` of a standard normal field exceeds."""
    return 1.6 * (0.5 - cover) * 2


class Ground(NamedTuple):
    """A grid of ground, (R, C, 3) float32 each.

    points: positions with all relief.  attributes: rockiness, gravel share, and relief in units of
    its standard deviation, negative in crevices.
    """

    points: Float32s
    normals: Float32s
    attributes: Float32s


class Terrain:
    """A ground of one location, of a kind of place; `heading_rad` is the direction of its walls.

    banks: None where there are no walls.  offset_m: where it lies on the noise images.
    """

    def __init__(self, rng: Draws, place: Place, heading_rad: float) -> None:
        slope = np.tan(np.deg2rad(rng.uniform(*place["slope_deg"])))
        downhill = rng.uniform(0, 2 * np.pi)
        self._slope = np.float32(slope * np.cos(downhill)), np.float32(slope * np.sin(downhill))
        self._swell = Waves(rng, rng.uniform(9, 20), 1.0, 1.2)
        self._swell_m = rng.uniform(*place["swell_m"])
        self._outcrop = Waves(rng, rng.uniform(4, 9), 0.7, 0.9)
        self._bare = _level(rng.uniform(*place["outcrop_cover"]))
        self._outcrop_m = rng.uniform(*place["outcrop_m"])
        self._gravel = Waves(rng, 6.0, 0.5, 0.8)
        self._stony = _level(rng.uniform(*place["gravel_cover"]))
        rippled = rng.random() < place["ripples"]
        self._ripples = Ripples(rng, place["ripple_cover"]) if rippled else None
        self.banks = Banks(rng, place, heading_rad) if place["banks"] else None
        rock_m = rng.uniform(0.05, 0.11)
        sand_m = rng.uniform(0.006, 0.016)
        self.offset_m = np.array([rng.uniform(0, 50), rng.uniform(0, 50)], dtype=np.float32)
        relief = rng.uniform(*place["relief"])
        self._relief_m = rock_m * relief, sand_m * relief

    def height_m(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Float32s:
        """(...) float32 height without the fine relief."""
        return self._shape(np.asarray(x, dtype=np.float32), np.asarray(y, dtype=np.float32))[0]

    def _shape(self, x: Float32s, y: Float32s) -> tuple[Float32s, Float32s]:
        """Height without the fine relief, and rockiness: 0 on loose ground, 1 on rock."""
        outcrop = self._outcrop(x, y)
        level = self._bare
        height = self._slope[0] * x + self._slope[1] * y
        height = height + np.float32(self._swell_m) * self._swell(x, y)
        ledge = smoothstep(level - 0.25, level + 0.5, outcrop)
        height += np.float32(self._outcrop_m) * ledge * (1 + 0.35 * np.clip(outcrop - level, 0, 2))
        rock = smoothstep(level - 0.15, level + 0.25, outcrop)
        if self.banks is not None:
            behind = self.banks.behind_foot_m(x, y)
            height += np.interp(behind, *self.banks.profile.T).astype(np.float32)
            rock = np.maximum(rock, smoothstep(-0.15, 0.2, behind))
        return np.asarray(height, dtype=np.float32), rock

    def seen_from(
        self, eye: Float64s, azimuths_rad: Range, elevations_rad: Range, shape: tuple[int, int]
    ) -> Ground:
        """A fan of ground under a camera at `eye`, as fine in each direction as the camera sees it.

        azimuths_rad, elevations_rad: field of view in world directions.  shape: rows (outward) and
        columns (across) of the grid.
        """
        radius = self._view_radii(eye, azimuths_rad, elevations_rad, shape)
        heading = np.linspace(*azimuths_rad, shape[1])
        x = eye[0] + radius * np.cos(heading)
        y = eye[1] + radius * np.sin(heading)
        return self._surface(x.astype(np.float32), y.astype(np.float32))

    def _view_radii(
        self, eye: Float64s, azimuths_rad: Range, elevations_rad: Range, shape: tuple[int, int]
    ) -> Float64s:
        """(R, C) level distances from the eye, close together where the view shows much ground.

        They are computed for a quarter of the columns and interpolated between these.
        """
        rows, columns = shape
        coarse = max(columns // 4, 8)
        ranges = np.geomspace(0.15, FARTHEST_M, 160)
        headings = np.linspace(*azimuths_rad, coarse)
        grid_r, grid_a = np.meshgrid(ranges, headings, indexing="ij")
        heights = self.height_m(eye[0] + grid_r * np.cos(grid_a), eye[1] + grid_r * np.sin(grid_a))
        # Rows are dealt out by the angle that a stretch of ground fills in the view, hidden or not.
        elevation_rad = np.clip(np.arctan2(heights - eye[2], grid_r), *elevations_rad)
        angle = np.abs(np.diff(elevation_rad, axis=0))
        share = 0.72 * angle / np.maximum(angle.sum(axis=0), 1e-6) + 0.28 / (len(ranges) - 1)
        # Neighbouring columns get nearly the same rows: a sheared grid has bad normals.
        share = _mean_down(_mean_down(share.T, coarse // 2 | 1).T, 5)
        share /= share.sum(axis=0)
        reached = np.concatenate([np.zeros((1, coarse)), np.cumsum(share, axis=0)])
        even = np.linspace(0, 1, rows)
        log_r = np.stack(
            [np.interp(even, share_of_ray, np.log(ranges)) for share_of_ray in reached.T], axis=-1
        )
        between = np.clip((np.arange(columns) + 0.5) * coarse / columns - 0.5, 0, coarse - 1)
        low = np.minimum(between.astype(np.int64), coarse - 2)
        upper_share = between - low
        log_radius = log_r[:, low] + upper_share * (log_r[:, low + 1] - log_r[:, low])
        return np.asarray(np.exp(log_radius))

    def _surface(self, x: Float32s, y: Float32s) -> Ground:
        """The ground at (R, C) places."""
        from .kernels import add_relief, normals_of_grid

        height, rock = self._shape(x, y)
        gravel = smoothstep(self._stony - 0.3, self._stony + 0.3, self._gravel(x, y)) * (1 - rock)
        crest = np.zeros_like(rock)
        crest_m = 0.0
        if self._ripples is not None:
            crest = self._ripples.height(x, y) * (1 - rock) * (1 - 0.8 * gravel)
            crest_m = self._ripples.amplitude_m
        points = np.stack([x, y, height], axis=-1)
        shares = (rock, gravel, crest)
        heights = np.array([*self._relief_m, crest_m], dtype=np.float32)
        attributes = np.empty_like(points)
        normals = normals_of_grid(points)
        noise = tiles()
        relief = (noise.rock_relief, noise.sand_relief)
        add_relief(points, normals, shares, relief, self.offset_m, heights, attributes)
        return Ground(points, normals_of_grid(points), attributes)


def _mean_down(values: Float64s, width: int) -> Float64s:
    """Mean over `width` (odd) neighbours down each column, the border repeated."""
    padded = np.pad(values, ((width // 2 + 1, width // 2), (0, 0)), mode="edge")
    total = np.cumsum(padded, axis=0)
    return np.asarray((total[width:] - total[:-width]) / width)


class Look:
    """Colours, water and light of a location, of a kind of place.

    palette: (5, 3) float32 albedo of sand, gravel, rock, algae and crust, red, green, blue.
    turf: how much of the rock is overgrown, 0 to 1.
    water: (4, 3) float32 attenuation per metre, colour of open water, light from the sun's
    direction and from all above.  sun_direction: (3,) unit, from the ground to the sun.
    clear_m: beyond this range nothing has a depth.
    """

    def __init__(self, rng: Draws, place: Place) -> None:
        water = catalogue()["waters"][place["waters"][int(rng.integers(len(place["waters"])))]]
        self.clear_m = rng.uniform(*water["clear_m"])
        height = rng.uniform(0.72, 0.92)
        turn = rng.uniform(0, 2 * np.pi)
        flat = np.sqrt(1 - height**2)
        self.sun_direction = np.array([flat * np.cos(turn), flat * np.sin(turn), height])
        sun = rng.uniform(*water["sun"])
        fade = [1.15 / self.clear_m * share for share in water["fade"]]
        haze = [value * rng.uniform(0.85, 1.15) for value in water["haze"]]
        light = [sun * share for share in (0.62, 1.0, 0.92)]
        self.water = np.array([fade, haze, light, water["sky"]], np.float32)
        rock, sand, algae, crust = (
            pick(rng, catalogue()["colours"][name], (0.85, 1.15))
            for name in ("rock", "sand", "algae", "crust")
        )
        self.palette = np.array([sand, rock * (1.15, 1.12, 1.08), rock, algae, crust], np.float32)
        self.turf = rng.uniform(0.2, 0.8)
