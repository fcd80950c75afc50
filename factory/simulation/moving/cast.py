"""The moving objects of one recording: drawn once, the same in every process."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from ...common import seeds
from ...common.array_types import Draws, Float64s, Floats
from ...common.errors import FactoryError
from ...dataset.frame_ref import FrameRef
from ...dataset.meaning import class_names
from ..frames.frame import Surroundings
from ..meshes.triangle_mesh import Mesh
from ..scenes.moving import Moving, MovingObject, waypoints
from ..scenes.seabed import OwnObject, RecordingSettings
from .course import Course, Origin, RecordedPath, Swim
from .fish import SwimmingWave, fish_mesh, love_target_strength_db

# How the members of a school differ in length and heading, and drift about their places.
_LENGTH_SPREAD = 0.12
_HEADING_SPREAD_DEG = 6.0
_WANDER_SHARE = 0.25
_WANDER_S = (2.0, 5.0)
_FLATNESS = 0.5
"""Height of a school over its length."""


@dataclass(frozen=True, eq=False)
class Actor:
    """One moving object of a recording.

    number: of its track, unique in the recording.  label: number of its class in `class_names`.
    mesh: at rest, in its own axes (x ahead, y left, z up).  wave: how it bends; None: it is stiff.
    length_m: of a fish.  strength: love, material, or target strength in dB.
    """

    number: int
    label: int
    class_name: str
    mesh: Mesh
    wave: SwimmingWave | None
    course: Course
    length_m: float
    strength: Literal["love", "material"] | float

    @property
    def body_length_m(self) -> float:
        """Extent at rest along its own axis ahead."""
        return self.length_m or float(np.ptp(self.mesh.vertices[:, 0]))

    def target_strength_db(self, frequency_khz: float) -> float | None:
        """Target strength of the whole object, dB; None where its material decides."""
        if self.strength == "material":
            return None
        if self.strength == "love":
            return love_target_strength_db(self.length_m, frequency_khz)
        return float(self.strength)

    def bent(self, rest_m: Floats, time_s: float) -> Float64s:
        """(N, 3) places in its own axes of (N, 3) places at rest."""
        if self.wave is None:
            return np.asarray(rest_m, np.float64)
        return self.wave.bent(rest_m, time_s)


@dataclass(frozen=True, eq=False)
class _Entry:
    """An entry of the configuration.

    key: its name, for errors.  number: of the entry, for random streams.
    """

    key: str
    number: str
    class_name: str
    per_place: tuple[int, int]
    moving: Moving
    fish: MovingObject | None
    kind: str | None
    own_mesh: Mesh | None


def draw_cast(
    settings: RecordingSettings, seed: int, ref: FrameRef, surroundings: Surroundings
) -> tuple[Actor, ...]:
    """The moving objects of the recording that a frame belongs to.

    Raises FactoryError for numbers of tracks that are given twice, and for damaged files.
    """
    origin = Origin(surroundings)
    classes = class_names(settings.own_classes())
    actors: list[Actor] = []
    taken: dict[int, str] = {}
    entries = sorted(_entries(settings), key=lambda entry: entry.moving.id is None)
    for entry in entries:
        rng = seeds.stream(seed, "moving", ref.location, ref.scene, entry.number)
        least, most = entry.per_place
        for _ in range(int(rng.integers(least, most + 1))):
            for actor in _draw_actors(entry, rng, origin, classes.index(entry.class_name)):
                number = _track_number(entry, actor.number, taken)
                taken[number] = entry.key
                actors.append(replace(actor, number=number))
    return tuple(sorted(actors, key=lambda actor: actor.number))


def _entries(settings: RecordingSettings) -> Iterator[_Entry]:
    """The entries of the configuration whose objects move, built-in and own ones alike."""
    for number, item in enumerate(settings.moving_objects):
        is_fish = item.object == "Fish"
        yield _Entry(
            key=f"scenes.moving_objects.{number}",
            number=f"object {number}",
            class_name=item.label,
            per_place=item.per_place,
            moving=item.moving,
            fish=item if is_fish else None,
            kind=None if is_fish else item.object,
            own_mesh=None,
        )
    for number, own in enumerate(settings.own_objects):
        if own.moving is not None:
            yield _own_entry(number, own, own.moving)


def _own_entry(number: int, own: OwnObject, moving: Moving) -> _Entry:
    key = f"scenes.own_objects.{number}"
    return _Entry(
        key=key,
        number=f"own {number}",
        class_name=own.label,
        per_place=own.per_place,
        moving=moving,
        fish=None,
        kind=None,
        own_mesh=own.read(key)[0],
    )


def _track_number(entry: _Entry, member: int, taken: dict[int, str]) -> int:
    """The number that the entry asks for, or the lowest that is free.

    taken: number -> key of the entry that has it.  Raises FactoryError for one that is taken.
    """
    if entry.moving.id is None:
        return next(number for number in range(1, len(taken) + 2) if number not in taken)
    number = entry.moving.id + member
    if number in taken:
        raise FactoryError(
            f"{entry.key}.moving.id: the number {number} of a track is taken by {taken[number]}; "
            "give each object, and each member of a school, a number of its own"
        )
    return number


def _draw_actors(entry: _Entry, rng: Draws, origin: Origin, label: int) -> Iterator[Actor]:
    """Draw one object or the members of one school, numbered from 0."""
    moving = entry.moving
    leader = _motion(moving, rng, origin, entry.key)
    length_m = 0.0
    if entry.fish is not None:
        length_m = entry.fish.length_m.draw(rng)
    count = 1
    if moving.school is not None:
        count = round(moving.school.count.draw(rng))
    for member in range(count):
        own_length_m = length_m
        if count > 1 and entry.fish is not None:
            own_length_m *= float(np.exp(rng.normal(0, _LENGTH_SPREAD)))
        mesh, wave = _shape(entry, rng, own_length_m)
        half_height_m = float(np.ptp(mesh.vertices[:, 2])) / 2
        course = _member_course(leader, moving, rng, half_height_m)
        strength = moving.target_strength
        yield Actor(
            number=member,
            label=label,
            class_name=entry.class_name,
            mesh=mesh,
            wave=wave,
            course=course,
            length_m=own_length_m,
            strength=strength if isinstance(strength, str) else strength.draw(rng),
        )


def _motion(moving: Moving, rng: Draws, origin: Origin, key: str) -> Swim | RecordedPath:
    """Draw the motion of an object, or of the middle of a school."""
    if moving.path is not None:
        file = Path(moving.path).expanduser()
        return RecordedPath(origin, waypoints(file, f"{key}.moving.path"))
    range_m = moving.start.range_m.draw(rng)
    bearing_rad = np.deg2rad(moving.start.bearing_deg.draw(rng))
    return Swim(
        origin=origin,
        x_m=range_m * float(np.cos(bearing_rad)),
        y_m=-range_m * float(np.sin(bearing_rad)),
        heading_rad=float(np.deg2rad(moving.heading_deg.draw(rng))),
        speed_m_s=moving.speed_m_s.draw(rng),
        turn_rad_s=float(np.deg2rad(moving.turn_deg_s.draw(rng))),
        height_m=moving.height_m.draw(rng),
        half_height_m=0.0,
    )


def _member_course(
    leader: Swim | RecordedPath, moving: Moving, rng: Draws, half_height_m: float
) -> Course:
    """Draw the course of one member: that of the leader, moved aside and wandering."""
    spread_m = 0.0
    if moving.school is not None:
        spread_m = moving.school.spread_m.draw(rng)
    ahead, left, up = (spread_m * rng.standard_normal(3)).tolist()
    offset_m = ahead, left, _FLATNESS * up
    if isinstance(leader, RecordedPath):
        return replace(leader, offset_m=offset_m)
    if spread_m == 0:
        return replace(leader, half_height_m=half_height_m)
    turn_rad = np.deg2rad(rng.normal(0, _HEADING_SPREAD_DEG))
    phases = rng.uniform(0, 2 * np.pi, 3).tolist()
    return replace(
        leader,
        heading_rad=leader.heading_rad + float(turn_rad),
        half_height_m=half_height_m,
        offset_m=offset_m,
        wander_m=_WANDER_SHARE * spread_m,
        wander_s=float(rng.uniform(*_WANDER_S)),
        wander_phase_rad=(phases[0], phases[1], phases[2]),
    )


def _shape(entry: _Entry, rng: Draws, length_m: float) -> tuple[Mesh, SwimmingWave | None]:
    """The object at rest, centred at its origin, and the wave of a fish."""
    if entry.fish is not None:
        body_height = entry.fish.body_height.draw(rng)
        beat_hz = entry.fish.tail_beat_hz.draw(rng)
        phase_rad = float(rng.uniform(0, 2 * np.pi))
        return fish_mesh(length_m, body_height), SwimmingWave(length_m, beat_hz, phase_rad)
    if entry.own_mesh is not None:
        return _writable(entry.own_mesh), None
    from ..scenes.seabed.things import drawn_moving_model

    assert entry.kind is not None
    return _writable(_centred(drawn_moving_model(rng, entry.kind))), None


def _centred(solid: Mesh) -> Mesh:
    middle = (solid.vertices.min(axis=0) + solid.vertices.max(axis=0)) / 2
    return solid.moved(-middle)


def _writable(solid: Mesh) -> Mesh:
    """The same mesh in arrays of its own: the compiled z-buffer takes no read-only ones."""
    return replace(solid, triangles=np.array(solid.triangles, np.int32, order="C"))
