"""Frames of one recording as shots of a sequence: what the command and a live stream share."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from ...factory.common.array_types import Array
from ...factory.dataset.fan_geometry import FanGeometry
from ..recordings.base import SonarFrame
from ..recordings.device_settings import settings_of
from ..recordings.views import polar_geometry
from .images import Denoising
from .temporal.stream import SequenceFrame


class FrameShots:
    """Turns the frames of a recording into shots, in order.

    previous: the last frame of each sequence, see `SonarFrame`.
    """

    def __init__(
        self, denoising: Denoising, find_geometry: Callable[[Array, str], FanGeometry | None]
    ) -> None:
        """find_geometry: of an image, given its `SonarFrame.sequence`; called in order."""
        self._denoising = denoising
        self._find_geometry = find_geometry
        self.previous: dict[str, SonarFrame] = {}

    def __call__(self, frame: SonarFrame) -> SequenceFrame:
        """The shot of the next frame.  Raises ValueError as `Denoising.shot` does."""
        shift_px = _turned_px(frame, self.previous.get(frame.sequence))
        shot = self._denoising.shot(
            frame,
            frame.samples,
            partial(self._geometry, frame),
            shift_px,
            is_tracked=True,
            settings=settings_of(frame),
        )
        self.previous[frame.sequence] = frame
        return shot

    def _geometry(self, frame: SonarFrame, image: Array) -> FanGeometry | None:
        if frame.beams is not None:
            return polar_geometry(frame.beams, len(image))
        return frame.geometry or self._find_geometry(image, frame.sequence)


def _turned_px(frame: SonarFrame, previous: SonarFrame | None) -> tuple[float, float] | None:
    """How far a scene moved across the beams since the previous frame, by the compass."""
    heading_deg = frame.pose.heading_deg
    previous_deg = previous.pose.heading_deg if previous is not None else None
    if heading_deg is None or previous_deg is None or frame.beams is None:
        return None
    azimuths = frame.beams.azimuths_rad
    turned_deg = (heading_deg - previous_deg + 180) % 360 - 180
    spacing = (azimuths[-1] - azimuths[0]) / (len(azimuths) - 1)
    return -math.radians(turned_deg) / spacing, 0.0
