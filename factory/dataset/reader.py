"""Finding and opening the shards of a dataset, and reading images that fit their checksums."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np

from ..common.array_types import Array
from ..common.errors import OS_REMEDIES, FactoryError
from ..common.isolated import LIMIT_S, call_isolated
from .layout import DEFLATE, check_shard, check_texts, crc32
from .manifest import Manifest, ShardInfo, damage, is_inside
from .schema import CHECKSUMS, SPLITS, VALUE_RANGES
from .storage import fetched, url_of

Split = Literal["train", "test", "all"]


def listed_shards(
    root: Path, split: Split, manifest: Manifest | None, *, follow_links: bool = False
) -> dict[Path, ShardInfo | None]:
    """The shard files of one split in the order of their names, and what the manifest says of them.

    follow_links: whether a shard may be a link to a file outside the folder.
    Without a manifest every `*.h5` in the folders train/ and test/ is one.  Raises FactoryError
    when the folder is no dataset, a listed shard is absent, of another size or outside the folder,
    or the split is empty.
    """
    if not root.is_dir():
        raise FactoryError(f"dataset={root}: no such folder; give one that `simnfnd make` made")
    info_by_path: dict[Path, ShardInfo | None]
    if manifest is None:
        info_by_path = {
            path: None for name in SPLITS for path in sorted((root / name).glob("*.h5"))
        }
    else:
        info_by_path = {
            root / info.path: info for name in SPLITS for info in manifest.of_split(name)
        }
    if not info_by_path:
        raise FactoryError(f"dataset={root}: no shards in train/ or test/; is it a dataset folder?")
    chosen = {
        path: info for path, info in info_by_path.items() if split in ("all", path.parent.name)
    }
    if not chosen:
        alternative = (
            f"split={next(iter(info_by_path)).parent.name} has {len(info_by_path)} shard(s)"
        )
        raise FactoryError(f"dataset={root}: the {split} split is empty; {alternative}")
    # What lies at a URL is fetched, and looked at, when it is opened.
    for path, info in () if url_of(root) else chosen.items():
        if not follow_links and path.exists() and not is_inside(root, path):
            raise FactoryError(
                f"{path}: leads out of the dataset's folder; not read: copy the dataset with "
                "`cp -rL`, or open your own with PairDataset(..., trusted=True)"
            )
        if info and (problem := damage(root, info, whole=False)):
            raise FactoryError(f"{path}: {problem}; run the command that made the dataset again")
    return chosen


def check_in_isolation(paths: Iterable[Path]) -> None:
    """Have another process open every shard first: a damaged file can make HDF5 crash or hang.

    Everything that opens possibly untrusted files goes through here: a quarter of a second, and
    some milliseconds a shard.  Raises FactoryError for the first shard that cannot be read.
    """
    for path in paths:
        if path.exists() or not url_of(path.parent.parent):
            call_isolated(path, check_readable, path, limit_s=LIMIT_S)


def check_readable(path: Path) -> None:
    """Read everything of a shard but its images.  Raises FactoryError when it is damaged."""
    with reading(path) as file:
        file["meta"][()]
        check_texts(file)


def bring(path: Path) -> None:
    """Fetch a shard of a copy that is not here, and have another process look at it first."""

    def check(aside: Path) -> None:
        try:
            call_isolated(aside, check_readable, aside, limit_s=LIMIT_S)
        except FactoryError as error:
            raise FactoryError(str(error).replace(str(aside), str(path))) from error
        # It keeps its state when it gets its name, and no other process writes it.
        _sound[path] = _state_of(aside)

    fetched(path, check)


def open_shard(path: Path) -> h5py.File:
    """Open one shard for reading and check how it is laid out, unless this process has already.

    Call `check_in_isolation` first for untrusted files.
    Raises FactoryError when the file is absent, damaged or of another schema.
    """
    for _ in range(3):
        bring(path)
        if path.exists():
            break  # another process may have made room meanwhile
    try:
        state = _state_of(path)
        # A chunk is an image and read whole: HDF5's cache would only copy it once more (a fifth
        # of the time of an uncompressed one) and hold megabytes for every open dataset.
        file = h5py.File(path, "r", rdcc_nbytes=0)
    except OSError as error:
        raise FactoryError(f"{path}: {_cause_of(error)}") from error
    if _sound.get(path) == state:
        return file
    try:
        with _explained(path):
            check_shard(file)
            split = str(file.attrs["split"])
            if path.parent.name in SPLITS and path.parent.name != split:
                raise FactoryError(
                    f"its attribute split is {split!r}, but it lies in {path.parent.name}/; "
                    "generate it again"
                )
    except FactoryError:
        file.close()
        raise
    _sound[path] = state
    return file


def _cause_of(error: OSError) -> str:
    """Why a shard cannot be opened, and what helps."""
    if isinstance(error, FileNotFoundError):
        return "listed in the manifest but absent; copy it again, or make it again (README.md)"
    if error.errno in OS_REMEDIES:
        return f"{os.strerror(error.errno)}; {OS_REMEDIES[error.errno]}"
    return "not a readable HDF5 file; copy it again, or make it again (README.md)"


@contextmanager
def reading(path: Path) -> Iterator[h5py.File]:
    """An open shard for the length of a `with`; damage found inside is a FactoryError, too."""
    with open_shard(path) as file, _explained(path):
        yield file


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except FactoryError as error:
        raise FactoryError(f"{path}: {error}") from error
    except (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError) as error:
        if isinstance(error, OSError) and error.errno in OS_REMEDIES:
            raise FactoryError(f"{path}: {_cause_of(error)}") from error
        # HDF5 reports damage of its own tables as almost any exception.
        reason = " ".join(str(error).split())[:120]
        raise FactoryError(f"{path}: damaged ({reason}); generate it again") from error


# Shards that this process has found sound, by (inode, bytes, time of change in ns): a check takes
# twenty times as long as opening a file, and random access opens one for every sample.
_sound: dict[Path, tuple[int, int, int]] = {}


def _state_of(path: Path) -> tuple[int, int, int]:
    now = path.stat()
    return now.st_ino, now.st_size, now.st_mtime_ns


def value_range(file: h5py.File) -> float:
    """The value of full scale: 255 for uint8 shards, 1 for float32 ones."""
    return VALUE_RANGES[str(file["noisy"].dtype)][1]


# --- images


# A process may have 1024 files open as a rule, and a loader may read several datasets.
_MOST_FILES = 64


class ImageStack:
    """`stack[row]` is one (H, W) image, as stored and writable.

    Images in colour have a third dimension.
    Raises FactoryError (without the file's name) for an image that is damaged.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset = dataset
        self._gzip = dataset.compression == "gzip"
        # Spelled anew: h5py names the byte order of the machine too, which some libraries refuse.
        dtype = np.dtype(dataset.dtype.str)
        self._form: tuple[tuple[int, ...], Any] = dataset.shape[1:], dtype
        self._sums = dataset.file[CHECKSUMS][dataset.name[1:]]

    def __len__(self) -> int:
        """Number of images."""
        return len(self._dataset)

    def __getitem__(self, row: int) -> Array:
        """One image."""
        number = range(len(self))[row]
        image: Array = np.empty(*self._form)
        try:
            if self._gzip:
                # 1.5 times as fast as by HDF5, and never more bytes than an image has.
                offset = (number, *(0 for _ in image.shape))
                _, packed = self._dataset.id.read_direct_chunk(offset)
                pixels = DEFLATE.decompressobj().decompress(packed, image.nbytes)
                image.reshape(-1).view(np.uint8)[:] = np.frombuffer(pixels, np.uint8)
            else:
                self._dataset.read_direct(image, np.s_[number])
            if crc32(image) != self._sums[number]:
                raise ValueError("its checksum differs")
        except (MemoryError, OSError, RuntimeError, ValueError, DEFLATE.error) as error:
            reason = " ".join(str(error).split())[:120] or "not in the table of chunks"
            raise FactoryError(
                f"{self._dataset.name} sample {number} is damaged ({reason}); delete the file and "
                "run the command that made the dataset again"
            ) from error
        return image


class OpenShards:
    """Reads images; opens each shard when it is needed, and closes the least recent one.

    Safe under threads, fork, spawn and pickling.
    """

    def __init__(self) -> None:
        self._forget()

    def read(self, path: Path, layers: tuple[str, ...], row: int) -> list[Array]:
        """The layers of one sample, each (H, W), as stored.

        Raises FactoryError when the shard cannot be opened or a chunk is damaged.
        """
        self._forget_parent()
        with self._lock:
            if path not in self._open:
                while len(self._open) >= _MOST_FILES:
                    self._close_oldest()
                self._open[path] = open_shard(path), {}
            file, stacks = self._open[path] = self._open.pop(path)
            try:
                for name in layers:
                    # Looking one up in HDF5 costs as much as a small read.
                    if name not in stacks:
                        stacks[name] = ImageStack(file[name])
                return [stacks[name][row] for name in layers]
            except KeyError as error:
                absent = next(name for name in layers if name not in file)
                raise FactoryError(
                    f"{path}: has no layer {absent}; make the dataset with it in dataset.layers"
                ) from error
            except (FactoryError, IndexError) as error:
                raise FactoryError(f"{path}: {error}") from error

    def close(self) -> None:
        """Close every file; the next read opens what it needs."""
        self._forget_parent()
        with self._lock:
            while self._open:
                self._close_oldest()

    def _close_oldest(self) -> None:
        self._open.pop(next(iter(self._open)))[0].close()

    def _forget_parent(self) -> None:
        """After a fork: HDF5's state and a lock that another thread holds stay behind."""
        if self._process != os.getpid():
            self._forget()

    def _forget(self) -> None:
        self._open: dict[Path, tuple[h5py.File, dict[str, ImageStack]]] = {}
        self._lock = threading.Lock()
        self._process = os.getpid()

    def __reduce__(self) -> tuple[type[OpenShards], tuple[()]]:
        return OpenShards, ()
