"""Denoising of bags of ROS: the same bag, with the pictures of some topics denoised."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy.typing as npt

from ...factory.errors import FactoryError, FrameError
from ...factory.sonar.geometry import FanGeometry
from ..recordings import Frame
from ..recordings.base import Samples
from ..recordings.fan.pings import fan_of, grey_of, polar_geometry
from ..recordings.ros_messages import SONAR
from ..recordings.rosbag import RosBag
from .files import (
    COMPARED,
    Denoise,
    Find,
    Tick,
    denoise_image,
    write_compared,
)
from .inputs import Item
from .temporal import Steady


def open_bag(item: Item, topics: Sequence[str]) -> RosBag:
    """The bag of an item.  Raises FrameError when it cannot be read or has no such topics."""
    try:
        return RosBag(item.source, topics)
    except FactoryError as error:
        raise FrameError(str(error)) from error


def denoise_bag(
    item: Item,
    out: Path,
    denoise: Denoise,
    geometry_of: Find,
    *,
    topics: Sequence[str],
    compare: bool,
    tick: Tick,
    steady: Steady | None = None,
) -> str:
    """Denoise a bag into `out`: same topics and stamps, other topics copied.

    topics: which to denoise; without, as `RosBag` says.  Returns a warning, mostly empty.
    Raises FrameError when the bag cannot be read, or a folder of its name is there already, and
    when frames of several topics were to be averaged with each other.
    """
    shown: list[tuple[npt.NDArray[Any], npt.NDArray[Any]]] = []
    averages = steady or Steady()

    def place(picture: npt.NDArray[Any]) -> FanGeometry | None:
        return geometry_of(item, picture)

    def denoised(bag: RosBag) -> Iterator[Samples]:
        pings = any(one.msgtype == SONAR for one in bag.connections)
        # All of a ping was measured, so no place is needed to average.
        averaged = averages.of_recording(bag, (lambda _: None) if pings else place)
        for seen in averaged:
            frame = seen.frame
            assert frame is not None
            geometry = seen.geometry
            if frame.beams is not None:
                geometry = polar_geometry(frame.beams, len(frame.samples))
            try:
                found = denoise_image(seen.picture, denoise, geometry, seen.looks)
                samples = seen.finished(found)
            except ValueError as error:
                raise FrameError(f"{item.source}: message {frame.number}: {error}") from error
            if compare and frame.number < COMPARED:
                shown.append((_shown(frame), _shown(replace(frame, samples=samples))))
            yield samples
            tick()

    path = out / item.relative
    if path.is_dir():
        raise FrameError(f"{path}: is there already; remove it, or give another --out")
    with open_bag(item, topics) as bag:
        if averages.reach and len(bag.topics) > 1:
            what = "--frames averages" if averages.frames > 1 else "these weights see the frames of"
            raise FrameError(
                f"{item.source}: {what} one topic; choose of {', '.join(bag.topics)} with --topic"
            )
        bag.rewrite(denoised(bag), path)
        warning = bag.warning
    if shown:
        write_compared(out, item.relative, shown)
    return warning


def _shown(frame: Frame) -> npt.NDArray[Any]:
    return frame.samples if frame.beams is None else fan_of(grey_of(frame), frame.beams)[0]
