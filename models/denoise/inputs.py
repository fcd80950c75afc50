"""What `simnfnd denoise` is given: files, where range and bearing lie in them, what is done."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...factory.sonar.geometry import FanGeometry
from ..data.fans import read_fans
from ..recordings import PICTURE_SUFFIXES, READERS, SEQUENCES, is_bag_folder, kind_of
from ..recordings.fan_finder import find_geometry
from ..recordings.pictures import is_table

PING_KINDS = ("aris", "ddf", "oculus")
"""Recordings (`simnfnd.models.recordings`) whose frames are pings, not pictures."""
HDF5_SUFFIXES = (".h5", ".hdf5")
SUFFIXES = (
    *PICTURE_SUFFIXES,
    *HDF5_SUFFIXES,
    *(
        suffix
        for kind in ("video", "stack", "array", "rosbag", *PING_KINDS)
        for suffix in READERS[kind][1]
    ),
)

FIND, POLAR, NONE = "find", "polar", "none"
NAME = ".denoise-stopped.json"
"""In the output folder, of a run that was stopped."""
_LAST_NUMBER = re.compile(r"(|.*\D)(\d+)(\D*)", re.DOTALL)


@dataclass(frozen=True)
class Item:
    """One input file (or a folder that is a bag) and its name below the output folder.

    checked: a shard that another process has opened without harm.
    whole_name: whether its sheet to compare by keeps its suffix, as another has its name without.
    """

    source: Path
    relative: Path
    checked: bool = False
    whole_name: bool = False

    @property
    def compared(self) -> Path:
        """Name of the sheet to compare by, below the output folder."""
        if self.whole_name:
            return Path("compare") / f"{self.relative}.png"
        return Path("compare") / self.relative.with_suffix(".png")

    @cached_property
    def kind(self) -> Literal["image", "shard", "video", "pings", "bag"]:
        """By the suffix of its name; a file of several pictures (TIFF, arrays) is a `video`."""
        suffix = self.source.suffix.lower()
        if self.checked or suffix in HDF5_SUFFIXES:
            return "shard"
        kind = kind_of(self.source)
        if kind in PING_KINDS:
            return "pings"
        if kind == "rosbag":
            return "bag"
        return "video" if kind in SEQUENCES else "image"


def find_items(inputs: Sequence[Path], out: Path, *, compare: bool = False) -> list[Item]:
    """The files to denoise, in a fixed order.

    A folder stands for all such files below it, a dataset's folder for its shards alone.
    compare: whether sheets to compare by are written, too.

    Raises FactoryError when there is nothing, and where a file that will be written is an input or
    the same as another.
    """
    items: dict[tuple[Path, Path], Item] = {}
    for path in inputs:
        for item in _of_input(path, out):
            items.setdefault((item.relative, item.source.resolve()), item)
    sheets = Counter(item.compared for item in items.values())
    found_items = [replace(item, whole_name=sheets[item.compared] > 1) for item in items.values()]
    _check_outputs(found_items, out, compare=compare)
    return found_items


def sequences(items: Sequence[Item]) -> list[list[Item]]:
    """Picture files that follow each other in time, by their numbers; other files alone.

    A sequence is the pictures of a folder whose names differ in their last number alone.
    """
    found: dict[tuple[str, ...], list[tuple[int, Path, Item]]] = {}
    for item in items:
        last = _LAST_NUMBER.fullmatch(item.source.name) if item.kind == "image" else None
        key = (str(item.source.parent), last[1], last[3]) if last else (str(item.source),)
        number = int(last[2]) if last else 0
        found.setdefault(key, []).append((number, item.source, item))
    return [[item for *_, item in sorted(some, key=lambda one: one[:2])] for some in found.values()]


def _check_outputs(items: Sequence[Item], out: Path, *, compare: bool) -> None:
    """No file that is written is an input, or the same as another."""
    sources = {item.source.resolve() for item in items}
    written: dict[Path, Item] = {}
    for item in items:
        results = [item.relative, *([item.compared] if compare else [])]
        for relative in results:
            path = (out / relative).resolve()
            other = written.setdefault(path, item)
            if other is not item:
                raise FactoryError(
                    f"{other.source} and {item.source} would both become {relative}; "
                    "denoise them into different folders"
                )
            if path in sources:
                raise FactoryError(f"--out {out}: would overwrite the input {path}")


def _of_input(path: Path, out: Path) -> Iterator[Item]:
    if path.is_file():
        if path.suffix.lower() not in SUFFIXES:
            raise FactoryError(
                f"{path}: neither an image nor a shard nor a video or recording "
                f"({', '.join(SUFFIXES)})"
            )
        yield Item(path, Path(path.name))
    elif not path.is_dir():
        raise FactoryError(f"{path}: no such file or folder")
    elif is_bag_folder(path):
        yield Item(path, Path(path.resolve().name))
    else:
        yield from _of_folder(path, out)


def _of_folder(path: Path, out: Path) -> Iterator[Item]:
    # These load h5py, which a single picture can do without.
    from ...factory.dataset import PairDataset
    from ...factory.dataset.manifest import MANIFEST_NAME

    if (path / MANIFEST_NAME).is_file():
        for shard in PairDataset(path, "all").paths:
            yield Item(shard, shard.relative_to(path), checked=True)
        return
    found = items_below(path, out)
    if not found:
        raise FactoryError(
            f"{path}: holds no image, shard, video or recording ({', '.join(SUFFIXES)})"
        )
    yield from found


def items_below(folder: Path, out: Path) -> list[Item]:
    """All files (and folders that are bags) below a folder, but for those below `out`.

    What begins with a dot is no result yet, of this program or of one that copies.
    """
    bags = [file.parent for file in folder.rglob("metadata.yaml") if is_bag_folder(file.parent)]
    files = [
        file
        for file in folder.rglob("*")
        if file.suffix.lower() in SUFFIXES
        and not any(part.startswith(".") for part in file.relative_to(folder).parts)
        and file.is_file()
        and file.parent not in bags
        and not is_table(file)
    ]
    return [
        Item(file, file.relative_to(folder))
        for file in sorted([*bags, *files])
        if not file.resolve().is_relative_to(out.resolve())
    ]


class Geometries:
    """Geometry of pictures, as `--geometry` says.

    chosen: `find` it in each picture (for a video or bag in its first frame); `polar`: rows are
    ranges, near range first, and the columns span 30 degrees; `none`; or the path of a table of
    fans.
    """

    def __init__(self, chosen: str) -> None:
        """Raises FactoryError for a table that cannot be read."""
        self.chosen = chosen
        self._table = {} if chosen in (FIND, POLAR, NONE) else read_fans(chosen)
        # By the size of the pictures, too: a bag may have several topics.
        self._videos: dict[tuple[Path, tuple[int, ...]], FanGeometry | None] = {}
        # Folder, video or bag -> pictures with a fan, and all that were looked at.
        self._counts: dict[Path, tuple[int, int]] = {}

    def of(self, item: Item, picture: npt.NDArray[Any]) -> FanGeometry | None:
        """The geometry of a picture of `item`; None where it is not known."""
        if self.chosen == POLAR:
            return FanGeometry.polar().with_size(*picture.shape[:2])
        if self.chosen != FIND:
            return self._table.get(item.source.name)
        key = item.source, picture.shape
        if key in self._videos:
            return self._videos[key]
        geometry = find_geometry(picture)
        video = item.kind in ("video", "bag")
        if video:
            self._videos[key] = geometry
        place = item.source if video else item.source.parent
        with_fan, looked_at = self._counts.get(place, (0, 0))
        self._counts[place] = with_fan + (geometry is not None), looked_at + 1
        return geometry

    def summary(self) -> Iterator[str]:
        """One line a folder, video or bag whose pictures were looked at."""
        for place, (with_fan, looked_at) in self._counts.items():
            yield f"geometry: fan found in {with_fan} of {looked_at} pictures searched ({place})"


class Finished:
    """Which files are denoised, kept where a run is stopped and for the same command alone."""

    def __init__(self, out: Path, digest: str, arguments: Sequence[str]) -> None:
        """digest: of the weights.  arguments: of the command."""
        self._path = out / NAME
        whole = json.dumps([digest, *arguments])
        self._command = hashlib.sha256(whole.encode()).hexdigest()
        self._done: dict[str, list[int]] = {}

    def of(self, items: Sequence[Item]) -> frozenset[Path]:
        """Results of the run that was stopped, of files that did not change since."""
        try:
            kept = json.loads(self._path.read_bytes())
            done = dict(kept["done"]) if kept["command"] == self._command else {}
        except (OSError, ValueError, TypeError, KeyError):
            return frozenset()
        found = [
            item.relative
            for item in items
            if done.get(str(item.relative)) == _state(item)
            and (self._path.parent / item.relative).exists()
        ]
        self._done = {str(relative): done[str(relative)] for relative in found}
        return frozenset(found)

    def add(self, item: Item) -> None:
        """A file is denoised."""
        self._done[str(item.relative)] = _state(item)

    def save(self) -> None:
        """The run is stopped."""
        content = json.dumps({"command": self._command, "done": self._done})
        write_atomically(self._path, content.encode(), key="--out")

    def forget(self) -> None:
        """The run came to its end."""
        self._path.unlink(missing_ok=True)


def _state(item: Item) -> list[int]:
    try:
        found = item.source.stat()
    except OSError:
        return []
    return [found.st_size, found.st_mtime_ns]
