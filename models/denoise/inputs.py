"""What `simnfnd denoise` is given: images, folders, datasets, shards, videos, recordings, bags."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

from ...factory.dataset.format.manifest import MANIFEST_NAME
from ...factory.dataset.read.reader import shard_paths
from ...factory.errors import FactoryError
from ..recordings import PICTURE_SUFFIXES, READERS, SEQUENCES, Levels, is_bag_folder, kind_of
from ..recordings.arrays import SUFFIXES as ARRAY_SUFFIXES
from ..recordings.arrays import file_of, is_table
from ..recordings.base import ARRAY_SUFFIX, TIFF_SUFFIXES

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


@dataclass(frozen=True)
class Item:
    """One input file (or a folder that is a bag) and its name below the output folder.

    source: of a file of arrays also FILE::NAME.
    checked: a shard that another process has opened without harm.
    levels: of arrays and TIFF files, what shows as black and white.
    """

    source: Path
    relative: Path
    checked: bool = False
    levels: Levels | None = None

    @cached_property
    def kind(self) -> Literal["image", "shard", "video", "pings", "bag"]:
        """By the suffix of its name; a file of several pictures (TIFF, arrays) is a `video`."""
        suffix = self.source.suffix.lower()
        if self.checked or suffix in HDF5_SUFFIXES:
            return "shard"
        kind = kind_of(self.source)
        if self.levels is not None and suffix in (*ARRAY_SUFFIXES, *TIFF_SUFFIXES):
            return "video"
        if kind in PING_KINDS:
            return "pings"
        if kind == "rosbag":
            return "bag"
        return "video" if kind in SEQUENCES else "image"


def find_items(inputs: Sequence[Path], out: Path, levels: Levels | None = None) -> list[Item]:
    """The files to denoise, in a fixed order.

    A folder stands for all such files below it, a dataset's folder for its shards
    alone.  levels: of files of arrays.

    Raises FactoryError when there is nothing, two results would have one name, or a result would
    replace its input.
    """
    items: dict[Path, Item] = {}
    for path in inputs:
        for found in _of_input(path, out):
            item = replace(found, levels=levels)
            other = items.setdefault(item.relative, item)
            if other.source.resolve() != item.source.resolve():
                raise FactoryError(
                    f"{other.source} and {item.source} would both become {item.relative}; "
                    "denoise them into different folders"
                )
            file = file_of(item.source)
            if (out / item.relative).resolve() == file.resolve():
                raise FactoryError(f"--out {out}: would overwrite the input {file}")
    return list(items.values())


def _of_input(path: Path, out: Path) -> Iterator[Item]:
    file = file_of(path)
    if file.is_file():
        if file.suffix.lower() not in SUFFIXES:
            raise FactoryError(
                f"{path}: neither an image nor a shard nor a video or recording "
                f"({', '.join(SUFFIXES)})"
            )
        yield Item(path, _output_of(Path(file.name)))
    elif not path.is_dir():
        raise FactoryError(f"{path}: no such file or folder")
    elif is_bag_folder(path):
        yield Item(path, Path(path.resolve().name))
    elif (path / MANIFEST_NAME).is_file():
        for shard in shard_paths(path, "all"):
            yield Item(shard, shard.relative_to(path), checked=True)
    else:
        found = items_below(path, out)
        if not found:
            raise FactoryError(
                f"{path}: holds no image, shard, video or recording ({', '.join(SUFFIXES)})"
            )
        yield from found


def items_below(folder: Path, out: Path) -> list[Item]:
    """All files (and folders that are bags) below a folder, but for those below `out`."""
    bags = [file.parent for file in folder.rglob("metadata.yaml") if is_bag_folder(file.parent)]
    files = [
        file
        for file in folder.rglob("*")
        if file.suffix.lower() in SUFFIXES
        and file.is_file()
        and file.parent not in bags
        and not is_table(file)
    ]
    found = [file for file in sorted([*bags, *files]) if not _is_below(file, out)]
    return [Item(file, _output_of(file.relative_to(folder))) for file in found]


def _output_of(relative: Path) -> Path:
    """The name of what is made of a file: arrays of all formats become .npy files."""
    arrays = relative.suffix.lower() in ARRAY_SUFFIXES
    return relative.with_suffix(ARRAY_SUFFIX) if arrays else relative


def _is_below(file: Path, folder: Path) -> bool:
    return file.resolve().is_relative_to(folder.resolve())
