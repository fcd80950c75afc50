"""Puts objects on the ground of a location, clear of each other and of the camera's path."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ...seeds import stream
from . import things
from .biomes import Place, draw
from .fields import WORLD_SEED
from .meshes import Mesh, rotation
from .path import Loop
from .terrain import Terrain

Points = npt.NDArray[np.float64]

LOW_M = 0.42  # what is lower than this may lie under the camera's path
CLEAR_M = 0.75  # what is taller keeps this far from it


@dataclass(frozen=True, eq=False)
class Item:
    """An object in its place.  kind: its name in `things.KINDS`, or None for a pebble (ground)."""

    mesh: Mesh
    kind: str | None


@dataclass(eq=False)
class Site:
    """A location while it is being furnished.

    taken: (x, y, radius) of what lies there already.  stretch_m: the part of the loop beside which
    things are put, None for all of it.
    """

    rng: np.random.Generator
    place: Place
    terrain: Terrain
    loop: Loop
    heading_rad: float
    items: list[Item] = field(default_factory=list)
    taken: list[tuple[float, float, float]] = field(default_factory=list)
    stretch_m: tuple[float, float] | None = None
    _known: Points = field(default_factory=lambda: np.empty((0, 3)))

    def scatter(self, kind: str, count: int) -> None:
        """Put `count` objects of a kind with a free-standing builder near the path."""
        for _ in range(count):
            if things.KINDS[kind].build is None:
                self._lay(kind)
                continue
            turned = things.drawn_model(self.rng, kind)
            reach = float(np.sqrt((turned.vertices[:, :2] ** 2).sum(axis=1).max()))
            spot = self.spot(reach, float(turned.vertices[:, 2].max()))
            if spot is not None:
                self.settle(turned, kind, spot, reach)

    def pebbles(self, count: int) -> None:
        """Small stones, in heaps, of a few shapes used again and again."""
        heaps = self._near_loop(self.rng.uniform(-6, 6, max(count // 14, 1)))
        spots = heaps[self.rng.integers(len(heaps), size=count)]
        spots += self.rng.normal(0, 0.7, (count, 2))
        for (x, y), height in zip(spots, self.terrain.height_m(*spots.T), strict=True):
            turn, size = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(0.6, 1.5)
            shape = things.model("Pebble", int(self.rng.integers(12)))
            turned = shape.moved(rotation("z", turn), (x, y, height), size)
            self.items.append(Item(turned, None))

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
                    self.items.append(Item(beam, "Pillar"))
                previous = foot

    def build_quay(self) -> None:
        """A long wall left of the axis, with tyres and chains hanging on it."""
        rng = self.rng
        length, height = 44.0, rng.uniform(3.2, 5.0)
        face = rng.uniform(2.2, 3.2)
        foot = self._on_axis(0.0, face)
        turn = rotation("z", self.heading_rad)
        steel = rng.random() < 0.35
        build = things.sheet_pile if steel else things.quay
        self.items.append(Item(build(rng, length, height).moved(turn, foot), "Wall"))
        for along in np.arange(-18, 18, 2.2):
            where = np.array([along + rng.uniform(-0.8, 0.8), -0.28, rng.uniform(0.7, 2.4)])
            if rng.random() < 0.5:
                hung = things.fender(rng)
                offset = np.einsum("ij,j->i", turn, where) + foot
                self.items.append(Item(hung.moved(turn, offset), "Tire"))
        self.taken += [
            (*self._on_axis(along, face + 0.4)[:2].tolist(), 0.8)
            for along in np.arange(-20, 20, 0.8)
        ]

    def _lay(self, kind: str) -> None:
        """Lay out an object that follows the ground."""
        rng = self.rng
        if kind == "Wall":  # a ruined piece of wall, off the path
            build = things.quay if rng.random() < 0.7 else things.sheet_pile
            wall = build(rng, rng.uniform(1.5, 4.0), rng.uniform(0.5, 1.4))
            wall = wall.moved(rotation("z", rng.uniform(0, 2 * np.pi)))
            reach = float(np.abs(wall.vertices[:, :2]).max())
            spot = self.spot(reach, 1.5)
            if spot is not None:
                self._fix(wall, kind, np.array([*spot, self._ground(*spot)]), reach)
            return
        length = rng.uniform(2.0, 4.5) if kind == "Chain" else rng.uniform(5.0, 14.0)
        aside = rng.choice([-1, 1]) * rng.uniform(0.3, 0.7 * self.place.spread_m + 0.5)
        near = self._near_loop(np.array([aside]))[0]
        line = things.curve(rng, near, length, 0.9 if kind == "Chain" else 0.12)
        build_line = things.chain if kind == "Chain" else things.pipe
        self.items.append(Item(build_line(rng, line, self.terrain.height_m), kind))
        if kind == "Pipe":
            self.taken += [(float(x), float(y), 0.25) for x, y in line[::6]]

    def settle(
        self,
        mesh: Mesh,
        kind: str,
        spot: tuple[float, float],
        reach: float,
        burial: tuple[float, float] = (0.02, 0.18),
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
        self.items.append(Item(mesh.moved(offset=(x, y, height - sunk)), kind))
        self.taken.append((x, y, 0.85 * reach))

    def _fix(self, mesh: Mesh, kind: str, foot: Points, reach: float = 0.4) -> None:
        self.items.append(Item(mesh.moved(offset=foot), kind))
        self.taken.append((float(foot[0]), float(foot[1]), reach))

    def spot(self, reach: float, height: float) -> tuple[float, float] | None:
        """A free place for a thing of that reach and height, or None after 40 tries."""
        nearest = 0.0 if height < LOW_M else reach + CLEAR_M
        for _ in range(5):  # eight tries at once
            aside = nearest + self.rng.exponential(self.place.spread_m, 8)
            points = self._near_loop(aside * self.rng.choice([-1, 1], 8))
            free = self.loop.distance_m(*points.T) >= nearest
            if self.terrain.banks is not None:
                behind = self.terrain.banks.behind_foot_m(*points.T.astype(np.float32))
                free &= behind <= 0.3 * reach
            there = self._there()
            apart = np.hypot(*(points[:, :, None] - there[:, :2].T).transpose(1, 0, 2))
            free &= (apart > reach + there[:, 2]).all(axis=1)
            if free.any():
                x, y = points[np.argmax(free)].tolist()
                return x, y
        return None

    def _there(self) -> Points:
        """(N, 3) `taken`."""
        if len(self._known) != len(self.taken):
            self._known = np.array(self.taken, dtype=np.float64)
        return self._known

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


def furnish(site: Site, location: int, density: float, allowed: Iterable[str] | None) -> list[Item]:
    """Build the place's structure, then scatter its objects, large kinds first.

    density multiplies every count; allowed: kinds to use, or None for all.
    """
    names = set(things.KINDS if allowed is None else allowed)
    scatter = site.place.scatter

    def draw_from(what: str) -> None:
        site.rng = stream(WORLD_SEED, "seabed", location, what)

    draw_from("structure")
    if site.place.structure == "pier" and "Pillar" in names:
        site.build_pier()
    if site.place.structure == "quay" and "Wall" in names:
        site.build_quay()
    large_first = ("Pipe", "Wall", "Frame", "Anchor", "Block", "Barrel", "Tire", "Boulder")
    order = [*large_first, *(kind for kind in scatter if kind not in large_first)]
    for kind in order:
        if kind in names and kind in scatter:
            draw_from(kind)
            site.scatter(kind, round(draw(site.rng, scatter[kind]) * density))
    draw_from("pebbles")
    site.pebbles(round(draw(site.rng, site.place.pebbles) * min(density, 1.0)))
    return site.items
