"""NumPy files of several arrays (.npz): a ZIP archive of .npy files, read page by page."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from zipfile import ZipFile, ZipInfo

import numpy as np

from ..base import ARRAY_SUFFIX
from .base import MOST_BYTES, Arrays, Header, Page, header_of
from .npy import Pages

_FORMAT: Any = np.lib.format  # whose functions are not typed
_READ_HEADER = {(1, 0): _FORMAT.read_array_header_1_0, (2, 0): _FORMAT.read_array_header_2_0}


@dataclass
class _Member:
    header: Header
    begins: int
    columns_first: bool


class Npz(Arrays):
    """See `Arrays`."""

    def __init__(self, path: Path) -> None:
        self._zip = ZipFile(path)
        self._members: dict[str, _Member] = {}
        for one in self._zip.namelist():
            if one.endswith(ARRAY_SUFFIX):
                with self._zip.open(one) as stream:
                    member = _member(stream)
                if member is not None:
                    self._members[one.removesuffix(ARRAY_SUFFIX)] = member
        self.headers = {name: member.header for name, member in self._members.items()}
        self._open: tuple[str, IO[bytes]] | None = None
        self._whole: tuple[str, Page] | None = None

    def page(self, name: str, number: int) -> Page:
        """See `Arrays`."""
        member = self._members[name]
        header = member.header
        if member.columns_first:
            array = self._array(name)
            return array if header.single else array[number]
        if self._open is None or self._open[0] != name:
            self._open = name, self._zip.open(name + ARRAY_SUFFIX)
        stream = self._open[1]
        page = header.shape[1:]
        size = int(np.prod(page)) * header.dtype.itemsize
        stream.seek(member.begins + number * size)
        content = stream.read(size)
        if len(content) != size:
            raise ValueError("ends within a picture")
        return np.frombuffer(content, header.dtype).reshape(page)

    def _array(self, name: str) -> Page:
        """An array whose columns are stored one after the other has no pages in one piece."""
        if self._whole is None or self._whole[0] != name:
            if self._members[name].header.bytes > MOST_BYTES:
                raise MemoryError
            with self._zip.open(name + ARRAY_SUFFIX) as stream:
                read: Page = _FORMAT.read_array(stream, allow_pickle=False)
            self._whole = name, read
        return self._whole[1]

    def rewriting(self, name: str, path: Path) -> _Rewriting:
        """See `Arrays`."""
        return _Rewriting(self._zip, name + ARRAY_SUFFIX, self.headers[name], path)

    def close(self) -> None:
        """See `Arrays`."""
        self._zip.close()


def _member(stream: IO[bytes]) -> _Member | None:
    read = _READ_HEADER.get(_FORMAT.read_magic(stream))
    if read is None:
        return None  # newer ones are of tables with names that are no ASCII
    shape, columns_first, dtype = read(stream)
    header = header_of(shape, dtype)
    return _Member(header, stream.tell(), columns_first) if header else None


class _Rewriting:
    """The other members first, as they are; then the array."""

    def __init__(self, source: ZipFile, member: str, header: Header, path: Path) -> None:
        self._zip = ZipFile(path, "w", allowZip64=True)
        for info in source.infolist():
            if info.filename != member:
                with source.open(info) as old, self._zip.open(_as(info), "w") as new:
                    shutil.copyfileobj(old, new)
        self._stream = self._zip.open(_as(source.getinfo(member)), "w", force_zip64=True)
        self._pages = Pages(self._stream, header)  # type: ignore[arg-type]

    def add(self, page: Page) -> None:
        """See `Rewriting`."""
        self._pages.add(page)

    def close(self) -> None:
        """See `Rewriting`."""
        self._pages.close()
        self._zip.close()


def _as(info: ZipInfo) -> ZipInfo:
    made = ZipInfo(info.filename, info.date_time)
    made.compress_type = info.compress_type
    return made
