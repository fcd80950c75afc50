"""A location, built from its number: the camera's path, and objects clear of it and each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ...labels import class_names
from ...seeds import stream
from . import things
from .biomes import PLACES, Look, Place, PlaceName, draw, draw_look, draw_terrain
from .camera import Objects, objects_of
from .meshes import Mesh, mesh, rotation
from .own_objects import Owned
from .terrain import WORLD_SEED, Floats, Terrain, Waves, waves

_VIEWS = 10  # own objects lie before the first so many views of a path, where cameras pass
_AHEAD_M = 1.5
Points = npt.NDArray[np.float64]

SAMPLES = 512
LOWEST_M, HIGHEST_M = 0.75, 2.8  # camera above the ground right under it


@dataclass(frozen=True, eq=False)
class Loop:
    """A closed curve on the map, `SAMPLES` points equally far apart.

    points: (S, 2) metres.  tangents: (S, 2) unit.  length_m: once around.
    """

    points: Points
    tangents: Points
    length_m: float

    def at(self, distance_m: npt.ArrayLike) -> tuple[Points, Points]:
        """Positions and unit tangents, (..., 2) each, after distances (...) along the loop."""
        where = (np.asarray(distance_m) / self.length_m) % 1 * SAMPLES
        low = where.astype(np.int64) % SAMPLES
        high, part = (low + 1) % SAMPLES, (where - np.floor(where))[..., None]
        point = self.points[low] * (1 - part) + self.points[high] * part
        tangent = self.tangents[low] * (1 - part) + self.tangents[high] * part
        return point, tangent / np.sqrt((tangent**2).sum(axis=-1, keepdims=True))

    def distance_m(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Points:
        """Distance from points on the map to the loop."""
        dx = np.asarray(x, dtype=np.float64)[..., None] - self.points[:, 0]
        dy = np.asarray(y, dtype=np.float64)[..., None] - self.points[:, 1]
        return np.asarray(np.sqrt((dx**2 + dy**2).min(axis=-1)))


def draw_loop(rng: np.random.Generator, place: Place, terrain: Terrain, heading_rad: float) -> Loop:
    """A loop around the origin: an oval with lobes in the open, there and back between walls."""
    long, short = (draw(rng, span) for span in place.loop_m)
    angle = np.linspace(0, 2 * np.pi, 4 * SAMPLES, endpoint=False)
    narrow = short < 0.3 * long
    lobes = np.zeros_like(angle)
    if not narrow:
        for cycles in (2, 3):
            lobes += rng.uniform(0.05, 0.13) * np.sin(cycles * angle + rng.uniform(0, 2 * np.pi))
    along = long * (1 + lobes) * np.cos(angle)
    across = short * (1 + lobes) * np.sin(angle)
    if terrain.banks is not None:
        across = across + terrain.banks.axis_offset_m(along)
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    points = np.stack([c * along - s * across, s * along + c * across], axis=-1)
    steps = np.sqrt(((np.roll(points, -1, axis=0) - points) ** 2).sum(axis=1))
    travelled = np.concatenate([[0], np.cumsum(steps)])
    closed = np.concatenate([points, points[:1]])
    even = np.arange(SAMPLES) / SAMPLES * travelled[-1]
    points = np.stack([np.interp(even, travelled, closed[:, k]) for k in (0, 1)], axis=-1)
    ahead = 6  # the heading looks a little ahead, as a diver does
    tangents = np.roll(points, -ahead, axis=0) - np.roll(points, ahead, axis=0)
    tangents /= np.sqrt((tangents**2).sum(axis=1, keepdims=True))
    return Loop(points, tangents, float(travelled[-1]))


@dataclass(frozen=True, eq=False)
class Path:
    """Where the camera is and roughly where it looks at every distance along its loop.

    floor_m: (S,) the highest ground near each point of the loop.
    lean: a horizontal vector added to the unit heading, to look at a wall beside the loop.
    """

    loop: Loop
    floor_m: Points
    start_m: float
    step_m: float
    altitude_m: float
    altitude_waves: Waves
    pitch_deg: float
    attitude: tuple[Waves, Waves, Waves]
    lean: tuple[float, float]

    def distance_m(self, frame: int) -> float:
        """Distance travelled at a frame; laps never repeat, because the wander goes on."""
        return self.start_m + self.step_m * frame

    def eye(self, frame: int, terrain: Terrain) -> Points:
        """(3,) camera position."""
        travelled = self.distance_m(frame)
        (x, y), _ = self.loop.at(travelled)
        where = (travelled / self.loop.length_m) % 1 * SAMPLES
        floor = np.interp(where, np.arange(SAMPLES + 1), np.append(self.floor_m, self.floor_m[0]))
        below = float(terrain.height_m(np.array([x]), np.array([y]))[0])
        altitude = self.altitude_m + 0.25 * self._wander(self.altitude_waves, travelled)
        altitude = min(max(altitude, LOWEST_M), HIGHEST_M - 0.3)
        return np.array([x, y, min(floor + altitude, below + HIGHEST_M)])

    def attitude_deg(self, frame: int) -> tuple[float, float, float]:
        """Heading (counter-clockwise from +x), pitch (down) and roll before the view is chosen."""
        travelled = self.distance_m(frame)
        _, tangent = self.loop.at(travelled)
        yaw, pitch, roll = (self._wander(field, travelled) for field in self.attitude)
        ahead = tangent + self.lean
        heading = float(np.rad2deg(np.arctan2(ahead[1], ahead[0])))
        return heading + 10 * yaw, self.pitch_deg + 3 * pitch, 3.0 * roll

    @staticmethod
    def _wander(field: Waves, travelled: float) -> float:
        return float(np.clip(field(np.array([travelled]), np.zeros(1))[0], -2, 2))


def draw_path(
    rng: np.random.Generator, place: Place, terrain: Terrain, loop: Loop, heading_rad: float
) -> Path:
    """A path over the loop.  The floor is the highest ground within 0.7 m."""
    across = place.look_across * np.array([-np.sin(heading_rad), np.cos(heading_rad)])
    reach = np.linspace(-0.7, 0.7, 5)
    dx, dy = np.meshgrid(reach, reach)
    x, y = loop.points[:, :1] + dx.ravel(), loop.points[:, 1:] + dy.ravel()
    highest = terrain.height_m(x, y).max(axis=1).astype(np.float64)
    window = 2 * int(0.8 / loop.length_m * SAMPLES) + 1
    wrapped = np.pad(highest, window, mode="wrap")
    floor = np.convolve(wrapped, np.ones(window) / window, mode="same")[window:-window]
    return Path(
        loop=loop,
        floor_m=floor,
        start_m=rng.uniform(0, loop.length_m),
        step_m=rng.uniform(1.5, 2.1),
        altitude_m=draw(rng, place.altitude_m),
        altitude_waves=waves(rng, 60, 4, 0.8),
        pitch_deg=draw(rng, place.pitch_deg),
        attitude=(waves(rng, 70, 5, 0.7), waves(rng, 80, 5, 0.7), waves(rng, 90, 5, 0.7)),
        lean=(float(across[0]), float(across[1])),
    )


LOW_M = 0.42  # what is lower than this may lie under the camera's path
CLEAR_M = 0.75  # what is taller keeps this far from it


@dataclass(eq=False)
class Site:
    """A location while it is being furnished.

    items: what lies there, and its name in `things.KINDS`, None for a pebble (ground).  taken: its
    (x, y, radius).  stretch_m: the part of the loop beside which things are put; None: all of it.
    """

    rng: np.random.Generator
    place: Place
    terrain: Terrain
    loop: Loop
    heading_rad: float
    items: list[tuple[Mesh, str | None]] = field(default_factory=list)
    taken: list[tuple[float, float, float]] = field(default_factory=list)
    stretch_m: tuple[float, float] | None = None

    def scatter(self, kind: str, count: int) -> None:
        """Put `count` objects of a kind with a free-standing builder near the path."""
        for _ in range(count):
            if things.KINDS[kind].build is None:
                self._lay(kind)
            else:
                self.put(things.drawn_model(self.rng, kind), kind)

    def put(self, mesh: Mesh, kind: str, burial: tuple[float, float] = (0.02, 0.18)) -> None:
        """Put a thing at a free spot near the path, if there is one; see `_settle`."""
        reach = float(np.sqrt((mesh.vertices[:, :2] ** 2).sum(axis=1).max()))
        spot = self._spot(reach, float(mesh.vertices[:, 2].max()))
        if spot is not None:
            self._settle(mesh, kind, spot, reach, burial)

    def pebbles(self, count: int) -> None:
        """Small stones, in heaps, of a few shapes used again and again."""
        heaps = self._near_loop(self.rng.uniform(-6, 6, max(count // 14, 1)))
        spots = heaps[self.rng.integers(len(heaps), size=count)]
        spots += self.rng.normal(0, 0.7, (count, 2))
        for (x, y), height in zip(spots, self.terrain.height_m(*spots.T), strict=True):
            turn, size = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(0.6, 1.5)
            shape = things.model("Pebble", int(self.rng.integers(12)))
            self.items.append((shape.moved(rotation("z", turn), (x, y, height), size), None))

    def build_pier(self) -> None:
        """Rows of piles along the axis, braced in pairs."""
        rng = self.rng
        radius, spacing = rng.uniform(0.16, 0.38), rng.uniform(2.6, 4.0)
        first = rng.uniform(2.1, 2.8)
        rows = [first, -first, first + rng.uniform(2.2, 3.2), -first - rng.uniform(2.2, 3.2)]
        for across in rows:
            previous: Points | None = None
            for along in np.arange(-22, 22, spacing):
                foot = self._on_axis(along + rng.normal(0, 0.1), across + rng.normal(0, 0.08))
                top = rng.uniform(6, 8)
                shaft = things.pile(rng, top, radius * rng.uniform(0.9, 1.1))
                self._fix(shaft, "Pillar", foot)
                if previous is not None and rng.random() < 0.55:
                    low, high = rng.uniform(0.4, 1.4), rng.uniform(1.6, 3.2)
                    lift = np.array([0, 0, 1.0])
                    beam = things.brace(rng, previous + low * lift, foot + high * lift)
                    self.items.append((beam, "Pillar"))
                previous = foot

    def build_quay(self) -> None:
        """A long wall left of the axis, with tyres and chains hanging on it."""
        rng = self.rng
        length, height, face = 44.0, rng.uniform(3.2, 5.0), rng.uniform(2.2, 3.2)
        foot, turn = self._on_axis(0.0, face), rotation("z", self.heading_rad)
        build = things.sheet_pile if rng.random() < 0.35 else things.quay
        self.items.append((build(rng, length, height).moved(turn, foot), "Wall"))
        for along in np.arange(-18, 18, 2.2):
            where = np.array([along + rng.uniform(-0.8, 0.8), -0.28, rng.uniform(0.7, 2.4)])
            if rng.random() < 0.5:
                offset = np.einsum("ij,j->i", turn, where) + foot
                hung = things.fender(rng)
                self.items.append((hung.moved(turn, offset), "Tire"))
        behind = (self._on_axis(along, face + 0.4) for along in np.arange(-20, 20, 0.8))
        self.taken += [(float(x), float(y), 0.8) for x, y, _ in behind]

    def _lay(self, kind: str) -> None:
        """Lay out an object that follows the ground."""
        rng = self.rng
        if kind == "Wall":  # a ruined piece of wall, off the path
            build = things.quay if rng.random() < 0.7 else things.sheet_pile
            wall = build(rng, rng.uniform(1.5, 4.0), rng.uniform(0.5, 1.4))
            wall = wall.moved(rotation("z", rng.uniform(0, 2 * np.pi)))
            reach = float(np.abs(wall.vertices[:, :2]).max())
            spot = self._spot(reach, 1.5)
            if spot is not None:
                self._fix(wall, kind, np.array([*spot, self._ground(*spot)]), reach)
            return
        length = rng.uniform(2.0, 4.5) if kind == "Chain" else rng.uniform(5.0, 14.0)
        aside = rng.choice([-1, 1]) * rng.uniform(0.3, 0.7 * self.place.spread_m + 0.5)
        near = self._near_loop(np.array([aside]))[0]
        line = things.curve(rng, near, length, 0.9 if kind == "Chain" else 0.12)
        build_line = things.chain if kind == "Chain" else things.pipe
        self.items.append((build_line(rng, line, self.terrain.height_m), kind))
        if kind == "Pipe":
            self.taken += [(float(x), float(y), 0.25) for x, y in line[::6]]

    def _settle(
        self,
        mesh: Mesh,
        kind: str,
        spot: tuple[float, float],
        reach: float,
        burial: tuple[float, float],
    ) -> None:
        """Set a thing down so that it follows the slope and sinks in by a share of its height."""
        x, y = spot
        step = max(min(reach, 0.5), 0.08)
        cross = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * step + [x, y]
        height, east, west, north, south = self.terrain.height_m(*cross.T).astype(np.float64)
        dx, dy = (east - west) / (2 * step), (north - south) / (2 * step)
        if kind not in things.KINDS or not things.KINDS[kind].upright:
            steep = min(float(np.hypot(dx, dy)), 0.8)
            angle, toward = np.arctan(steep), np.arctan2(dy, dx)
            tilt = rotation("z", toward) @ rotation("y", -angle) @ rotation("z", -toward)
            mesh = mesh.moved(tilt)
        size = float(np.ptp(mesh.vertices[:, 2]))
        sunk = size * self.rng.uniform(*burial) + 0.01
        self.items.append((mesh.moved(offset=(x, y, height - sunk)), kind))
        self.taken.append((x, y, 0.85 * reach))

    def _fix(self, mesh: Mesh, kind: str, foot: Points, reach: float = 0.4) -> None:
        self.items.append((mesh.moved(offset=foot), kind))
        self.taken.append((float(foot[0]), float(foot[1]), reach))

    def _spot(self, reach: float, height: float) -> tuple[float, float] | None:
        """A free place for a thing of that reach and height, or None after 40 tries."""
        nearest = 0.0 if height < LOW_M else reach + CLEAR_M
        there = np.array(self.taken, dtype=np.float64).reshape(-1, 3)
        for _ in range(5):  # eight tries at once
            aside = nearest + self.rng.exponential(self.place.spread_m, 8)
            points = self._near_loop(aside * self.rng.choice([-1, 1], 8))
            free = self.loop.distance_m(*points.T) >= nearest
            if self.terrain.banks is not None:
                behind = self.terrain.banks.behind_foot_m(*points.T.astype(np.float32))
                free &= behind <= 0.3 * reach
            apart = np.hypot(*(points[:, :, None] - there[:, :2].T).transpose(1, 0, 2))
            free &= (apart > reach + there[:, 2]).all(axis=1)
            if free.any():
                x, y = points[np.argmax(free)].tolist()
                return x, y
        return None

    def _near_loop(self, aside: Points) -> Points:
        """(N, 2) points beside the loop anywhere along it, (N,) metres to its left."""
        stretch = self.stretch_m or (0.0, self.loop.length_m)
        point, tangent = self.loop.at(self.rng.uniform(stretch[0], stretch[1], len(aside)))
        left = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
        return np.asarray(point + aside[:, None] * left)

    def _on_axis(self, along: float, across: float) -> Points:
        c, s = np.cos(self.heading_rad), np.sin(self.heading_rad)
        x, y = c * along - s * across, s * along + c * across
        return np.array([x, y, self._ground(x, y)])

    def _ground(self, x: float, y: float) -> float:
        return float(self.terrain.height_m(np.array([x]), np.array([y]))[0])


def furnish(
    site: Site, location: int, density: float, allowed: Iterable[str] | None
) -> list[tuple[Mesh, str | None]]:
    """Build the place's structure, then scatter its objects, large kinds first.

    density multiplies every count; allowed: kinds to use, or None for all.
    """
    names = set(things.KINDS if allowed is None else allowed)
    scatter = site.place.scatter

    site.rng = stream(WORLD_SEED, "seabed", location, "structure")
    if site.place.structure == "pier" and "Pillar" in names:
        site.build_pier()
    if site.place.structure == "quay" and "Wall" in names:
        site.build_quay()
    large_first = ("Pipe", "Wall", "Frame", "Anchor", "Block", "Barrel", "Tire", "Boulder")
    order = [*large_first, *(kind for kind in scatter if kind not in large_first)]
    for kind in order:
        if kind in names and kind in scatter:
            site.rng = stream(WORLD_SEED, "seabed", location, kind)
            site.scatter(kind, round(draw(site.rng, scatter[kind]) * density))
    site.rng = stream(WORLD_SEED, "seabed", location, "pebbles")
    site.pebbles(round(draw(site.rng, site.place.pebbles) * min(density, 1.0)))
    return site.items


def place_own(site: Site, path: Path, location: int, own: Sequence[Owned]) -> None:
    """Put the user's objects beside the part of the path that views show."""
    first = path.start_m + _AHEAD_M
    for number, one in enumerate(own):
        site.rng = rng = stream(WORLD_SEED, "seabed", location, "own", number)
        site.stretch_m = (first, first + _VIEWS * path.step_m)
        settings = one.settings
        for _ in range(int(rng.integers(settings.per_place[0], settings.per_place[1] + 1))):
            tilt, toward = np.deg2rad(rng.uniform(*settings.tilt_deg)), rng.uniform(0, 2 * np.pi)
            turn = rotation("z", toward) @ rotation("y", tilt) @ rotation("z", -toward)
            turned = one.mesh.moved(turn @ rotation("z", rng.uniform(0, 2 * np.pi))).standing()
            site.put(turned, settings.label, settings.burial)


@dataclass(frozen=True, eq=False)
class World:
    """One location.

    finishes: (N, 3) fouling, silt and bump of each object, see `things.Kind`.  first_own: number in
    `objects.instances` from which on they are the user's own.
    """

    location: int
    terrain: Terrain
    path: Path
    look: Look
    objects: Objects
    finishes: Floats
    first_own: int = 1 << 16


def build_world(
    location: int,
    places: tuple[PlaceName, ...],
    density: float,
    kinds: Iterable[str] | None,
    own: Sequence[Owned] = (),
) -> World:
    """Build location number `location`; it is a place of kind `places[location % len(places)]`.

    own: the user's objects, put there when all else lies there.
    """
    place = PLACES[places[location % len(places)]]
    rng = stream(WORLD_SEED, "seabed", location, "ground")
    heading = rng.uniform(0, 2 * np.pi)
    terrain = draw_terrain(rng, place, heading)
    rng = stream(WORLD_SEED, "seabed", location, "path")
    loop = draw_loop(rng, place, terrain, heading)
    path = draw_path(rng, place, terrain, loop, heading)
    site = Site(rng, place, terrain, loop, heading)
    items = furnish(site, location, density, kinds)
    first_own = 1 + sum(kind is not None for _, kind in items)
    place_own(site, path, location, own)
    classes = class_names(one.settings.label for one in own)
    if not items:  # an empty mesh has no shape: one triangle far below the ground
        items = [(mesh(np.eye(3) - [0, 0, 1e4], [[0, 1, 2]]), None)]
    labels = np.array([classes.index(kind) if kind else 0 for _, kind in items], np.uint8)
    finish = [things.KINDS.get(kind or "Boulder", things.PLAIN) for _, kind in items]
    return World(
        location,
        terrain,
        path,
        draw_look(stream(WORLD_SEED, "seabed", location, "light"), place),
        objects_of([solid for solid, _ in items], labels),
        np.array([(kind.fouling, kind.silt, kind.bump) for kind in finish], np.float32),
        first_own,
    )
