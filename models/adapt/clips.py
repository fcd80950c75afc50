"""Recordings, videos and folders of pictures as grey frames that follow each other in time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError, FrameError
from ...factory.sonar.geometry import FanGeometry
from ..data.pairs import Image
from ..denoise.geometries import Geometries
from ..denoise.inputs import Item, find_items
from ..recordings import Frame, open_recording
from ..recordings.fan.pings import grey_of, polar_geometry
from ..recordings.palettes import grey_of_colours
from ..recordings.pictures import read_grey
from ..recordings.presentation import presentation_of

RUN = 16
"""So many frames that follow each other are read together where not all can be."""
MOST_PIXELS = 80_000_000
"""Of all frames together: what fits into a gigabyte with all that is made of them."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame: (H, W) float32 in 0..1, and where range and bearing are, if that is known."""

    grey: Image
    geometry: FanGeometry | None = None

    @property
    def sector(self) -> npt.NDArray[np.bool_]:
        """(H, W) bool: what the sonar measured; all where that is not known."""
        shape = self.grey.shape
        if self.geometry is None:
            return np.ones(shape, bool)
        return self.geometry.maps(0, 0, *shape)["sector"] > 0


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames in the order of time.  shuffled: as far as their names tell; they may be anything."""

    name: str
    shots: list[Shot]
    shuffled: bool = False


@dataclass
class Found:
    """What was read.  frames: how many there were.  skipped: a line for each that was not read."""

    clips: list[Clip] = field(default_factory=list)
    frames: int = 0
    skipped: list[str] = field(default_factory=list)


def read_clips(
    paths: Sequence[Path], out: Path, geometries: Geometries, most_pixels: int = MOST_PIXELS
) -> Found:
    """The frames of files, and of all files below folders but those below `out`.

    Where these have more than `most_pixels`, runs of frames that follow each other are taken,
    evenly spread.
    Raises FactoryError when there are none.
    """
    items = find_items(paths, out)
    if shard := next((item for item in items if item.kind == "shard"), None):
        raise FactoryError(
            f"{shard.source}: belongs to a dataset; `simnfnd train` learns from these, and "
            "`simnfnd adapt` from recordings, videos and pictures"
        )
    found = Found()
    # Each a recording, or the pictures right in a folder by their names.
    sources = [[item] for item in items if item.kind != "image"]
    pictures = [item for item in items if item.kind == "image"]
    pictures.sort(key=lambda item: (item.source.parent, natural(item.source)))
    sources += [list(part) for _, part in groupby(pictures, lambda item: item.source.parent)]
    extents = [_extent(source, found) for source in sources]
    found.frames = sum(count for count, _ in extents)
    share = min(1.0, most_pixels / max(sum(count * size for count, size in extents), 1))
    for source, (count, _) in zip(sources, extents, strict=True):
        is_folder = source[0].kind == "image"
        read = _pictures if is_folder else _frames
        shots = list(read(source, runs(count, share), geometries, found)) if count else []
        if shots:
            path = source[0].source
            name = path.parent.name if is_folder else path.name
            found.clips.append(Clip(name, presented(shots), is_folder))
    if not found.clips:
        more = f" ({found.skipped[0]})" if found.skipped else ""
        raise FactoryError(f"{paths[0]}: no frame can be read{more}")
    return found


def presented(shots: list[Shot]) -> list[Shot]:
    """Frames of a clip as denoisers show them to the weights, all with one gain."""
    found = [presentation_of(shot.grey, shot.geometry) for shot in shots]
    gain = min(one.gain for one in found)
    ways = [replace(one, gain=gain) for one in found]
    return [Shot(way.shown(shot.grey), way.geometry) for way, shot in zip(ways, shots, strict=True)]


def runs(count: int, share: float) -> list[int]:
    """Numbers of about `share` of `count` frames: whole runs of `RUN`, evenly spread."""
    if share >= 1:
        return list(range(count))
    total = -(-count // RUN)
    kept = max(1, int(share * total))
    first = [number * total // kept for number in range(kept)]
    return [frame for run in first for frame in range(run * RUN, min(run * RUN + RUN, count))]


def natural(path: Path) -> list[tuple[int, str]]:
    """Sorts names as people do: frame 2 before frame 10."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _extent(source: list[Item], found: Found) -> tuple[int, int]:
    """Number of frames, and pixels of one; notes a recording that cannot be read."""
    if source[0].kind == "image":
        for item in source:
            try:
                return len(source), read_grey(item.source).size
            except FactoryError:
                continue  # noted when all are read
        return len(source), 0
    try:
        with open_recording(source[0].source) as recording:
            return len(recording), int(np.prod(recording[0].samples.shape[:2]))
    except FactoryError as error:
        found.skipped.append(str(error))
        return 0, 0


def _frames(
    source: list[Item], numbers: list[int], geometries: Geometries, found: Found
) -> Iterator[Shot]:
    """Frames of a recording; the rest after a damaged one is noted and left out."""
    with open_recording(source[0].source) as recording:
        try:
            for number in numbers:
                yield _shot(recording[number], source[0], geometries)
        except FrameError as error:
            found.skipped.append(str(error))


def _shot(frame: Frame, item: Item, geometries: Geometries) -> Shot:
    if frame.beams is not None:
        return Shot(grey_of(frame), polar_geometry(frame.beams, len(frame.samples)))
    if frame.samples.ndim == 2:
        return Shot(grey_of(frame), geometries.of(item, frame.samples))
    grey = grey_of_colours(frame.samples)
    return Shot(grey, geometries.of(item, grey))


def _pictures(
    source: list[Item], numbers: list[int], geometries: Geometries, found: Found
) -> Iterator[Shot]:
    """Pictures of a folder; those that cannot be read are noted."""
    for number in numbers:
        try:
            grey = read_grey(source[number].source)
        except FactoryError as error:
            found.skipped.append(str(error))
            continue
        yield Shot(grey, geometries.of(source[number], grey))
