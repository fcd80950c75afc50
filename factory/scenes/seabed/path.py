"""The camera's path: a loop that wanders in height, and the movements of a platform from there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path as FilePath

import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ..base import numbered_lines
from .biomes import Place, draw
from .fields import Waves, waves
from .terrain import Terrain

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


@dataclass(frozen=True)
class Movement:
    """A frame of a moving platform: its pose relative to where its recording begins.

    Surge is forward, sway to the left, heave up (REP 103, level, along the first heading); yaw
    turns left, pitch looks down, roll lowers the right side.  time_s: None where it has none.
    """

    time_s: float | None = None
    surge_m: float = 0.0
    sway_m: float = 0.0
    heave_m: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    def moved(self, eye: Points, rotation: Points) -> tuple[Points, Points]:
        """Eye (3,) and rotation (3, 3; world from camera axes: x right, y down, z forward)."""
        ahead = np.array([rotation[0, 2], rotation[1, 2], 0.0])
        ahead /= np.linalg.norm(ahead)
        left, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
        roll, pitch, yaw = np.deg2rad([self.roll_deg, self.pitch_deg, self.yaw_deg])
        turned = _about(up, yaw) @ rotation
        # Pitch about the camera's left, roll about its forward axis.
        turned = _about(-turned[:, 0], pitch) @ turned
        turned = _about(turned[:, 2], roll) @ turned
        return eye + self.surge_m * ahead + self.sway_m * left + self.heave_m * up, turned


@lru_cache(maxsize=4)
def movements(path: FilePath) -> tuple[Movement, ...]:
    """The lines of a CSV file: a header of some keys of `Movement`, then a line a frame.

    Raises FactoryError that names the file and the line.
    """
    lines = numbered_lines(path)
    keys = tuple(Movement.__dataclass_fields__)
    names = [word.strip() for word in lines[0][1].split(",")] if lines else []
    if not set(names) <= set(keys) or len(set(names)) != len(names) or len(lines) < 2:
        raise FactoryError(
            f"{path}: expected a header of {', '.join(keys)} (some of them, each once) and a line "
            f"for each frame, got {','.join(names)[:60]!r} and {max(len(lines) - 1, 0)} lines"
        )
    found = []
    for number, line in lines[1:]:
        try:
            values = [float(word) for word in line.split(",")]
            if not np.isfinite(values).all():
                raise ValueError
            found.append(Movement(**dict(zip(names, values, strict=True))))
        except ValueError as error:
            raise FactoryError(
                f"{path}:{number}: expected {len(names)} numbers ({', '.join(names)}), got "
                f"{line[:60]!r}"
            ) from error
    return tuple(found)


def _about(axis: Points, angle_rad: float) -> Points:
    """Rotation matrix (3, 3) about a unit axis, right-handed (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross
    return np.asarray(turn)
