"""Arrays of images: NumPy (.npy, .npz), MATLAB (.mat of every version) and HDF5 files.

A file holds one array of images; tables beside it do not count.  Libraries that an untrusted file
may crash look at it in another process first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache
from pathlib import Path

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
from .hdf5_files import LEAST_BEAMS, is_shard, list_hdf5, load_hdf5
from .listed_arrays import LEAST_SIDE_PX, Listed, listed_of_rows
from .matlab_files import list_mat, load_mat
from .numpy_files import list_npy, list_npz, load_npy, load_npz

_MOST_NAMED = 6
_COLOUR_COUNTS = (3, 4)


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
                f"(N, H, W, 3), {LEAST_SIDE_PX} pixels or more on a side; save them as .npy"
            )
        if len(arrays) > 1:
            names = ", ".join([array.name for array in arrays][:_MOST_NAMED])
            raise FrameError(
                f"{self.path}: holds several arrays of images ({names}); save the one that is "
                "meant as .npy"
            )
        (self._listed,) = arrays
        shape = self._listed.shape
        height, width = shape[:2] if self._listed.is_single else shape[1:3]
        ask_pixels(str(self.path), width, height)
        if self.path.suffix.lower() != ARRAY_SUFFIX:
            needed = math.prod(shape) * self._listed.dtype.itemsize
            ask_bytes(f"{self.path}: {self._listed.name}", needed, self.size)
        self.count = 1 if self._listed.is_single else shape[0]
        if self._listed.parts is not None:
            self.count = self._listed.parts
            self.warning = f"{self.path}: is cut short; its {self.count} whole frames are read"
        elif self._listed.matlab_shape is not None:
            sides = " x ".join(map(str, self._listed.matlab_shape))
            self.warning = (
                f"{self.path}: {self._listed.name} ({sides}) is read as {self.count} images of "
                f"{height} x {width}, the last axis counts them; if the first one does, save "
                "permute(x, [2 3 1])"
            )
        elif not self._listed.is_single and _is_rather_last(shape):
            self.warning = (
                f"{self.path}: is read as {shape[0]} images of {height} x {width}, the first axis "
                "counts them; if the last one does, save np.moveaxis(x, -1, 0)"
            )
        elif len(shape) == 3 and shape[0] in _COLOUR_COUNTS:
            self.warning = (
                f"{self.path}: is read as {shape[0]} images of {height} x {width}, one after the "
                "other; if the first axis counts colours, save np.moveaxis(x, 0, -1)"
            )

    @cached_property
    def stored(self) -> Array:
        """See the class; unpacked when it is first asked for."""
        with explained(f"{self.path}: cannot be read; is the file damaged?", reason=True):
            return _load(self.path, self._listed)

    def _read(self, number: int) -> SonarFrame:
        name = f"{self.path}: image {number + 1}" if self.count > 1 else str(self.path)
        page = self.stored if self._listed.is_single else self.stored[number]
        return SonarFrame(number, as_samples(np.ascontiguousarray(swapped(page)), name))


def _is_rather_last(shape: Sequence[int]) -> bool:
    """Whether the last axis of an array that is no MATLAB's rather counts images than the first."""
    if len(shape) != 3:
        return False
    return min(shape[1:]) < LEAST_BEAMS <= min(shape[:2])


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
    return "images" if alone and arrays[0].is_single else "array"


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


def _images_in(path: Path) -> list[Listed]:
    """The arrays of a file that may be images; nothing is unpacked.  Raises FactoryError."""
    problem = f"{path}: not a readable array"
    with explained(problem, reason=True, passing=FrameError):
        try:
            listed = _listed(path, path.stat().st_mtime_ns)
        except FactoryError as error:
            if isinstance(error, FrameError):
                raise
            reason = str(error).removeprefix(f"{path}: ")
            raise FrameError(f"{problem} ({reason})") from error
    return [array for array in listed if array.is_of_images]


@lru_cache(maxsize=4096)
def _listed(path: Path, changed_ns: int) -> list[Listed]:
    """The arrays in a file; its kind is asked for several times before it is opened."""
    suffix = path.suffix.lower()
    if suffix in HDF5_SUFFIXES:
        return listed_of_rows(call_isolated(path, list_hdf5, str(path), False))
    if suffix == ".mat":
        return list_mat(path)
    if suffix == ".npz":
        return list(list_npz(path))
    return [list_npy(path)]


def _load(path: Path, listed: Listed) -> Array:
    """An array of a file.  May raise nearly anything."""
    suffix = path.suffix.lower()
    if suffix in HDF5_SUFFIXES:
        return load_hdf5(path, listed, is_matlab=False)
    if suffix == ".mat":
        return load_mat(path, listed)
    if suffix == ".npz":
        return load_npz(path, listed)
    return load_npy(path, listed)
