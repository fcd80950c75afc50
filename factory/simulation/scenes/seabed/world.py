"""A location, built from its number: the camera's path, and objects clear of it and each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ....common.array_types import Draws, Float64s
from ....common.seeds import stream
from ....dataset.meaning import CLASSES, FITTING, class_names
from ...meshes.camera import WORLD_SEED, Objects
from ...meshes.triangle_mesh import Mesh, mesh, rotation
from ...meshes.waves import Waves
from . import detailed, furniture, things
from .terrain import Look, Place, Range, Terrain, catalogue


class Own(NamedTuple):
    """An object of the user's, as places get it.

    kind: its class.  per_place: least and most per place.  tilt_deg: likewise, from upright.
    burial: likewise, share of its height in the ground.
    """

    kind: str
    per_place: tuple[int, int]
    tilt_deg: Range
    burial: Range
    mesh: Mesh


_VIEWS = 10  # own objects lie before the first so many views of a path, where cameras pass
_AHEAD_M = 1.5
_TURN = 2 * np.pi

SAMPLES = 512
LOWEST_M = 0.75  # lowest camera above the ground below it
HIGHEST_M = 2.8  # highest


class Path:
    """Where the camera is and roughly where it looks at every distance along a loop.

    The loop surrounds the origin: an oval with lobes in the open, there and back between walls.
    points: (S, 2) metres, equally far apart.  tangents: (S, 2) unit.  length_m: once around.
    """

    def __init__(self, rng: Draws, place: Place, terrain: Terrain, heading_rad: float) -> None:
        self._terrain = terrain
        long, short = (rng.uniform(*span) for span in place["loop_m"])
        angle = np.linspace(0, 2 * np.pi, 4 * SAMPLES, endpoint=False)
        lobes = np.zeros_like(angle)
        if short >= 0.3 * long:
            for cycles in (2, 3):
                size = rng.uniform(0.05, 0.13)
                phase = rng.uniform(0, 2 * np.pi)
                lobes += size * np.sin(cycles * angle + phase)
        along = long * (1 + lobes) * np.cos(angle)
        across = short * (1 + lobes) * np.sin(angle)
        if terrain.banks is not None:
            across = across + terrain.banks.axis_offset_m(along)
        c = np.cos(heading_rad)
        s = np.sin(heading_rad)
        points = np.stack([c * along - s * across, s * along + c * across], axis=-1)
        steps = np.sqrt(((np.roll(points, -1, axis=0) - points) ** 2).sum(axis=1))
        travelled = np.append(0, np.cumsum(steps))
        self.length_m = float(travelled[-1])
        even = np.arange(SAMPLES) / SAMPLES * self.length_m
        closed = np.append(points, points[:1], axis=0)
        self.points = np.stack(
            [np.interp(even, travelled, coordinate) for coordinate in closed.T], axis=-1
        )
        ahead = 6  # the heading looks a little ahead, as a diver does
        self.tangents = _unit(np.roll(self.points, -ahead, 0) - np.roll(self.points, ahead, 0))

        # The floor is the highest ground within 0.7 m.
        dx, dy = np.meshgrid(*2 * [np.linspace(-0.7, 0.7, 5)])
        x = self.points[:, :1] + dx.ravel()
        y = self.points[:, 1:] + dy.ravel()
        highest = terrain.height_m(x, y).max(axis=1).astype(np.float64)
        window = 2 * int(0.8 / self.length_m * SAMPLES) + 1
        wrapped = np.pad(highest, window, mode="wrap")
        self._floor_m = np.convolve(wrapped, np.ones(window) / window, "same")[window:-window]
        self.start_m = rng.uniform(0, self.length_m)
        self.step_m = rng.uniform(1.5, 2.1)
        self._altitude_m = rng.uniform(*place["altitude_m"])
        self._altitude = Waves(rng, 60, 4, 0.8)
        self._pitch_deg = rng.uniform(*place["pitch_deg"])
        self._attitude = [Waves(rng, longest, 5, 0.7) for longest in (70, 80, 90)]
        # Added to the unit heading, it looks at a wall beside the loop.
        self._lean = place["look_across"] * np.array([-s, c])

    def at(self, distance_m: npt.ArrayLike) -> tuple[Float64s, Float64s]:
        """Positions and unit tangents, (..., 2) each, after distances (...) along the loop."""
        sample = (np.asarray(distance_m) / self.length_m) % 1 * SAMPLES
        low = sample.astype(np.int64) % SAMPLES
        high = (low + 1) % SAMPLES
        part = (sample - np.floor(sample))[..., None]
        point = self.points[low] * (1 - part) + self.points[high] * part
        return point, _unit(self.tangents[low] * (1 - part) + self.tangents[high] * part)

    def view(self, frame: int) -> CameraView:
        """Return where the camera is and looks in a frame, before the view is chosen."""
        travelled = self.start_m + self.step_m * frame
        (x, y), tangent = self.at(travelled)
        sample = (travelled / self.length_m) % 1 * SAMPLES
        floor = np.interp(
            sample, np.arange(SAMPLES + 1), np.append(self._floor_m, self._floor_m[0])
        )
        below = float(self._terrain.height_m([x], [y])[0])
        altitude = self._altitude_m + 0.25 * _wander(self._altitude, travelled)
        altitude = min(max(altitude, LOWEST_M), HIGHEST_M - 0.3)
        eye = np.array([x, y, min(floor + altitude, below + HIGHEST_M)])
        yaw, pitch, roll = (_wander(field, travelled) for field in self._attitude)
        heading = float(np.rad2deg(np.arctan2(*(tangent + self._lean)[::-1])))
        return CameraView(
            eye_m=eye,
            heading_deg=heading + 10 * yaw,
            pitch_deg=self._pitch_deg + 3 * pitch,
            roll_deg=3 * roll,
        )


class CameraView(NamedTuple):
    """A camera at (3,) `eye_m`.  heading: counter-clockwise from +x.  pitch: downwards."""

    eye_m: Float64s
    heading_deg: float
    pitch_deg: float
    roll_deg: float


def _wander(field: Waves, travelled_m: float) -> float:
    """A random value along the path that goes on with every lap, so that laps never repeat."""
    return float(np.clip(field([travelled_m], [0])[0], -2, 2))


def _unit(vectors: Float64s) -> Float64s:
    return np.asarray(vectors / np.sqrt((vectors**2).sum(axis=-1, keepdims=True)))


LOW_M = 0.42  # what is lower than this may lie under the camera's path
CLEAR_M = 0.75  # what is taller keeps this far from it
_LARGE_FIRST = ("Pipe", "Wall", "Frame", "Anchor", "Block", "Barrel", "Tire", "Boulder")


class SeabedWorld:
    """Location number `location`; it is a place of kind `places[location % len(places)]`.

    density: factor on how many things there are.  kinds: only these; None: all.  own: the user's
    objects, put there when all else lies there.  finishes: (N, 3) of each, see `places.yaml`.
    first_own: number in `objects.instances` from which on they are the user's own.
    classes: names of the classes, see `meaning.class_names`.
    """

    def __init__(
        self, location: int, places: Sequence[str], density: float,
        kinds: Iterable[str] | None, own: Sequence[Own] = (),
        classes: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        self.location = location
        place = catalogue()["places"][places[location % len(places)]]
        self._draws = partial(stream, WORLD_SEED, "seabed", location)
        ground, way, light = (self._draws(name) for name in ("ground", "path", "light"))
        heading = ground.uniform(0, _TURN)
        self.terrain = Terrain(ground, place, heading)
        self.path = Path(way, place, self.terrain, heading)
        self.look = Look(light, place)
        self._place = place
        self._heading_rad = heading
        self._items: list[tuple[Mesh, str | None]] = []  # and its class, None for a pebble (ground)
        self._taken: list[tuple[float, float, float]] = []  # x, y, radius
        self._stretch_m = (0.0, self.path.length_m)  # of the path, beside which things are put
        self._half_sides_m: tuple[float, float] | None = (
            None  # of a tank, along the axis and across
        )
        self._furnish(density, kinds)
        self.first_own = 1 + sum(kind not in (None, FITTING) for _, kind in self._items)
        self._place_own(own)
        if classes is None:
            classes = class_names(item.kind for item in own)
        # An empty mesh has no shape: one triangle far below the ground.
        items = self._items or [(mesh(np.eye(3) - [0, 0, 1e4], [[0, 1, 2]]), None)]
        labels = np.array([classes.index(kind) if kind else 0 for _, kind in items], np.uint8)
        numbered = np.array([kind not in (None, FITTING) for _, kind in items], np.bool_)
        self.objects = Objects([solid for solid, _ in items], labels, numbered)
        del self._items  # tens of megabytes
        known = catalogue()["finishes"]
        finishes = [known.get(kind or "Boulder", known["own"]) for _, kind in items]
        self.finishes = np.array(finishes, np.float32)

    def _furnish(self, density: float, allowed: Iterable[str] | None) -> None:
        """Build the place's structure, then scatter its objects, large kinds first."""
        names = set(CLASSES if allowed is None else allowed)
        draw_model = detailed.drawn_model if self._place["detailed"] else things.drawn_model
        place = self._place
        scatter = self._place["scatter"]
        if place["structure"] == "pier" and "Pillar" in names:
            self._build_pier(self._draws("structure"))
        if place["structure"] == "quay" and "Wall" in names:
            self._build_quay(self._draws("structure"))
        if place["structure"] == "tank":
            self._build_tank(self._draws("structure"), "Wall" if "Wall" in names else FITTING)
        for kind in dict.fromkeys((*_LARGE_FIRST, *scatter)):
            if kind in names and kind in scatter:
                rng = self._draws(kind)
                for _ in range(round(rng.uniform(*scatter[kind]) * density)):
                    if kind == "Wall":
                        self._lay_wall(rng)
                    elif kind in place["lines"]:
                        self._lay_line(rng, kind)
                    else:
                        self._put(rng, draw_model(rng, kind), kind)
        self._put_fittings(self._draws("fittings"))
        rng = self._draws("pebbles")
        self._lay_pebbles(rng, round(rng.uniform(*place["pebbles"]) * min(density, 1.0)))

    def _place_own(self, own: Sequence[Own]) -> None:
        """Put the user's objects beside the part of the path that views show."""
        first = self.path.start_m + _AHEAD_M
        self._stretch_m = first, first + _VIEWS * self.path.step_m
        for number, item in enumerate(own):
            rng = self._draws("own", number)
            least, most = item.per_place
            for _ in range(int(rng.integers(least, most + 1))):
                angle_rad = np.deg2rad(rng.uniform(*item.tilt_deg))
                toward_rad = rng.uniform(0, _TURN)
                turns_rad = (toward_rad, angle_rad, -toward_rad, rng.uniform(0, _TURN))
                turned = item.mesh.turned("zyzz", *turns_rad)
                self._put(rng, turned.standing(), item.kind, item.burial)

    def _put(self, rng: Draws, mesh: Mesh, kind: str, burial: Range = (0.02, 0.18)) -> None:
        """Put a thing at a free spot near the path, if any: it follows the slope and sinks in."""
        reach = float(np.sqrt((mesh.vertices[:, :2] ** 2).sum(axis=1).max()))
        spot = self._spot(rng, reach, float(mesh.vertices[:, 2].max()))
        if spot is None:
            return
        step = max(min(reach, 0.5), 0.08)
        cross = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * step + spot
        height, east, west, north, south = self.terrain.height_m(*cross.T).astype(np.float64)
        dx = (east - west) / (2 * step)
        dy = (north - south) / (2 * step)
        if kind not in catalogue()["upright"]:
            down = np.arctan(min(float(np.hypot(dx, dy)), 0.8))
            toward = np.arctan2(dy, dx)
            mesh = mesh.turned("zyz", toward, -down, -toward)
        sunk = float(np.ptp(mesh.vertices[:, 2])) * rng.uniform(*burial) + 0.01
        self._fix(mesh, kind, (*spot, height - sunk), 0.85 * reach)

    def _fix(
        self, mesh: Mesh, kind: str, at: Sequence[float] | Float64s, reach: float = 0.4
    ) -> None:
        self._items.append((mesh.moved(at), kind))
        self._taken.append((float(at[0]), float(at[1]), reach))

    def _lay_pebbles(self, rng: Draws, count: int) -> None:
        """Small stones, in heaps, of a few shapes used again and again."""
        heaps = self._near_path(rng, rng.uniform(-6, 6, max(count // 14, 1)))
        spots = heaps[rng.integers(len(heaps), size=count)]
        spots += rng.normal(0, 0.7, (count, 2))
        for (x, y), height in zip(spots, self.terrain.height_m(*spots.T), strict=True):
            turn = rng.uniform(0, _TURN)
            size = rng.uniform(0.6, 1.5)
            shape = things.model("Pebble", int(rng.integers(12)))
            stone = shape.moved(scale=size).turned("z", turn).moved((x, y, height))
            self._items.append((stone, None))

    def _lay_wall(self, rng: Draws) -> None:
        """A ruined piece of wall, off the path."""
        build = things.quay if rng.random() < 0.7 else things.sheet_pile
        wall = build(rng, rng.uniform(1.5, 4.0), rng.uniform(0.5, 1.4))
        wall = wall.turned("z", rng.uniform(0, _TURN))
        reach = float(np.abs(wall.vertices[:, :2]).max())
        spot = self._spot(rng, reach, 1.5)
        if spot is not None:
            self._fix(wall, "Wall", self._grounded(*spot), reach)

    def _lay_line(self, rng: Draws, kind: str) -> None:
        """A chain or pipe that follows the ground."""
        chain = kind == "Chain"
        length = rng.uniform(2.0, 4.5) if chain else rng.uniform(5.0, 14.0)
        aside = rng.choice([-1, 1]) * rng.uniform(0.3, 0.7 * self._place["spread_m"] + 0.5)
        near = self._near_path(rng, np.array([aside]))[0]
        line = things.curve(rng, near, length, 0.9 if chain else 0.12)
        build = things.chain if chain else things.pipe
        self._items.append((build(rng, line, self.terrain.height_m), kind))
        if not chain:
            self._taken += [(x, y, 0.25) for x, y in line[::6].tolist()]

    def _build_pier(self, rng: Draws) -> None:
        """Rows of piles along the axis, braced in pairs."""
        radius = rng.uniform(0.16, 0.38)
        spacing = rng.uniform(2.6, 4.0)
        first = rng.uniform(2.1, 2.8)
        rows = [first, -first, first + rng.uniform(2.2, 3.2), -first - rng.uniform(2.2, 3.2)]
        for across in rows:
            previous: Float64s | None = None
            for along in np.arange(-22, 22, spacing):
                foot = self._on_axis(along + rng.normal(0, 0.1), across + rng.normal(0, 0.08))
                top = rng.uniform(6, 8)
                self._fix(things.pile(rng, top, radius * rng.uniform(0.9, 1.1)), "Pillar", foot)
                if previous is not None and rng.random() < 0.55:
                    low = [0, 0, rng.uniform(0.4, 1.4)]
                    high = [0, 0, rng.uniform(1.6, 3.2)]
                    self._items.append((things.brace(rng, previous + low, foot + high), "Pillar"))
                previous = foot

    def _build_quay(self, rng: Draws) -> None:
        """A long wall left of the axis, with tyres hanging on it."""
        length = 44.0
        height = rng.uniform(3.2, 5.0)
        face = rng.uniform(2.2, 3.2)
        foot = self._on_axis(0.0, face)
        turn = rotation("z", self._heading_rad)
        build = things.sheet_pile if rng.random() < 0.35 else things.quay
        self._items.append((build(rng, length, height).rotated(turn).moved(foot), "Wall"))
        for along in np.arange(-18, 18, 2.2):
            place = np.array([along + rng.uniform(-0.8, 0.8), -0.28, rng.uniform(0.7, 2.4)])
            if rng.random() < 0.5:
                offset = np.einsum("ij,j->i", turn, place) + foot
                self._items.append((things.fender(rng).rotated(turn).moved(offset), "Tire"))
        behind = (self._on_axis(along, face + 0.4) for along in np.arange(-20, 20, 0.8))
        self._taken += [(float(x), float(y), 0.8) for x, y, _ in behind]

    def _build_tank(self, rng: Draws, kind: str) -> None:
        """Four walls around the camera's loop, or a round one."""
        half_along, half_across = rng.uniform([2.2, 2.0], [4.8, 4.2]).tolist()
        height = rng.uniform(1.8, 3.2)
        is_round = rng.random() < 0.25
        if is_round:
            half_across = half_along
        self._half_sides_m = half_along, half_across
        turn = rotation("z", self._heading_rad)
        foot = self._on_axis(0.0, 0.0)
        walls = furniture.round_wall(rng, half_along, height)
        if not is_round:
            walls = furniture.square_walls(rng, (half_along, half_across), height)
        self._items.append((walls.rotated(turn).moved(foot), kind))

    def _put_fittings(self, rng: Draws) -> None:
        """What belongs to a place: on its floor, along its walls, hanging in the water."""
        least, most = self._place["fittings"]
        for _ in range(int(rng.integers(least, most + 1)) if most else 0):
            fitting = furniture.drawn_fitting(rng)
            turned = fitting.mesh.turned("z", rng.uniform(0, _TURN))
            reach = float(np.abs(turned.vertices[:, :2]).max())
            if fitting.stands_at_wall and self._half_sides_m is not None:
                spot = self._along_wall(rng)
            else:
                aside = rng.exponential(self._place["spread_m"], 1) * rng.choice([-1, 1], 1)
                x, y = self._near_path(rng, aside)[0].tolist()
                spot = self._inside(x, y, 0.5 * reach)
            self._fix(turned, FITTING, self._grounded(*spot), 0.3 * reach)

    def _along_wall(self, rng: Draws) -> tuple[float, float]:
        """A place at one of the four walls of a tank."""
        assert self._half_sides_m is not None
        share = rng.uniform(-0.9, 0.9)
        side = float(rng.choice([-0.95, 0.95]))
        shares = (share, side) if rng.random() < 0.5 else (side, share)
        along, across = (part * half for part, half in zip(shares, self._half_sides_m, strict=True))
        x, y, _ = self._on_axis(along, across)
        return float(x), float(y)

    def _inside(self, x: float, y: float, reach: float) -> tuple[float, float]:
        """The place itself, or the nearest one at which a thing of that reach is in the tank."""
        if self._half_sides_m is None:
            return x, y
        c = np.cos(self._heading_rad)
        s = np.sin(self._heading_rad)
        limits = np.maximum(np.array(self._half_sides_m) - reach, 0.1)
        along, across = np.clip([c * x + s * y, c * y - s * x], -limits, limits).tolist()
        x, y, _ = self._on_axis(along, across)
        return float(x), float(y)

    def _spot(self, rng: Draws, reach: float, height: float) -> tuple[float, float] | None:
        """A free place for a thing of that reach and height, or None after 40 tries."""
        nearest = 0.0 if height < LOW_M else reach + CLEAR_M
        taken = np.array(self._taken, dtype=np.float64).reshape(-1, 3)
        for _ in range(5):  # eight tries at once
            aside = nearest + rng.exponential(self._place["spread_m"], 8)
            points = self._near_path(rng, aside * rng.choice([-1, 1], 8))
            to_path = points[:, None] - self.path.points
            free = np.sqrt((to_path**2).sum(axis=-1).min(axis=-1)) >= nearest
            if self.terrain.banks is not None:
                behind = self.terrain.banks.behind_foot_m(*points.T.astype(np.float32))
                free &= behind <= 0.3 * reach
            if self._half_sides_m is not None:
                inside = [self._inside(x, y, reach) for x, y in points.tolist()]
                free &= np.isclose(points, inside).all(axis=1)
            apart = np.hypot(*(points[:, :, None] - taken[:, :2].T).transpose(1, 0, 2))
            free &= (apart > reach + taken[:, 2]).all(axis=1)
            if free.any():
                x, y = points[np.argmax(free)].tolist()
                return x, y
        return None

    def _near_path(self, rng: Draws, aside: Float64s) -> Float64s:
        """(N, 2) points beside the path anywhere along it, (N,) metres to its left."""
        point, tangent = self.path.at(rng.uniform(*self._stretch_m, len(aside)))
        left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
        return np.asarray(point + aside[:, None] * left)

    def _on_axis(self, along: float, across: float) -> Float64s:
        c = np.cos(self._heading_rad)
        s = np.sin(self._heading_rad)
        return self._grounded(c * along - s * across, s * along + c * across)

    def _grounded(self, x: float, y: float) -> Float64s:
        return np.array([x, y, self.terrain.height_m([x], [y])[0]])
