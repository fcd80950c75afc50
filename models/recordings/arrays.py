"""Arrays of images: NumPy (.npy, .npz), MATLAB (.mat of every version) and HDF5 files.

A file holds one array of images; tables beside it do not count.  Libraries that an untrusted file
may crash look at it in another process first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.isolated import call_isolated
from .base import (
    ARRAY_SUFFIX,
    ARRAY_SUFFIXES,
    HDF5_SUFFIXES,
    Recording,
    SonarFrame,
    as_samples,
    ask_bytes,
    ask_pixels,
    explained,
    swapped,
)
from .foreign_arrays import StoredArray, is_shard, list_hdf5, list_mat, load_hdf5, load_mat

_FORMAT: Any = np.lib.format  # whose functions are not typed
_MOST_NAMED = 6
_LEAST_SIDE_PX = 16
"""Smaller arrays are tables: poses, matrices, bearings."""
_LEAST_BEAMS = 40
"""Fewest beams of a multibeam sonar, and pixels of the shorter side of its images."""
_CHANNELS = (1, 2, 3, 4)


@dataclass(frozen=True)
class _Listed:
    """An array in a file, not unpacked.

    shape: as it is stored.  axis: the one that counts images, 0 or -1; None for one image.
    is_matlab: whether MATLAB may have ordered its axes.
    whole: how many of its images are there, where the file is cut short; None: all.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    axis: int | None
    is_matlab: bool = False
    whole: int | None = None

    @property
    def count(self) -> int:
        """How many images it holds."""
        if self.axis is None:
            return 1
        return self.shape[self.axis] if self.whole is None else self.whole

    @property
    def page_shape(self) -> tuple[int, ...]:
        """(H, W) or (H, W, channels) of an image."""
        if self.axis is None:
            return self.shape
        return self.shape[1:] if self.axis == 0 else self.shape[:-1]

    @property
    def is_of_images(self) -> bool:
        """Whether it may be images: numbers, large enough, of a known number of channels."""
        page = self.page_shape
        is_page = len(page) == 2 or (len(page) == 3 and page[2] in _CHANNELS)
        is_large = is_page and self.count > 0 and min(page[:2]) >= _LEAST_SIDE_PX
        return self.dtype.kind in "uif" and is_large

    @property
    def doubt(self) -> str:
        """What else its axes could mean, and how to say so; mostly empty."""
        if len(self.shape) != 3 or self.axis is None:
            return ""
        is_doubtful = min(self.shape) >= _LEAST_BEAMS
        if not self.is_matlab:
            is_doubtful = min(self.page_shape) < _LEAST_BEAMS <= min(self.shape[:2])
            is_doubtful = is_doubtful or self.shape[0] in _CHANNELS[2:]
        if not is_doubtful:
            return ""
        sides = " x ".join(map(str, self.shape))
        height, width = self.page_shape[:2]
        return (
            f"its array of {sides} is read as {self.count} images of {height} x {width}, counted "
            f"by the {'first' if self.axis == 0 else 'last'} axis; if another axis counts images "
            "or colours, save it as .npy of (N, H, W) or (H, W, 3)"
        )

    def images_first(self, array: Array) -> Array:
        """The stored array with the axis first that counts images."""
        return np.asarray(np.moveaxis(array, -1, 0) if self.axis == -1 else array)


class ArrayFile(Recording):
    """A `Recording` of the images in a file's one array of them, in BGR order (red first there).

    stored: the array, (H, W), (N, H, W), or either with channels; mapped in a .npy file.  In MATLAB
    files either end may count the images, see `counting_axis`.
    """

    def _open(self) -> None:
        arrays = _images_in(self.path)
        if not arrays:
            raise FrameError(
                f"{self.path}: holds no images; expected (H, W), (H, W, 3), (N, H, W) or "
                f"(N, H, W, 3), {_LEAST_SIDE_PX} pixels or more on a side; save them as .npy"
            )
        if len(arrays) > 1:
            names = ", ".join([array.name for array in arrays][:_MOST_NAMED])
            raise FrameError(
                f"{self.path}: holds several arrays of images ({names}); save the one that is "
                "meant as .npy"
            )
        (self._listed,) = arrays
        height, width = self._listed.page_shape[:2]
        ask_pixels(str(self.path), width, height)
        if self.path.suffix.lower() != ARRAY_SUFFIX:
            needed = math.prod(self._listed.shape) * self._listed.dtype.itemsize
            ask_bytes(f"{self.path}: {self._listed.name}", needed, self.size)
        self.count = self._listed.count
        if self._listed.whole is not None:
            self.warning = f"{self.path}: is cut short; its {self.count} whole frames are read"
        elif self._listed.doubt:
            self.warning = f"{self.path}: {self._listed.doubt}"

    @cached_property
    def stored(self) -> Array:
        """See the class; unpacked when it is first asked for."""
        with explained(f"{self.path}: cannot be read; is the file damaged?", reason=True):
            return self._listed.images_first(_load(self.path, self._listed))

    def _read(self, number: int) -> SonarFrame:
        name = f"{self.path}: image {number + 1}" if self.count > 1 else str(self.path)
        page = self.stored if self._listed.axis is None else self.stored[number]
        return SonarFrame(number, as_samples(np.ascontiguousarray(swapped(page)), name))


def counting_axis(shape: Sequence[int], *, is_matlab: bool = False) -> int | None:
    """The axis of an array that counts images, 0 or -1; None for a single image.

    MATLAB's own functions have it last, (H, W, N) or (H, W, 3, N); arrays that Python or a user
    arranged, first.  Sides too short for an image of a sonar tell which; otherwise it is the last.
    """
    sides = list(shape)
    single = (3,) if is_matlab else _CHANNELS  # MATLAB's with four at the end are four images
    if len(sides) == 2 or (len(sides) == 3 and sides[2] in single):
        return None
    if not is_matlab or len(sides) < 3:
        return 0
    if len(sides) == 4:
        return 0 if sides[3] in _CHANNELS and sides[2] not in _CHANNELS else -1
    # The shorter side of an image, if the last or the first axis counts images.
    shorter_if_last = min(sides[:2])
    shorter_if_first = min(sides[1:])
    for least in (_LEAST_SIDE_PX, _LEAST_BEAMS):
        if (shorter_if_last < least) != (shorter_if_first < least):
            return 0 if shorter_if_last < least else -1
    return -1


def kind_of_array(path: Path) -> str | None:
    """`images` for a .npy file of one, `array` for others, None where none is of images.

    Of a file that cannot be read, as if it held some.
    """
    alone = path.suffix.lower() == ARRAY_SUFFIX
    try:
        arrays = _images_in(path)
    except FactoryError:
        return "images" if alone else "array"
    if not arrays:
        return None
    return "images" if alone and arrays[0].axis is None else "array"


def is_table(path: Path) -> bool:
    """Whether a file of arrays holds no images: folders have such beside them."""
    suffix = path.suffix.lower()
    is_array = suffix in ARRAY_SUFFIXES or (suffix in HDF5_SUFFIXES and not is_shard_file(path))
    return is_array and kind_of_array(path) is None


def is_shard_file(path: Path) -> bool:
    """Whether an HDF5 file is a shard of a dataset, or cannot be read."""
    return _is_shard_file(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4096)
def _is_shard_file(path: Path, changed_ns: int) -> bool:
    try:
        return bool(call_isolated(path, is_shard, str(path)))
    except FactoryError:
        return True


def _images_in(path: Path) -> list[_Listed]:
    """The arrays of a file that may be images; nothing is unpacked.  Raises FactoryError."""
    problem = f"{path}: not a readable array"
    with explained(problem, reason=True, passing=FrameError):
        try:
            listed = _listed(path, path.stat().st_mtime_ns)
        except FactoryError as error:
            reason = str(error).removeprefix(f"{path}: ")
            raise FrameError(f"{problem} ({reason})") from error
    return [array for array in listed if array.is_of_images]


@lru_cache(maxsize=4096)
def _listed(path: Path, changed_ns: int) -> list[_Listed]:
    """The arrays in a file; its kind is asked for several times before it is opened."""
    suffix = path.suffix.lower()
    if suffix == ARRAY_SUFFIX:
        return [_list_npy(path)]
    if suffix == ".npz":
        return _list_npz(path)
    rows = call_isolated(path, list_mat if suffix == ".mat" else list_hdf5, str(path))
    stored = [StoredArray(*row) for row in rows]
    return [
        _Listed(
            array.name,
            tuple(array.shape),
            np.dtype(array.dtype),
            counting_axis(array.shape, is_matlab=array.is_matlab),
            array.is_matlab,
        )
        for array in stored
    ]


def _list_npy(path: Path) -> _Listed:
    """The array of a .npy file; of one that is cut short, the whole images."""
    with path.open("rb") as file:
        shape, is_fortran, dtype = _numpy_header(file)
        data_bytes = path.stat().st_size - file.tell()
    listed = _Listed("", shape, dtype, counting_axis(shape))
    if data_bytes >= math.prod(shape) * dtype.itemsize:
        return listed
    whole = data_bytes // max(math.prod(shape[1:]) * dtype.itemsize, 1)
    if is_fortran or listed.axis is None or whole < 1:
        raise ValueError("it is cut short before its first whole image")
    return _Listed("", shape, dtype, 0, whole=whole)


def _list_npz(path: Path) -> list[_Listed]:
    listed = []
    from zipfile import ZipFile

    with ZipFile(path) as archive:
        for name in archive.namelist():
            if name.endswith(ARRAY_SUFFIX):
                with archive.open(name) as stream:
                    shape, _, dtype = _numpy_header(stream)
                name = name.removesuffix(ARRAY_SUFFIX)
                listed.append(_Listed(name, shape, dtype, counting_axis(shape)))
    return listed


def _numpy_header(file: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether in Fortran's order, and dtype of a .npy file.  Raises ValueError."""
    version = _FORMAT.read_magic(file)
    name = "1_0" if version == (1, 0) else "2_0"
    shape, is_fortran, dtype = getattr(_FORMAT, f"read_array_header_{name}")(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never unpacked")
    return shape, is_fortran, dtype


def _load(path: Path, listed: _Listed) -> Array:
    """An array of a file as it is stored, without images that are cut.  May raise anything."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return load_mat(path, listed.name, listed.shape, listed.dtype)
    if suffix in HDF5_SUFFIXES:
        return load_hdf5(path, listed.name)
    if listed.whole is not None:
        with path.open("rb") as file:
            _numpy_header(file)
            shape = (listed.whole, *listed.shape[1:])
            return np.memmap(path, listed.dtype, "r", file.tell(), shape)
    if suffix == ARRAY_SUFFIX:
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    with np.load(path, allow_pickle=False) as archive:
        return np.asarray(archive[listed.name])


def write_array(file: IO[bytes], images: Iterable[Array], like: Array) -> None:
    """Write a .npy file with the shape and dtype of `like`, image by image.

    images: (H, W) or (H, W, colours) in BGR order.  Raises OSError.
    """
    dtype = like.dtype.newbyteorder("=")
    _FORMAT.write_array_header_1_0(
        file, {"descr": dtype.str, "fortran_order": False, "shape": like.shape}
    )
    for image in images:
        file.write(np.ascontiguousarray(swapped(image), dtype).tobytes())
