"""HDF5 files of anybody, MATLAB's of version 7.3 among them; shards of this program are not these.

Links to other files and data that lie in them are not followed, and filters are HDF5's own.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ....factory.dataset.read.reader import look_at
from ....factory.errors import FactoryError
from .base import MATLAB_CLASSES, Arrays, Header, Page, header_of

_MOST_CHUNK_BYTES = 1 << 29
_MOST_NAMES = 100_000
_FILTERS = (
    *(h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32),
    *(h5py.h5z.FILTER_SZIP, h5py.h5z.FILTER_LZF, h5py.h5z.FILTER_SCALEOFFSET),
    h5py.h5z.FILTER_NBIT,
)
_NUMBERS = tuple(name.encode() for name in MATLAB_CLASSES)


class Hdf5(Arrays):
    """See `Arrays`.  matlab: axes lie the other way round."""

    def __init__(self, path: Path, *, matlab: bool = False) -> None:
        # HDF5 may crash over a damaged file, so another process looks at it first.
        self.headers = look_at(path, list_arrays, path, matlab)
        self._path, self._matlab = path, matlab
        self._file = h5py.File(path, "r")

    def page(self, name: str, number: int) -> Page:
        """See `Arrays`."""
        dataset = self._file[name]
        page: Page = dataset[()] if self.headers[name].single else dataset[number]
        return page.transpose() if self._matlab else page

    def rewriting(self, name: str, path: Path) -> _Rewriting:
        """See `Arrays`."""
        shutil.copyfile(self._path, path)
        return _Rewriting(path, name, self.headers[name], matlab=self._matlab)

    def close(self) -> None:
        """See `Arrays`."""
        self._file.close()


class _Rewriting:
    """Pages take the place of the old ones in a copy, with chunks and filters as they are."""

    def __init__(self, path: Path, name: str, header: Header, *, matlab: bool) -> None:
        self._file = h5py.File(path, "r+")
        self._dataset, self._single, self._matlab = self._file[name], header.single, matlab
        self._count = 0

    def add(self, page: Page) -> None:
        """See `Rewriting`."""
        page = page.transpose() if self._matlab else page
        self._dataset[() if self._single else self._count] = page
        self._count += 1

    def close(self) -> None:
        """See `Rewriting`."""
        self._file.close()


def list_arrays(path: Path, matlab: bool) -> dict[str, Header]:
    """Name -> array of pictures.  May crash, for which it runs in a process of its own."""
    found: dict[str, Header] = {}
    count = 0

    def look(name: str, one: Any) -> bool | None:
        nonlocal count
        count += 1
        if isinstance(one, h5py.Dataset) and _usable(one, matlab):
            # MATLAB's axes come the other way round, its pictures by columns.
            shape = one.shape[::-1] if matlab else one.shape
            header = header_of(shape, one.dtype, matlab=matlab)
            if header is not None:
                one[(0,) * one.ndim]
                found[name] = header
        return True if count > _MOST_NAMES else None

    with h5py.File(path, "r") as file:
        if str(file.attrs.get("schema", "")).startswith("simnfnd"):
            raise FactoryError(f"{path}: a file of a SimNFND dataset, no array of pictures")
        file.visititems(look)  # which follows no links
    return found


def _usable(dataset: h5py.Dataset, matlab: bool) -> bool:
    if dataset.dtype.kind not in "uif" or dataset.shape is None:
        return False
    if dataset.external or dataset.is_virtual:
        return False
    if matlab and dataset.attrs.get("MATLAB_class", b"") not in _NUMBERS:
        return False
    plist = dataset.id.get_create_plist()
    filters = [plist.get_filter(one)[0] for one in range(plist.get_nfilters())]
    chunk = np.prod(dataset.chunks or (1,), dtype=object) * dataset.dtype.itemsize
    return all(one in _FILTERS for one in filters) and chunk <= _MOST_CHUNK_BYTES
