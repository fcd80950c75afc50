"""Images of all inputs as a detector sees them, one after another, with where they come from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Array, UInt8s
from ...factory.common.errors import FactoryError, FrameError
from ...factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from ..recordings import SonarFrame, open_recording
from ..recordings.base import FULL_SCALE, white_of
from ..recordings.images import read_image
from ..recordings.inputs import Geometries, InputFile
from ..recordings.palettes import grey_of_colours
from ..recordings.views import fan_of, white_of_recording

FindGeometry = Callable[[Array], FanGeometry | None]


@dataclass(frozen=True, eq=False)
class ShownFrame:
    """A frame as people look at it.

    number: counts from 0.  time_s: as of `SonarFrame`.  image: (H, W) uint8, of a ping a fan.
    geometry: where range and bearing lie in it; None where that is not known.
    """

    number: int
    image: UInt8s
    geometry: FanGeometry | None = None
    time_s: float | None = None

    @property
    def facts(self) -> FrameFacts:
        """The frame without its image."""
        return FrameFacts(self.number, self.time_s, self.geometry)


class FrameFacts(NamedTuple):
    """What is kept of a frame without its image."""

    number: int
    time_s: float | None
    geometry: FanGeometry | None


def shown_frame(
    frame: SonarFrame, find_geometry: FindGeometry, *, white: float = 0.0
) -> ShownFrame:
    """A frame of a recording as people look at it.

    find_geometry: of the samples, where the frame states none.  white: of samples of 16 bits of the
    recording; at least that of the frame.  Raises FrameError for NaN.
    """
    if not np.isfinite(frame.samples).all():
        raise FrameError(f"frame {frame.number} has NaN or infinite pixels")
    grey = frame.samples.astype(np.float32) / np.float32(max(white, white_of(frame.samples)))
    geometry = frame.geometry
    if frame.beams is not None:
        grey, geometry = fan_of(grey, frame.beams)
    elif geometry is None:
        geometry = find_geometry(frame.samples)
    if grey.ndim == 3:
        grey = grey_of_colours(grey)
    image = np.rint(255 * np.clip(grey, 0, 1)).astype(np.uint8)
    return ShownFrame(frame.number, image, geometry, frame.time_s)


def frames_of(
    item: InputFile, geometries: Geometries, topics: Sequence[str]
) -> Iterator[ShownFrame]:
    """The frames of an input: an image file has one.  Raises FactoryError where it is damaged."""
    if item.kind == "shard":
        yield from _shard_frames(item)
        return
    if item.kind == "images":
        frame = SonarFrame(0, read_image(item.source))
        yield shown_frame(frame, partial(geometries.of, item))
        return
    with open_recording(item.source, topics) as recording:
        white = 0.0
        for frame in recording:
            if frame.samples.dtype == np.uint16 and not white:
                white = white_of_recording(item.source)
            find = partial(geometries.of, item, sequence=frame.sequence)
            try:
                yield shown_frame(frame, find, white=white)
            except FrameError as error:
                raise FrameError(f"{item.source}: {error}") from error


def _shard_frames(item: InputFile) -> Iterator[ShownFrame]:
    """The noisy images of a shard of a dataset."""
    from ...factory.dataset.layout import config_of
    from ...factory.dataset.reader import ImageStack, open_shard, value_range

    try:
        source = open_shard(item.source)
    except (OSError, FactoryError) as error:
        raise FrameError(f"{item.source}: no shard of a dataset, or a damaged one") from error
    with source:
        sonar = recorded_sonar(config_of(source))
        table = source["meta"][()]
        stack = ImageStack(source["noisy"])
        for row, record in enumerate(table):
            image = stack[row] * (FULL_SCALE["uint8"] / value_range(source))
            geometry = None if sonar is None else FanGeometry.from_record(sonar, record)
            time_s = float(record["time_s"]) if "time_s" in (table.dtype.names or ()) else None
            yield ShownFrame(row, np.rint(image).astype(np.uint8), geometry, time_s)
