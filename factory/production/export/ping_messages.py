"""The messages of simulated pings for ROS 2, in a file or live."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ...common.errors import FactoryError
from ...common.ros_types import SONAR
from ...dataset.fan_geometry import recorded_sonar
from ...simulation.pings.ping import Ping
from ...simulation.pings.sonar import Sonar
from .ros_messages import (
    IMAGE,
    PING_FRAME,
    POINTS,
    POSE,
    SONAR_FRAME,
    STATIC,
    TRANSFORMS,
    cloud_message,
    image_message,
    ping_axes,
    ping_facts,
    ping_message,
    polar_grid,
    pose_message,
    stamp_at,
    transform,
)


class PingMessages:
    """Makes the messages of a sonar's pings.

    types: classes of messages by their names.  only_images: leave out points and labels, which take
    as long as the image.
    """

    def __init__(
        self, sonar: Sonar, types: Mapping[str, Any], *, only_images: bool = False
    ) -> None:
        config = sonar.configuration
        device = recorded_sonar(config)
        if device is None:
            raise FactoryError("sonar.projection: pings of ROS have slant ranges; leave it out")
        self._device = device
        self._facts = ping_facts(config, device)
        self._types = types
        self._only_images = only_images

    def of(self, ping: Ping, time_s: float) -> Iterator[tuple[str, str, Any]]:
        """Topic, type and content of each message of a ping; time_s: since 1970."""
        types = self._types
        stamp = stamp_at(time_s, types)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=PING_FRAME)
        yield STATIC, TRANSFORMS, ping_axes(stamp, types)
        grid = polar_grid(self._device, ping.geometry)
        message = ping_message(
            ping.polar, grid, header, 1000 * self._device.frequency_khz, self._facts, types
        )
        yield "/sonar/noisy", SONAR, message
        yield "/sonar/noisy/image", IMAGE, image_message(ping.fan, header, types)
        pose = pose_message(ping.world, stamp, types)
        assert pose is not None  # every ping has a pose
        yield "/sonar/pose", POSE, pose
        yield "/tf", TRANSFORMS, transform(pose.pose, stamp, types)
        if self._only_images:
            return
        of_sonar = types["std_msgs/msg/Header"](stamp=stamp, frame_id=SONAR_FRAME)
        yield "/sonar/points", POINTS, cloud_message(ping.points, of_sonar, types)
        labels = image_message(ping.labels.segmentation, header, types)
        yield "/sonar/labels", IMAGE, labels
