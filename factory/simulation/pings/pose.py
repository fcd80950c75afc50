"""Where a sonar is asked to ping."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from ...common.errors import FactoryError
from ..meshes.camera import MOVEMENT


@dataclass(frozen=True)
class Pose:
    """Where a sonar's camera is and how it is turned.

    In procedural places, as a line of `scenes.path`, from the scene's first pose on: surge_m is
    forward, sway_m to the left, heave_m up; yaw_deg turns left, pitch_deg looks down, roll_deg
    lowers the right side.
    In meshes, as a line of `scenes.poses`, in axes of `scenes.poses_frame`: position_m (x, y, z)
    and quaternion (x, y, z, w), camera to world.
    Raises FactoryError for numbers that are not finite, and a quaternion that is no rotation.
    """

    surge_m: float = 0.0
    sway_m: float = 0.0
    heave_m: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    position_m: tuple[float, float, float] | None = None
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        """Refuse what is no pose."""
        for item in fields(self):
            value = getattr(self, item.name)
            try:
                is_finite = value is None or bool(np.isfinite(np.asarray(value, float)).all())
            except (TypeError, ValueError):
                is_finite = False
            if not is_finite:
                raise FactoryError(f"pose: {item.name}={value!r} is no finite number")
        if self.position_m is not None and len(self.position_m) != 3:
            raise FactoryError("pose: position_m has three numbers: x, y, z")
        if len(self.quaternion) != 4 or not any(self.quaternion):
            raise FactoryError("pose: quaternion is no rotation; give x, y, z, w")

    @property
    def movement(self) -> dict[str, float]:
        """The columns of a line of `scenes.path`."""
        return {name: float(getattr(self, name)) for name in MOVEMENT}


def checked_index(index: int) -> int:
    """The number of a ping.  Raises FactoryError for what is none."""
    if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < 10**9:
        raise FactoryError(f"index={index!r}: expected a whole number, 0 or more")
    return index


def checked_time_s(time_s: float) -> float:
    """The time of a ping.  Raises FactoryError for what is none."""
    if not isinstance(time_s, int | float) or not math.isfinite(time_s) or time_s < 0:
        raise FactoryError(f"time_s={time_s!r}: expected seconds from the beginning of the scene")
    return float(time_s)
