"""Arrays of images: NumPy (.npy, .npz), MATLAB (.mat of every version) and HDF5 files.

A file holds one array of images; tables beside it do not count.  Libraries that an untrusted file
may crash look at it in another process first.
"""

from __future__ import annotations

import math
import warnings
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import IO, Any, NamedTuple
from zipfile import BadZipFile, ZipFile

import numpy as np

from ...factory.errors import FactoryError, FrameError
from ...factory.isolated import call_isolated
from .base import (
    ARRAY_SUFFIX,
    ARRAY_SUFFIXES,
    HDF5_SUFFIXES,
    Frame,
    Recording,
    Samples,
    as_samples,
    ask_bytes,
    ask_pixels,
    explained,
    swapped,
)

_FORMAT: Any = np.lib.format  # whose functions are not typed
LEAST_SIDE_PX = 16  # smaller arrays are tables: poses, matrices, bearings
_CHANNELS = ((1,), (2,), (3,), (4,))
# MATLAB's class -> dtype; the others (logical, char, cell, sparse) are no images.
_MATLAB = {"double": "f8", "single": "f4"} | {
    f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4)
}
_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HDF5_BLOCK = 512  # bytes that MATLAB writes before it
_MATLAB_5 = b"MATLAB 5.0 MAT-file"
_ZIP_HEAD = b"PK\x03\x04"
_MOST_NAMED = 6
_MOST_DEPTH = 8  # of structures in structures


@dataclass(frozen=True)
class Listed:
    """An array in a file, not unpacked.

    shape: the number of the image first.  parts: how many of its images are whole where the file
    is cut short; None: all.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    parts: int | None = None

    @property
    def is_single(self) -> bool:
        """Whether it is one image, without an axis for their number."""
        return _is_single(self.shape)

    @property
    def is_of_images(self) -> bool:
        """Whether it may be images: numbers, large enough, of a known number of channels."""
        pages = (1, *self.shape) if self.is_single else self.shape
        fits = len(pages) == 3 or (len(pages) == 4 and pages[3:] in _CHANNELS)
        is_large = fits and pages[0] > 0 and min(pages[1:3]) >= LEAST_SIDE_PX
        return self.dtype.kind in "uif" and is_large


class ArrayFile(Recording):
    """A `Recording` of the images in a file's one array of them, in BGR order (red first there).

    stored: the array, (H, W), (N, H, W), or either with channels; mapped in a .npy file.  MATLAB
    files have the number of the image as their last axis.
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

    @cached_property
    def stored(self) -> Samples:
        """See the class; unpacked when it is first asked for."""
        with explained(f"{self.path}: cannot be read; is the file damaged?", reason=True):
            return _load(self.path, self._listed)

    def _read(self, number: int) -> Frame:
        name = f"{self.path}: image {number + 1}" if self.count > 1 else str(self.path)
        page = self.stored if self._listed.is_single else self.stored[number]
        return Frame(number, as_samples(np.ascontiguousarray(swapped(page)), name))


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


def _is_single(shape: Sequence[int]) -> bool:
    return len(shape) == 2 or tuple(shape[2:]) in _CHANNELS


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
        return _named(call_isolated(path, list_hdf5, str(path), False))
    if suffix == ".mat":
        return _listed_matlab(path)
    if suffix == ".npz":
        return list(_members(path))
    return [_array_of_numpy(path)]


def _named(rows: list[list[Any]]) -> list[Listed]:
    return [Listed(name, tuple(shape), np.dtype(kind)) for name, shape, kind in rows]


# --- NumPy ----------------------------------------------------------------------------------------


def _array_of_numpy(path: Path) -> Listed:
    """The array of a .npy file; of one that is cut short, the whole images."""
    with path.open("rb") as file:
        header = _numpy_header(file)
        data_bytes = path.stat().st_size - file.tell()
    return _whole_part(path, "", header, data_bytes)


class _NumpyHeader(NamedTuple):
    """The header of a .npy file."""

    shape: tuple[int, ...]
    is_fortran: bool
    dtype: np.dtype[Any]

    @property
    def data_bytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize


def _numpy_header(file: IO[bytes]) -> _NumpyHeader:
    """Read the header of a .npy file.  Raises ValueError."""
    version = _FORMAT.read_magic(file)
    name = "1_0" if version == (1, 0) else "2_0"
    shape, is_fortran, dtype = getattr(_FORMAT, f"read_array_header_{name}")(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never unpacked")
    return _NumpyHeader(shape, is_fortran, dtype)


def _whole_part(path: Path, name: str, header: _NumpyHeader, data_bytes: int) -> Listed:
    """The array of which `data_bytes` are there.  Raises FrameError where no image is whole."""
    shape, is_fortran, dtype = header
    if data_bytes >= header.data_bytes:
        return Listed(name, shape, dtype)
    image_bytes = max(math.prod(shape[1:]) * dtype.itemsize, 1)
    parts = data_bytes // image_bytes
    if is_fortran or _is_single(shape) or len(shape) < 3 or parts < 1:
        raise FrameError(
            f"{path}: not a readable array: it is cut short ({max(data_bytes, 0):,} of "
            f"{header.data_bytes:,} bytes) before its first whole image"
        )
    return Listed(name, (parts, *shape[1:]), dtype, parts)


def _members(path: Path) -> Iterator[Listed]:
    """The arrays in a .npz file; the first of one that is cut short."""
    try:
        with ZipFile(path) as archive:
            for name in archive.namelist():
                if name.endswith(ARRAY_SUFFIX):
                    with archive.open(name) as stream:
                        header = _numpy_header(stream)
                    yield Listed(name.removesuffix(ARRAY_SUFFIX), header.shape, header.dtype)
    except BadZipFile:
        with path.open("rb") as file:
            if file.read(4) != _ZIP_HEAD:
                raise
        yield _first_member(path)


class _Unpacked:
    """The content of the first member of a ZIP file that is cut short: the part that is there."""

    def __init__(self, file: IO[bytes], packed: bool) -> None:
        self._file = file
        self._unpacker = zlib.decompressobj(-zlib.MAX_WBITS) if packed else None
        self._content = bytearray()

    def read(self, count: int) -> bytes:
        """Fewer bytes at the end."""
        while len(self._content) < count:
            piece = self._file.read(1 << 20)
            if not piece:
                break
            try:
                self._content += self._unpacker.decompress(piece) if self._unpacker else piece
            except zlib.error:
                break
        content = bytes(self._content[:count])
        del self._content[:count]
        return content


def _open_first_member(file: IO[bytes]) -> tuple[str, _Unpacked]:
    """The name and content of a ZIP file's first member (APPNOTE.TXT, local file header)."""
    header = file.read(30)
    method = int.from_bytes(header[8:10], "little")
    name_bytes, extra_bytes = (int.from_bytes(header[at : at + 2], "little") for at in (26, 28))
    name = file.read(name_bytes).decode("utf-8", "replace")
    file.seek(extra_bytes, 1)
    return name, _Unpacked(file, method == 8)


def _first_member(path: Path) -> Listed:
    with path.open("rb") as file:
        name, stream = _open_first_member(file)
        header = _numpy_header(stream)  # type: ignore[arg-type]
        read_bytes = 0
        needed = header.data_bytes
        ask_bytes(str(path), needed, path.stat().st_size)
        while read_bytes < needed and (piece := stream.read(1 << 20)):
            read_bytes += len(piece)
    return _whole_part(path, name.removesuffix(ARRAY_SUFFIX), header, min(read_bytes, needed))


# --- MATLAB and HDF5 ------------------------------------------------------------------------------


def _listed_matlab(path: Path) -> list[Listed]:
    """Raises FrameError for a text file, and for one that is cut short."""
    with path.open("rb") as file:
        head = file.read(_HDF5_BLOCK + len(_HDF5_SIGNATURE))
    if head.startswith(_HDF5_SIGNATURE) or head[_HDF5_BLOCK:] == _HDF5_SIGNATURE:
        return _named(call_isolated(path, list_hdf5, str(path), True))
    if (
        head
        and not head.startswith(_MATLAB_5)
        and all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head)
    ):
        raise FrameError(
            f"{path}: not a readable array: it is a text file (save -ascii); save it with -v7, or "
            "as .npy"
        )
    return _named(call_isolated(path, list_matlab, str(path)))


def list_matlab(path: str) -> list[list[Any]]:
    """[name, shape, dtype] of the numbers in a file, the number of the image first.

    Those in structures and cells have names such as `dive.frames`.  May crash, see `call_isolated`.
    """
    import scipy.io

    try:
        variables = scipy.io.whosmat(path)
    except Exception as error:  # SciPy raises nearly anything for damaged files
        raise FactoryError(f"{type(error).__name__}: {error}") from error
    rows = [
        [name, _stacked(shape), _MATLAB[kind]] for name, shape, kind in variables if kind in _MATLAB
    ]
    nested = [name for name, _, kind in variables if kind in ("struct", "cell")]
    if nested:
        loaded = scipy.io.loadmat(path, squeeze_me=True, variable_names=nested)
        for name in nested:
            rows += list(_list_nested(loaded[name], name, 0))
    return rows


def _list_nested(value: Any, name: str, depth: int) -> Iterator[list[Any]]:
    """The arrays in a structure of MATLAB, as SciPy loads it squeezed."""
    if depth > _MOST_DEPTH or not isinstance(value, np.ndarray | np.void):
        return
    fields = value.dtype.names
    if fields is not None:
        for field in fields:
            yield from _list_nested(_of_field(value, field), f"{name}.{field}", depth + 1)
        return
    array = _joined(value)
    if array is not None and array.dtype.kind in "uif":
        # Cells and arrays of structures count images first.
        is_joined = value.dtype.hasobject
        shape = list(array.shape) if is_joined else _stacked(array.shape)
        yield [name, shape, array.dtype.str]


def _of_field(value: Any, field: str) -> Any:
    """What a field of a structure, or of each structure of an array, holds."""
    content = value[field]
    is_one = isinstance(content, np.ndarray) and content.shape == () and content.dtype.hasobject
    return content.item() if is_one else content


def _joined(value: Any) -> Samples | None:
    """An array of numbers; of an array of equal ones, all behind each other; None for others."""
    if not value.dtype.hasobject:
        return np.asarray(value)
    arrays = [element for element in value.ravel() if isinstance(element, np.ndarray)]
    if not arrays or len(arrays) != value.size:
        return None
    if any(array.dtype.hasobject or array.shape != arrays[0].shape for array in arrays):
        return None
    return np.stack(arrays)


def list_hdf5(path: str, is_matlab: bool) -> list[list[Any]]:
    """[name, shape, dtype] of the numbers in an HDF5 file, the number of the image first.

    is_matlab: axes are the other way round.  May crash, see `call_isolated`.
    """
    import h5py

    rows: list[list[Any]] = []

    def visit(name: str, item: Any) -> None:
        if (
            not isinstance(item, h5py.Dataset)
            or name.startswith("#")
            or item.dtype.kind not in "uif"
        ):
            return
        kind = item.attrs.get("MATLAB_class", b"")
        if is_matlab and (kind.decode() if isinstance(kind, bytes) else str(kind)) not in _MATLAB:
            return
        shape = _stacked(item.shape[::-1]) if is_matlab else [int(size) for size in item.shape]
        rows.append([name, shape, item.dtype.str])

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except OSError as error:
        raise FactoryError(f"{error}") from error
    return rows


def is_shard(path: str) -> bool:
    """Whether an HDF5 file claims to be a shard of a dataset.  May crash, see `call_isolated`."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "schema" in file.attrs
    except OSError as error:
        raise FactoryError(f"{error}") from error


def _stacked(shape: Sequence[int]) -> list[int]:
    """The shape with the last axis first where it counts images, (H, W, N) or (H, W, 3, N)."""
    sizes = [int(size) for size in shape]
    single = len(sizes) == 2 or sizes[2:] == [3]  # four are rather four images
    return sizes if single else [sizes[-1], *sizes[:-1]]


def _load(path: Path, listed: Listed) -> Samples:
    """An array of a file.  May raise nearly anything."""
    suffix = path.suffix.lower()
    if suffix in HDF5_SUFFIXES:
        return _load_hdf5(path, listed, is_matlab=False)
    if suffix == ".mat":
        with path.open("rb") as file:
            head = file.read(_HDF5_BLOCK + len(_HDF5_SIGNATURE))
        if head.startswith(_HDF5_SIGNATURE) or head[_HDF5_BLOCK:] == _HDF5_SIGNATURE:
            return _load_hdf5(path, listed, is_matlab=True)
        return _load_matlab(path, listed)
    if suffix == ".npz":
        return _load_member(path, listed)
    if listed.parts is None:
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    with path.open("rb") as file:
        _numpy_header(file)
        offset = file.tell()
    return np.memmap(path, listed.dtype, "r", offset, listed.shape)


def _load_member(path: Path, listed: Listed) -> Samples:
    if listed.parts is None:
        with ZipFile(path) as archive, archive.open(listed.name + ARRAY_SUFFIX) as stream:
            return np.asarray(_FORMAT.read_array(stream, allow_pickle=False))
    with path.open("rb") as file:
        _, unpacked = _open_first_member(file)
        _numpy_header(unpacked)  # type: ignore[arg-type]
        content = unpacked.read(math.prod(listed.shape) * listed.dtype.itemsize)
    return np.frombuffer(content, listed.dtype).reshape(listed.shape)


def _load_matlab(path: Path, listed: Listed) -> Samples:
    import scipy.io

    # Where numbers are complex SciPy would leave out the imaginary part.
    warnings.simplefilter("error", np.exceptions.ComplexWarning)
    name, *fields = listed.name.split(".")
    is_cell = ("cell",) in [
        variable[2:] for variable in scipy.io.whosmat(path) if variable[0] == name
    ]
    if fields or is_cell:
        value = scipy.io.loadmat(path, squeeze_me=True, variable_names=[name])[name]
        for field in fields:
            value = _of_field(value, field)
        array = _joined(value)
        assert array is not None
        is_stack = not value.dtype.hasobject and _stacked(array.shape) != list(array.shape)
    else:
        # With its class: whole numbers of class double are stored as smaller ones.
        array = scipy.io.loadmat(path, mat_dtype=True, variable_names=[name])[name]
        is_stack = _stacked(array.shape) != list(array.shape)
    return np.asarray(np.moveaxis(array, -1, 0) if is_stack else array)


def _load_hdf5(path: Path, listed: Listed, *, is_matlab: bool) -> Samples:
    import h5py

    with h5py.File(path, "r") as file:
        array = np.asarray(file[listed.name][...])
    if not is_matlab:
        return array
    array = array.transpose()
    is_stack = _stacked(array.shape) != list(array.shape)
    return np.asarray(np.moveaxis(array, -1, 0) if is_stack else array)


def write_array(file: IO[bytes], images: Iterable[Samples], like: Samples) -> None:
    """Write a .npy file with the shape and dtype of `like`, image by image.

    images: (H, W) or (H, W, colours) in BGR order.  Raises OSError.
    """
    dtype = like.dtype.newbyteorder("=")
    _FORMAT.write_array_header_1_0(
        file, {"descr": dtype.str, "fortran_order": False, "shape": like.shape}
    )
    for image in images:
        file.write(np.ascontiguousarray(swapped(image), dtype).tobytes())
