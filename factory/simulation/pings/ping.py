"""One ping at a pose: images, points and labels, each made when it is read."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...common.array_types import Array, Float32s, UInt8s, UInt16s
from ...dataset.fan_geometry import FanGeometry
from ...dataset.meaning import class_names
from ..imaging import layers as truth
from ..labels.boxes_column import boxes_row
from ..pairs.pair_maker import ObservedFrame, ObservedSample
from ..pairs.requested_columns import pose_row
from .pose import Pose

_POINT = np.dtype(
    [(axis, "<f4") for axis in "xyz"] + [("strength", "<f4"), ("class", "u1"), ("instance", "<u2")]
)


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
