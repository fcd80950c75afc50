"""What `simnfnd denoise` is given: files, where range and bearing lie in them, what is done."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError
from ...factory.common.files import real_path, shortened
from ...factory.dataset.fan_geometry import FanGeometry
from . import DATASET, is_bag_folder, kind_of, refuse_absent, suffixes_known
from .arrays import is_shard_file, is_table
from .base import ARRAY_SUFFIX, ARRAY_SUFFIXES, HDF5_SUFFIXES
from .fan_finder import find_geometry
from .fan_tables import read_fans
from .fan_tracking import FanTracker
from .names import sequences_of

FIND = "find"
POLAR = "polar"
NONE = "none"
_MOST_FOLDERS_SAID = 5
_ASSUMED_OPENING_DEG = 30.0


@dataclass(frozen=True)
class InputFile:
    """One input file (or a folder that is a bag) and its name below the output folder.

    dataset: of recordings, which a shard belongs to; None for all other files.
    """

    source: Path
    relative: Path
    dataset: Path | None = None

    @property
    def compared(self) -> Path:
        """Name of the sheet to compare by, below the output folder."""
        is_png = self.relative.suffix.lower() == ".png"
        name = self.relative.name if is_png else f"{shortened(self.relative.name)}.png"
        return Path("compare") / self.relative.with_name(name)

    def results(self) -> tuple[Path, Path]:
        """Names of the result and of the sheet to compare by, below the output folder."""
        return self.relative, self.compared

    @cached_property
    def kind(self) -> str:
        """`shard`, or the kind of recording; one image is of kind `images`."""
        if self.source.suffix.lower() in HDF5_SUFFIXES:
            return "array" if self.relative.suffix == ARRAY_SUFFIX else "shard"
        return kind_of(self.source) or "images"


def find_items(inputs: Sequence[Path], out: Path, *, compare: bool = False) -> list[InputFile]:
    """The files to denoise, in a fixed order.

    A folder stands for all such files below it, a dataset's folder for its shards alone.
    compare: whether sheets to compare by are written, too.

    Raises FactoryError when there is nothing, and where a file that will be written is an input or
    the same as another.
    """
    items = {
        (item.relative, real_path(item.source)): item
        for path in inputs
        for item in _of_input(path, out)
    }
    sources = {source for _, source in items}
    written: dict[Path, InputFile] = {}
    for item in items.values():
        for relative in (item.relative, item.compared) if compare else (item.relative,):
            path = real_path(out / relative)
            first_item = written.setdefault(path, item)
            if first_item is not item:
                raise FactoryError(
                    f"{first_item.source} and {item.source} would both become {relative}; "
                    "denoise them into different folders"
                )
            if path in sources:
                raise FactoryError(f"--out {out}: would overwrite the input {path}")
    return list(items.values())


def sequences(items: Sequence[InputFile]) -> list[list[InputFile]]:
    """Image files that follow each other in time, as their names say; other files alone.

    The files of a sequence lie in one folder; see `sequences_of`.  Shards of a dataset of
    recordings come together.
    """
    runs: list[list[InputFile]] = []
    for folder, in_folder in _by_folder(items).items():
        if folder is None:
            runs += [[item] for item in in_folder if item.dataset is None]
            datasets = dict.fromkeys(item.dataset for item in in_folder if item.dataset)
            for dataset in datasets:
                runs.append([item for item in in_folder if item.dataset == dataset])
            continue
        names = [item.source.name for item in in_folder]
        runs += [[in_folder[index] for index in sequence] for sequence in sequences_of(names)]
    return runs


def _by_folder(items: Sequence[InputFile]) -> dict[Path | None, list[InputFile]]:
    """Image files by their folder, and other files under None, in the order of the items."""
    folders: dict[Path | None, list[InputFile]] = {}
    for item in items:
        folder = item.source.parent if item.kind == "images" else None
        folders.setdefault(folder, []).append(item)
    return folders


def said_of_sequences(items: Sequence[InputFile]) -> Iterator[str]:
    """A line for each folder of several images: into how many sequences their names divide."""
    folders = [(folder, some) for folder, some in _by_folder(items).items() if folder and some[1:]]
    for folder, some in folders[:_MOST_FOLDERS_SAID]:
        sizes = [len(sequence) for sequence in sequences(some)]
        alone = sizes.count(1)
        count = len(sizes) - alone
        parts = [f"{count} sequence{'s' * (count != 1)}"] if count else []
        parts += [f"{alone} single image{'s' * (alone != 1)}"] if alone else []
        said = " and ".join(parts)
        yield f"sequences: the {len(some)} images of {folder} make {said}, by their names"
    if len(folders) > _MOST_FOLDERS_SAID:
        yield f"sequences: {len(folders) - _MOST_FOLDERS_SAID} more folders"


def _of_input(path: Path, out: Path) -> list[InputFile]:
    """The files that an input of the command line stands for.

    Raises FactoryError where it holds nothing that can be denoised.
    """
    if kind_of(path) == DATASET:
        return [InputFile(path, Path(path.name))]
    refuse_absent(path)
    if path.is_dir() and is_bag_folder(path):
        return [InputFile(path, Path(real_path(path).name))]
    if path.is_dir():
        # These load h5py, which a single image can do without.
        from ...factory.dataset import PairDataset
        from ...factory.dataset.manifest import load_manifest
        from ...factory.dataset.recordings import is_of_recordings

        manifest = load_manifest(path)
        if manifest is not None:
            # Each is looked at when it is opened.
            shards = PairDataset(path, "all", trusted=True).paths
            dataset = path if is_of_recordings(manifest.config) else None
            return [InputFile(shard, shard.relative_to(path), dataset) for shard in shards]
        items = items_below(path, out)
    else:
        items = [_item(path, path.parent)] if path.suffix.lower() in _suffixes() else []
    if not items:
        raise FactoryError(
            f"{path}: no image, shard, video or recording ({', '.join(_suffixes())})"
        )
    return items


def _suffixes() -> tuple[str, ...]:
    return (*suffixes_known(), *HDF5_SUFFIXES)


def items_below(folder: Path, out: Path) -> list[InputFile]:
    """All files (and folders that are bags) below a folder, but for those below `out`.

    What begins with a dot is no result yet, of this program or of one that copies.
    """
    suffixes = _suffixes()
    bags = [file.parent for file in folder.rglob("metadata.yaml") if is_bag_folder(file.parent)]
    files = [
        file
        for file in folder.rglob("*")
        if file.suffix.lower() in suffixes
        and not any(part.startswith(".") for part in file.relative_to(folder).parts)
        and file.is_file()
        and file.parent not in bags
        and not is_table(file)
    ]
    return [
        _item(file, folder)
        for file in sorted([*bags, *files])
        if not real_path(file).is_relative_to(real_path(out))
    ]


def _item(file: Path, folder: Path) -> InputFile:
    """A file below a folder: arrays of all formats become .npy files."""
    relative = file.relative_to(folder)
    suffix = file.suffix.lower()
    is_foreign = suffix in HDF5_SUFFIXES and not is_shard_file(file)
    is_array = suffix in ARRAY_SUFFIXES or is_foreign
    return InputFile(file, relative.with_suffix(ARRAY_SUFFIX) if is_array else relative)


class Geometries:
    """Geometry of images, as `--geometry` says.

    chosen: `find` it in each image (in a video, stack or bag where it changes); `polar`: rows are
    ranges, near range first, and the columns span `opening_deg`; `none`; or the path of a table of
    fans.
    """

    def __init__(self, chosen: str, opening_deg: float | None = None) -> None:
        """opening_deg: of polar images; None: 30 are assumed, and `summary` says so.

        Raises FactoryError for a table that cannot be read, and an angle that cannot be.
        """
        if opening_deg is not None and chosen != POLAR:
            raise FactoryError("--opening: belongs to --geometry polar; leave it out")
        if opening_deg is not None and not 0 < opening_deg <= 360:
            raise FactoryError(f"--opening {opening_deg:g}: must be more than 0, up to 360 degrees")
        self.chosen = chosen
        self._opening_deg = opening_deg
        self._table = {} if chosen in (FIND, POLAR, NONE) else read_fans(chosen)
        # By topic and size: a bag may have several topics.
        self._trackers: dict[tuple[str, tuple[int, ...]], FanTracker] = {}

    def of(
        self, item: InputFile, image: Array, sequence: str = "", number: int | None = None
    ) -> FanGeometry | None:
        """The geometry of an image of `item`; None where it is not known.

        Frames of a recording are to be asked for in order, after `begin`.
        sequence, number: see `SonarFrame`; an image without a number is searched alone.
        """
        if self.chosen == POLAR:
            opening_deg = self._opening_deg or _ASSUMED_OPENING_DEG
            return FanGeometry.polar(math.radians(opening_deg)).with_size(*image.shape[:2])
        if self.chosen != FIND:
            return self._table.get(item.source.name)
        if item.kind == "images" and number is None:
            return find_geometry(image)
        key = sequence, image.shape
        return self._trackers.setdefault(key, FanTracker()).geometry(image, number)

    def begin(self) -> None:
        """Begin with the frames of another sequence."""
        self._trackers.clear()

    def note(self, name: str, fans_found: int, images: int) -> str:
        """A line on the images of a file or folder whose fans were searched; mostly empty."""
        if self.chosen != FIND or not images:
            return ""
        return f"geometry: fan found in {fans_found} of {images} images ({name})"

    def summary(self) -> Iterator[str]:
        """A line on what was assumed."""
        if self.chosen == POLAR and self._opening_deg is None:
            yield (
                f"geometry: polar images were taken to span {_ASSUMED_OPENING_DEG:g} degrees; "
                "--opening DEGREES states what they span"
            )
