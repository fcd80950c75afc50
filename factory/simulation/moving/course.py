"""Where a moving object is at any time: a function of the time alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ...common.array_types import Float64s
from ..frames.frame import Surroundings
from ..meshes.triangle_mesh import rotation
from ..scenes.moving import Waypoints

_STRAIGHT_RAD_S = 1e-6  # an object that turns less goes straight
_CLEAR_M = 0.02  # between an object and the ground
_STEP_S = 0.01  # between two places that give a velocity


class Placement(NamedTuple):
    """Where an object is and how it is turned.

    position_m: (3,) in world axes.  world_from_own: (3, 3), own axes x ahead, y left, z up.
    """

    position_m: Float64s
    world_from_own: Float64s


class Origin:
    """The axes of a recording: the sonar at the first frame, x where it looks, level, z up."""

    def __init__(self, surroundings: Surroundings) -> None:
        pose = surroundings.world_from_start
        ahead = pose[:2, 2]
        self.heading_rad = float(np.arctan2(ahead[1], ahead[0]))
        self.position_m = pose[:3, 3].copy()
        self.rotation = rotation("z", self.heading_rad)
        self._surroundings = surroundings

    def world_m(self, x: float, y: float) -> Float64s:
        """(2,) a level place in world axes."""
        turned: Float64s = (self.rotation[:2, :2] * (x, y)).sum(axis=1)
        return turned + self.position_m[:2]

    def ground_m(self, x: float, y: float) -> float:
        """Height of the ground at a world place; of the nearest one where it is not known."""
        ground = self._surroundings.ground_m
        step_m = self._surroundings.step_m
        middle = (len(ground) - 1) / 2
        last = len(ground) - 1.001
        column = min(max((x - self.position_m[0]) / step_m + middle, 0.0), last)
        row = min(max((y - self.position_m[1]) / step_m + middle, 0.0), last)
        left = int(column)
        top = int(row)
        right_share = column - left
        lower_share = row - top
        cell = ground[top : top + 2, left : left + 2].astype(np.float64)
        upper = cell[0, 0] + right_share * (cell[0, 1] - cell[0, 0])
        lower = cell[1, 0] + right_share * (cell[1, 1] - cell[1, 0])
        return float(upper + lower_share * (lower - upper))


class Course(Protocol):
    """The course of an object: its placement at any time."""

    def at(self, time_s: float) -> Placement | None:
        """Placement of the object at a time; None while it is not there."""


@dataclass(frozen=True)
class Swim:
    """A way over the ground at one height, speed and rate of turn.

    x_m, y_m: place at time 0, in the axes of `origin`.  heading_rad: at time 0.
    height_m: of its middle above the ground.  half_height_m: of the object.
    offset_m: (3,) place within its school: ahead, left, up.
    wander_m, wander_s, wander_phase_rad: it drifts about that place and back.
    """

    origin: Origin
    x_m: float
    y_m: float
    heading_rad: float
    speed_m_s: float
    turn_rad_s: float
    height_m: float
    half_height_m: float
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wander_m: float = 0.0
    wander_s: float = 1.0
    wander_phase_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time_s: float) -> Placement:
        """See `Course`."""
        heading = self.heading_rad + self.turn_rad_s * time_s
        x, y = self._middle(time_s)
        turns = 2 * np.pi * time_s / self.wander_s
        ahead, left, up = (
            offset + self.wander_m * np.sin(turns + phase)
            for offset, phase in zip(self.offset_m, self.wander_phase_rad, strict=True)
        )
        x += ahead * np.cos(heading) - left * np.sin(heading)
        y += ahead * np.sin(heading) + left * np.cos(heading)
        world_x, world_y = self.origin.world_m(x, y).tolist()
        lowest = self.half_height_m + _CLEAR_M
        z = self.origin.ground_m(world_x, world_y) + max(self.height_m + up, lowest)
        turn = rotation("z", self.origin.heading_rad + heading)
        return Placement(np.array([world_x, world_y, z]), turn)

    def _middle(self, time_s: float) -> tuple[float, float]:
        """The place of the school's middle on a circle, or on a straight line."""
        if abs(self.turn_rad_s) < _STRAIGHT_RAD_S:
            way_m = self.speed_m_s * time_s
            return (
                self.x_m + way_m * float(np.cos(self.heading_rad)),
                self.y_m + way_m * float(np.sin(self.heading_rad)),
            )
        radius_m = self.speed_m_s / self.turn_rad_s
        heading = self.heading_rad + self.turn_rad_s * time_s
        return (
            self.x_m + radius_m * float(np.sin(heading) - np.sin(self.heading_rad)),
            self.y_m - radius_m * float(np.cos(heading) - np.cos(self.heading_rad)),
        )


@dataclass(frozen=True)
class RecordedPath:
    """The way that a file gives, straight from line to line, in the axes of `origin`.

    offset_m: (3,) place within its school: ahead, left, up.
    """

    origin: Origin
    waypoints: Waypoints
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time_s: float) -> Placement | None:
        """See `Course`."""
        times_s, places_m, angles_deg = self.waypoints
        if not times_s[0] <= time_s <= times_s[-1]:
            return None
        place_m = np.array([np.interp(time_s, times_s, axis) for axis in places_m.T])
        angles_rad = np.unwrap(np.deg2rad(angles_deg), axis=0)
        yaw, pitch, roll = (float(np.interp(time_s, times_s, axis)) for axis in angles_rad.T)
        # Yaw turns left, pitch looks down, roll lowers the right side, as of `scenes.path`.
        path_from_object = rotation("zyx", yaw, pitch, roll)

        # Sums instead of matrix products, whose rounding depends on the processor.
        world_from_path = self.origin.rotation
        place_m = place_m + (path_from_object * np.asarray(self.offset_m)).sum(axis=1)
        place_in_world_m = (world_from_path * place_m).sum(axis=1) + self.origin.position_m
        world_from_object = (world_from_path[:, :, None] * path_from_object[None]).sum(axis=1)
        return Placement(place_in_world_m, world_from_object)


def velocity_m_s(course: Course, time_s: float) -> Float64s:
    """(3,) over ground, in world axes; NaN where the object is not there just before or after."""
    before = course.at(time_s - _STEP_S)
    after = course.at(time_s + _STEP_S)
    now = course.at(time_s)
    first = before or now
    last = after or now
    if first is None or last is None:
        return np.full(3, np.nan)
    span_s = _STEP_S * ((before is not None) + (after is not None))
    return np.asarray((last.position_m - first.position_m) / max(span_s, _STEP_S))
