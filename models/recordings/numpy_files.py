"""NumPy files of images: .npy and .npz, also where they are cut short."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple
from zipfile import BadZipFile, ZipFile

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from .base import ARRAY_SUFFIX, ask_bytes, swapped
from .listed_arrays import Listed, has_one_image

_FORMAT: Any = np.lib.format  # whose functions are not typed
_ZIP_HEAD = b"PK\x03\x04"


def list_npy(path: Path) -> Listed:
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
    if is_fortran or has_one_image(shape) or len(shape) < 3 or parts < 1:
        raise FrameError(
            f"{path}: not a readable array: it is cut short ({max(data_bytes, 0):,} of "
            f"{header.data_bytes:,} bytes) before its first whole image"
        )
    return Listed(name, (parts, *shape[1:]), dtype, parts)


def list_npz(path: Path) -> Iterator[Listed]:
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


def load_npy(path: Path, listed: Listed) -> Array:
    """The array of a .npy file, mapped.  May raise nearly anything."""
    if listed.parts is None:
        return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    with path.open("rb") as file:
        _numpy_header(file)
        offset = file.tell()
    return np.memmap(path, listed.dtype, "r", offset, listed.shape)


def load_npz(path: Path, listed: Listed) -> Array:
    """An array of a .npz file.  May raise nearly anything."""
    if listed.parts is None:
        with ZipFile(path) as archive, archive.open(listed.name + ARRAY_SUFFIX) as stream:
            return np.asarray(_FORMAT.read_array(stream, allow_pickle=False))
    with path.open("rb") as file:
        _, unpacked = _open_first_member(file)
        _numpy_header(unpacked)  # type: ignore[arg-type]
        content = unpacked.read(math.prod(listed.shape) * listed.dtype.itemsize)
    return np.frombuffer(content, listed.dtype).reshape(listed.shape)


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
