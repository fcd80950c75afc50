"""Pings of a sonar at poses that the caller chooses; an image is made when it is read."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from ...common.array_types import Array, Float32s, UInt8s, UInt16s
from ...common.errors import FactoryError
from ...dataset.fan_geometry import FanGeometry
from ...dataset.meaning import class_names
from ..imaging import layers as truth
from ..labels.boxes_column import boxes_row
from .pair_maker import ObservedFrame, ObservedSample
from .requested_columns import pose_row

_POINT = np.dtype(
    [(axis, "<f4") for axis in "xyz"] + [("strength", "<f4"), ("class", "u1"), ("instance", "<u2")]
)


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
        names = ("surge_m", "sway_m", "heave_m", "roll_deg", "pitch_deg", "yaw_deg")
        return {name: float(getattr(self, name)) for name in names}


@dataclass(frozen=True, eq=False)
class PingLabels:
    """What each pixel of a ping shows, in the layout of its images.

    segmentation: (H, W) uint8 class.  instance: (H, W) uint16 number of the object, 0 for none.
    """

    segmentation: UInt8s
    instance: UInt16s


class Ping:
    """One ping at a pose.  What is read is made then, and kept.

    pose: as it was asked for.  index, time_s: of the ping.
    """

    def __init__(
        self,
        pose: Pose,
        index: int,
        time_s: float,
        sample: ObservedSample,
        observe_with_boxes: Callable[[], ObservedFrame],
    ) -> None:
        """sample: of the frame at the pose.  observe_with_boxes: observes the same with boxes."""
        self.pose = pose
        self.index = index
        self.time_s = time_s
        self._sample = sample
        self._observe_with_boxes = observe_with_boxes

    @property
    def noisy(self) -> Array:
        """(H, W) uint8 the image as the device shows it, in the layout of `sonar.image`."""
        return self._sample.noisy

    @property
    def clean(self) -> Array:
        """(H, W) the same without noise."""
        return self._sample.clean

    @cached_property
    def fan(self) -> Array:
        """(H', W') the noisy image as a fan."""
        return self._sample.image_as("fan")

    @property
    def polar(self) -> Array:
        """(range_bins, beams) the noisy image, nearest range first."""
        return self._sample.image_as("polar")

    @cached_property
    def geometry(self) -> FanGeometry:
        """Where range and bearing are in `noisy` and `clean`."""
        return self._sample.geometry()

    @cached_property
    def points(self) -> Array:
        """(N,) points of the bins that echo, with fields x, y, z, strength, class and instance.

        Metres in the sonar's axes (x ahead, y left, z up) at the strongest echo of each bin;
        strength is the received level, dB re 1 uPa.
        """
        observed = self._sample.observed
        names = ("range", "azimuth", "elevation", "segmentation")
        layers = truth.layer_images(names, observed.lit)
        strength = self._sample.measured(("intensity_db",))["intensity_db"]
        is_heard = np.isfinite(layers["range"]) & np.isfinite(strength)
        range_m, azimuth_rad, elevation_rad = (layers[name][is_heard] for name in names[:3])
        ground_m = range_m * np.cos(elevation_rad)
        points = np.empty(len(range_m), _POINT)
        points["x"] = ground_m * np.cos(azimuth_rad)
        points["y"] = -ground_m * np.sin(azimuth_rad)
        points["z"] = range_m * np.sin(elevation_rad)
        points["strength"] = strength[is_heard]
        points["class"] = layers["segmentation"][is_heard]
        points["instance"] = layers["instance"][is_heard]
        return points

    @cached_property
    def labels(self) -> PingLabels:
        """Class and object of each pixel."""
        layers = self._sample.observed.surface_layers(("segmentation",))
        return PingLabels(layers["segmentation"], layers["instance"])

    @cached_property
    def elevation(self) -> Float32s:
        """(H, W) elevation of the strongest echo of each pixel, radians; NaN where nothing is."""
        return np.asarray(self._sample.observed.surface_layers(("elevation",))["elevation"])

    @cached_property
    def boxes(self) -> list[dict[str, Any]]:
        """The objects in sight, as column `boxes` of datasets has them."""
        observed = self._observe_with_boxes()
        classes = class_names(observed.config.scenes.own_classes())
        boxes: list[dict[str, Any]] = json.loads(str(boxes_row(observed.lit, classes)["boxes"]))
        return boxes

    @cached_property
    def world(self) -> dict[str, float | int | str]:
        """Position and quaternion of camera and sonar in the world, as column `pose` has them."""
        observed = self._sample.observed
        return dict(pose_row(observed.lit.frame, observed.config.sonar.mount))


def checked_index(index: int) -> int:
    """The number of a ping.  Raises FactoryError for what is none."""
    if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index <= 9999:
        raise FactoryError(f"index={index!r}: expected a whole number from 0 to 9999")
    return index


def checked_time_s(time_s: float) -> float:
    """The time of a ping.  Raises FactoryError for what is none."""
    if not isinstance(time_s, int | float) or not math.isfinite(time_s) or time_s < 0:
        raise FactoryError(f"time_s={time_s!r}: expected seconds from the beginning of the scene")
    return float(time_s)
