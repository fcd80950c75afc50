"""Keys of moving objects: how they move, in which number, and how strongly they echo.

Positions are those of a recording: its origin is the sonar at the first frame, x points the way the
sonar looks (level), y to its left, z up.  `simulation.moving` draws and places the objects.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, PlainSerializer
from pydantic.dataclasses import dataclass

from ...common.array_types import Float64s
from ...common.distribution import Distribution, number, parse
from ...common.errors import FactoryError
from ...common.settings import STRICT, ClassName
from ...common.small_files import number_table
from ...dataset.meaning import ObjectName
from .base import OwnClass, Root

FASTEST_M_S = 30.0
"""No fish, diver or vehicle under water is faster."""
FARTHEST_M = 36.0
"""Half the side of the world of a recording: the procedural ground ends there."""
PATH_COLUMNS = ("time_s", "x_m", "y_m", "z_m", "yaw_deg", "pitch_deg", "roll_deg")
_FISH = "Fish"


def _limited(low: float, high: float, unit: str = "") -> tuple[BeforeValidator, PlainSerializer]:
    return (
        BeforeValidator(lambda value: parse(value, low, high, unit)),
        PlainSerializer(lambda distribution: distribution.plain()),
    )


Angle = Annotated[Distribution, *_limited(-3600.0, 3600.0, "deg")]
Speed = Annotated[Distribution, *_limited(0.0, FASTEST_M_S, "m/s")]
Metres = Annotated[Distribution, *_limited(0.0, FARTHEST_M, "m")]
Length = Annotated[Distribution, *_limited(0.005, 15.0, "m")]
Share = Annotated[Distribution, *_limited(0.02, 1.0)]
Hertz = Annotated[Distribution, *_limited(0.0, 30.0, "Hz")]
Decibels = Annotated[Distribution, *_limited(-90.0, 30.0, "dB")]
Members = Annotated[Distribution, *_limited(1.0, 500.0)]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class Start:
    """Keys of `moving.start`, the place at the first frame.

    range_m: from the sonar, level.  bearing_deg: to the right of the way the sonar looks.
    """

    range_m: Metres = parse({"uniform": [2.0, 6.0]}, 0.0, FARTHEST_M)
    bearing_deg: Angle = parse({"uniform": [-15.0, 15.0]}, -3600.0, 3600.0)


@dataclass(frozen=True, config=STRICT, kw_only=True)
class School:
    """Keys of `moving.school`.

    count: objects that move together.  spread_m: standard deviation of their places about its
        middle.
    """

    count: Members = number(10)
    spread_m: Metres = number(0.5)


@dataclass(frozen=True, config=STRICT, kw_only=True)
class Moving:
    """Keys of `moving`; each value is a number or a distribution, drawn once for each object.

    speed_m_s: along its own forward axis.
    heading_deg: of that axis at the first frame, to the left of the way the sonar looks.
    turn_deg_s: change of the heading, to the left.
    height_m: above the ground.
    start: place at the first frame.
    path: a CSV file of PATH_COLUMNS, instead of the five keys above; before its first line and
        after its last the object is not there.
    school: several objects that share the motion.
    target_strength: love (Love 1977 for the object's length), material (the reflectivity of its
        class), or dB.
    id: number of its track, the first one of a school; null: the next free number.
    """

    speed_m_s: Speed = number(0.3)
    heading_deg: Angle = parse({"uniform": [-180.0, 180.0]}, -3600.0, 3600.0)
    turn_deg_s: Angle = number(0)
    height_m: Metres = number(0.5)
    start: Start = field(default_factory=Start)
    path: Root | None = None
    school: School | None = None
    target_strength: Literal["love", "material"] | Decibels = "material"
    id: Annotated[int, Field(ge=1, le=9999)] | None = None


@dataclass(frozen=True, config=ConfigDict(**STRICT, serialize_by_alias=True), kw_only=True)
class MovingObject(OwnClass):
    """An entry of `scenes.moving_objects`; see also `OwnClass`.

    object: Fish (a body that bends as it swims) or a built-in object.
    class: null: the name of the object.
    per_place: least and most of them (of a school: of schools) in a recording.
    length_m, body_height, tail_beat_hz: of a fish; body_height is a part of its length.
    moving: see `Moving`.
    """

    label: Annotated[ClassName, Field(alias="class")] = _FISH
    object: Literal["Fish"] | ObjectName = "Fish"
    per_place: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0, le=200)]] = (1, 1)
    length_m: Length = parse({"uniform": [0.2, 0.4]}, 0.005, 15.0)
    body_height: Share = number(0.24)
    tail_beat_hz: Hertz = parse({"uniform": [1.5, 3.0]}, 0.0, 30.0)
    moving: Moving = field(default_factory=Moving)

    def __post_init__(self) -> None:
        least, most = self.per_place
        if least > most:
            raise ValueError("per_place: give the least first, then the most")
        if self.object != _FISH and self.label == _FISH:
            object.__setattr__(self, "label", self.object)
        if self.object != _FISH and self.moving.target_strength == "love":
            raise ValueError(f"moving.target_strength: love is of fish, not of {self.object}")


TRACKS_BYTES = 29_696
"""Size of a value of the column tracks, which lists the moving objects of a frame as JSON."""


def largest_track_bytes(class_name: str) -> int:
    """The longest entry of an object in the column tracks, with the comma behind it."""
    far = -999.9999
    entry = {
        "id": 9999,
        "class": class_name,
        "position_m": [far, far, far],
        "velocity_m_s": [-99.9999, -99.9999, -99.9999],
        "range_m": -far,
        "bearing_deg": -180.123,
        "length_m": 99.9999,
        "body_bearing_deg": -179.99,
        "box": [9999, 9999, 9999, 9999],
        "target_strength_db": -99.99,
        "insonified": 0.123,
        "occluded": 0.123,
    }
    return len(json.dumps(entry, separators=(",", ":"))) + 1


def check_tracks(movers: Sequence[Mover]) -> None:
    """Raise ValueError where the column tracks may not hold all objects of a frame."""
    counts = [mover.most_objects for mover in movers]
    sizes = [largest_track_bytes(mover.class_name) for mover in movers]
    needed_bytes = sum(count * size for count, size in zip(counts, sizes, strict=True))
    if needed_bytes > TRACKS_BYTES:
        raise ValueError(
            f"dataset.columns: tracks hold about {TRACKS_BYTES // max(sizes)} objects per frame, "
            f"and up to {sum(counts)} move; give scenes.moving_objects less per_place or "
            "school.count, or leave tracks out"
        )


class Mover(NamedTuple):
    """An entry of the configuration whose objects move.

    per_place: least and most of them, or of their schools, in a recording.
    """

    class_name: str
    per_place: tuple[int, int]
    moving: Moving

    @property
    def most_objects(self) -> int:
        """The largest number of its objects in a recording."""
        school = self.moving.school
        members = 1 if school is None else round(school.count.largest)
        return self.per_place[1] * members


class Waypoints(NamedTuple):
    """A recorded path: times (N,) s, places (N, 3) m and angles (N, 3) deg, yaw, pitch, roll."""

    time_s: Float64s
    places_m: Float64s
    angles_deg: Float64s


@lru_cache(maxsize=16)
def waypoints(path: Path, key: str) -> Waypoints:
    """Read the waypoints of a path file.

    key: of the configuration, for errors.  Raises FactoryError that names file and line.
    """
    table = number_table(path)
    if table.names != PATH_COLUMNS or len(table.rows) < 2:
        raise FactoryError(
            f"{key}={path}: expected the header {','.join(PATH_COLUMNS)} and two lines or more"
        )
    numbers = np.array(table.rows)
    route = Waypoints(numbers[:, 0], numbers[:, 1:4], numbers[:, 4:])
    _check_waypoints(route, path, table.lines)
    return route


def _check_waypoints(route: Waypoints, path: Path, line_numbers: list[int]) -> None:
    beyond = np.abs(route.places_m).max(axis=1) > FARTHEST_M
    if beyond.any():
        index = int(np.argmax(beyond))
        raise FactoryError(
            f"{path}:{line_numbers[index]}: the path leaves the world, which reaches "
            f"{FARTHEST_M:g} m from the sonar's first place"
        )
    steps_s = np.diff(route.time_s)
    speeds_m_s = np.linalg.norm(np.diff(route.places_m, axis=0), axis=1) / steps_s
    if (speeds_m_s > FASTEST_M_S).any():
        index = int(np.argmax(speeds_m_s > FASTEST_M_S)) + 1
        raise FactoryError(
            f"{path}:{line_numbers[index]}: {speeds_m_s[index - 1]:.3g} m/s since the line before; "
            f"at most {FASTEST_M_S:g} m/s are allowed"
        )


def check_paths(moving: Mapping[str, Moving], duration_s: float | None) -> tuple[str, ...]:
    """The path files of the moving objects.

    duration_s: of the recordings, from their first frame to their last; None where frames have no
        times.
    Raises FactoryError for a file that is damaged, and for a path at no time of the recordings.
    """
    files = []
    for key, item in moving.items():
        if item.path is None:
            continue
        route = waypoints(Path(item.path).expanduser(), f"{key}.moving.path")
        first_s = route.time_s[0]
        last_s = route.time_s[-1]
        if duration_s is not None and (last_s < 0 or first_s > duration_s):
            raise FactoryError(
                f"{key}.moving.path={item.path}: its times, {first_s:g} to {last_s:g} s, lie "
                f"outside the recording, 0 to {duration_s:g} s from the first frame"
            )
        files.append(item.path)
    return tuple(files)


def check_moving(moving: Mapping[str, Moving]) -> None:
    """Raise ValueError where a number of a track is given twice."""
    taken: dict[int, str] = {}
    for key, item in moving.items():
        if item.id is None:
            continue
        if item.id in taken:
            raise ValueError(
                f"{key}.moving.id: {item.id} is the number of {taken[item.id]}, too; "
                "each track has a number of its own"
            )
        taken[item.id] = key
