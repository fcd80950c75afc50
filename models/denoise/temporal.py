"""Pictures with their neighbours in time: averaged (`--frames`), or for weights that see them."""

from __future__ import annotations

import re
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ..data.looks import centred
from ..recordings import Frame
from ..recordings.averaging import Average, Averager, windows
from ..recordings.base import FULL_SCALE
from ..recordings.palettes import SUM, Painted, Palette, find_painted
from ..recordings.pictures import read_picture
from .inputs import Item

MOST_FRAMES = 31

Picture = npt.NDArray[Any]
Place = Callable[[Picture], FanGeometry | None]
"""Where range and bearing are in a picture."""

_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True, eq=False)
class Seen:
    """A picture of a file as weights get it.

    original: as it is stored.  picture: levels, (H, W) float32 in 0..1, where its colours stand for
    such, else the original; averaged as float32 where that is asked for.  geometry: as `Place` says
    of it.  looks: for weights that see several pictures, else none.  frame: of a recording.
    """

    original: Picture
    picture: Picture
    geometry: FanGeometry | None
    looks: list[Picture]
    painted: Painted | None = None
    frame: Frame | None = None

    def finished(self, result: Picture) -> Picture:
        """What weights made of `picture`, in the colours and the dtype of the original."""
        if self.painted is not None:
            return self.painted.repainted(result)
        return in_kind_of(result, self.original)


class Steady:
    """Averages of each picture and its neighbours, or the neighbours themselves.

    frames: how many at most are averaged, odd; 1: pictures stay as they are.
    looks: how many the weights see at once; 1: none beside the picture.
    pictures, used: how many pictures were averaged, and the frames that went into them together.
    maps: colour map -> how many pictures had it.
    """

    def __init__(self, frames: int = 1, items: Iterable[Item] = ()) -> None:
        """items: whose pictures may be neighbours of each other.

        Raises FactoryError for a number of frames that cannot be.
        """
        if not (1 <= frames <= MOST_FRAMES and frames % 2):
            raise FactoryError(
                f"--frames {frames}: give an odd number up to {MOST_FRAMES}: a picture and as "
                "many before it as after it"
            )
        self.frames, self.reach, self.looks = frames, frames // 2, 1
        self._items = tuple(items)
        self.pictures, self.used = 0, 0.0
        self.maps: Counter[str] = Counter()
        self._last_map: Palette | None = None
        self._averager = Averager()
        self._neighbours = neighbours(self._items, self.reach) if self.reach else {}
        self._decoded: OrderedDict[Path, Picture] = OrderedDict()

    def see(self, looks: int) -> None:
        """Give out so many pictures, itself in the middle, beside each.

        Raises FactoryError where they are to be averaged as well.
        """
        if looks == 1:
            return
        if self.reach:
            raise FactoryError(
                f"--frames {self.frames}: these weights see {looks} frames themselves; leave it out"
            )
        self.looks, self.reach = looks, looks // 2
        self._neighbours = neighbours(self._items, self.reach)

    def of_recording(self, frames: Iterable[Frame], place: Place) -> Iterator[Seen]:
        """Each frame of a recording.  place: says where range and bearing are in its levels."""
        coloured: dict[int, tuple[Picture, Painted]] = {}

        def plain() -> Iterator[Frame]:
            for frame in frames:
                painted = None if frame.beams is not None else self._painted(frame.samples)
                if painted is not None:
                    coloured[frame.number] = frame.samples, painted
                    frame = replace(frame, samples=painted.levels)
                yield frame

        self._averager = Averager()
        for own, window in windows(plain(), self.reach):
            frame = window[own]
            original, painted = coloured.pop(frame.number, (frame.samples, None))
            geometry = place(frame.samples)
            if self.frames == 1:
                picture, looks = frame.samples, self._looks(own, [one.samples for one in window])
            else:
                found = {other.number: other.samples for other in window}
                picture, looks = self._average(found, frame.number, geometry), []
            frame = replace(frame, samples=original)
            yield Seen(original, picture, geometry, looks, painted, frame)

    def of_picture(self, item: Item, original: Picture, place: Place) -> Seen:
        """A picture file with those before and after it in its folder; see `of_recording`."""
        painted = self._painted(original)
        plain = original if painted is None else painted.levels
        geometry = place(plain)
        picture, looks = self._with_neighbours(item, plain, geometry)
        return Seen(original, picture, geometry, looks, painted)

    def _with_neighbours(
        self, item: Item, plain: Picture, geometry: FanGeometry | None
    ) -> tuple[Picture, list[Picture]]:
        names = self._neighbours.get(item.source, ())
        if len(names) < 2 or not _is_usable(plain):
            return plain, self._looks(0, [plain])
        found = {item.source: plain}
        for name in names:
            if name != item.source:
                try:
                    found[name] = self._decode(name)
                except FactoryError:
                    continue  # said where it is denoised itself
        if self.frames == 1:
            there = [name for name in names if name in found]
            return plain, self._looks(there.index(item.source), [found[n] for n in there])
        return self._average(found, item.source, geometry), []

    def _painted(self, picture: Picture) -> Painted | None:
        """The levels of a picture whose colours stand for such."""
        painted = find_painted(picture, self._last_map)
        if painted is not None:
            self._last_map = painted.palette
            self.maps[painted.palette.name] += 1
        return painted

    def _looks(self, own: int, pictures: list[Picture]) -> list[Picture]:
        """Number `own` amid its neighbours, as far as they are pictures of the same kind."""
        if self.looks == 1:
            return []
        like, first, last = pictures[own], own, own
        while first > 0 and _is_like(pictures[first - 1], like):
            first -= 1
        while last + 1 < len(pictures) and _is_like(pictures[last + 1], like):
            last += 1
        return centred(pictures[first : last + 1], own - first, self.looks)

    def summary(self) -> Iterator[str]:
        """A line if pictures were averaged, and one if colours stood for levels."""
        if self.maps:
            named = ", ".join(f"{name} in {count}" for name, count in self.maps.items())
            yield (
                f"colour maps: {named}; their levels were denoised and painted again "
                f"({SUM}: a map that is not known, by the sum of its channels)"
            )
        if self.pictures:
            yield (
                f"averaged: {self.used / self.pictures:.1f} of up to {self.frames} frames a "
                "picture; what does not fit or moves is left out"
            )

    def _average(
        self, pictures: dict[Any, Picture], own: Any, geometry: FanGeometry | None
    ) -> Picture:
        picture = pictures[own]
        shape = picture.shape[:2]
        sector = np.ones(shape, bool)
        if geometry is not None:
            sector = geometry.with_size(*shape).maps(0, 0, *shape)["sector"] > 0
        scaled = {
            name: _colours(one).astype(np.float32) / np.float32(FULL_SCALE[str(one.dtype)])
            for name, one in pictures.items()
            if one.shape == picture.shape and one.dtype == picture.dtype and _is_usable(one)
        }
        average: Average = self._averager(own, scaled, sector)
        self.pictures += 1
        self.used += average.frames
        if picture.ndim == 2:
            return average.picture
        full = np.float32(FULL_SCALE[str(picture.dtype)])
        whole: Picture = picture.astype(np.float32) / full
        whole[..., : average.picture.shape[2]] = average.picture
        return whole

    def _decode(self, path: Path) -> Picture:
        if path not in self._decoded:
            picture = read_picture(path)
            painted = find_painted(picture, self._last_map)
            self._decoded[path] = picture if painted is None else painted.levels
        self._decoded.move_to_end(path)
        while len(self._decoded) > max(self.frames, self.looks):
            self._decoded.popitem(last=False)
        return self._decoded[path]


def in_kind_of(result: Picture, picture: Picture) -> Picture:
    """float32 in 0..1 as the dtype of `picture`; what has it already stays."""
    if result.dtype == picture.dtype:
        return result
    full = FULL_SCALE[str(picture.dtype)]
    return np.asarray(np.rint(result.astype(np.float64) * full).astype(picture.dtype))


def neighbours(items: Iterable[Item], reach: int) -> dict[Path, tuple[Path, ...]]:
    """Picture file -> it and up to `reach` before and after it in its sequence.

    A sequence is the pictures of a folder whose names differ in their last number alone.
    """
    sequences: dict[tuple[Path, str, str], list[tuple[int, Path]]] = {}
    for item in items:
        if item.kind == "image":
            numbers = list(_NUMBER.finditer(item.source.name))
            if numbers:
                last = numbers[-1]
                before, after = item.source.name[: last.start()], item.source.name[last.end() :]
                key = item.source.parent, before, after
                sequences.setdefault(key, []).append((int(last[0]), item.source))
    found = {}
    for sequence in sequences.values():
        paths = [path for _, path in sorted(sequence)]
        for own, window in windows(paths, reach):
            found[window[own]] = tuple(window)
    return found


def _is_usable(picture: Picture) -> bool:
    """Whether its grey values are known; who denoises it says what is wrong with others."""
    if picture.dtype == np.float32:
        return bool(picture.min() >= 0 and picture.max() <= 1)
    return str(picture.dtype) in FULL_SCALE


def _is_like(picture: Picture, other: Picture) -> bool:
    same = picture.shape == other.shape and picture.dtype == other.dtype
    return same and _is_usable(picture)


def _colours(picture: Picture) -> Picture:
    """Without the alpha channel."""
    if picture.ndim == 2:
        return picture
    return picture[..., : 3 if picture.shape[2] in (3, 4) else 1]
