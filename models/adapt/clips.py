"""Recordings, videos and folders of pictures as grey frames that follow each other in time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
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
    shards = [item for item in items if item.kind == "shard"]
    if shards:
        raise FactoryError(
            f"{shards[0].source}: belongs to a dataset; `simnfnd train` learns from these, and "
            "`simnfnd adapt` from recordings, videos and pictures"
        )
    found = Found()
    files = [_File(item) for item in items if item.kind != "image"]
    folders: dict[Path, list[Item]] = {}
    for item in items:
        if item.kind == "image":
            folders.setdefault(item.source.parent, []).append(item)
    sources: list[_File | _Folder] = [
        *files,
        *(_Folder(folder, pictures) for folder, pictures in folders.items()),
    ]
    pixels = 0
    for source in sources:
        count, size = source.extent(found)
        found.frames += count
        pixels += count * size
    share = min(1.0, most_pixels / max(pixels, 1))
    for source in sources:
        shots = list(source.read(share, geometries, found))
        if shots:
            found.clips.append(Clip(source.name, presented(shots), isinstance(source, _Folder)))
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


class _File:
    """A video or a sonar's recording."""

    def __init__(self, item: Item) -> None:
        self.item, self.name = item, item.source.name
        self._count = 0

    def extent(self, found: Found) -> tuple[int, int]:
        """Number of frames, and pixels of one; notes a file that cannot be read."""
        try:
            with open_recording(self.item.source) as recording:
                self._count = len(recording)
                return self._count, int(np.prod(recording[0].samples.shape[:2]))
        except FactoryError as error:
            found.skipped.append(str(error))
            self._count = 0
            return 0, 0

    def read(self, share: float, geometries: Geometries, found: Found) -> Iterator[Shot]:
        """The chosen frames; the rest after a damaged one is noted and left out."""
        if not self._count:
            return
        with open_recording(self.item.source) as recording:
            try:
                for number in runs(self._count, share):
                    yield self._shot(recording[number], geometries)
            except FrameError as error:
                found.skipped.append(str(error))

    def _shot(self, frame: Frame, geometries: Geometries) -> Shot:
        if frame.beams is not None:
            geometry = polar_geometry(frame.beams, len(frame.samples))
            return Shot(grey_of(frame), geometry)
        if frame.samples.ndim == 2:
            return Shot(grey_of(frame), geometries.of(self.item, frame.samples))
        grey = grey_of_colours(frame.samples)
        return Shot(grey, geometries.of(self.item, grey))


class _Folder:
    """The pictures right in a folder, in the order of their names."""

    def __init__(self, folder: Path, items: list[Item]) -> None:
        self.name = folder.name
        self.items = sorted(items, key=lambda item: natural(item.source))

    def extent(self, found: Found) -> tuple[int, int]:
        """Number of pictures, and pixels of the first that can be read."""
        for item in self.items:
            try:
                return len(self.items), read_grey(item.source).size
            except FactoryError:
                continue  # noted when all are read
        return len(self.items), 0

    def read(self, share: float, geometries: Geometries, found: Found) -> Iterator[Shot]:
        """The chosen pictures; those that cannot be read are noted."""
        for number in runs(len(self.items), share):
            item = self.items[number]
            try:
                grey = read_grey(item.source)
            except FactoryError as error:
                found.skipped.append(str(error))
                continue
            yield Shot(grey, geometries.of(item, grey))
