"""Arrays in MATLAB and HDF5 files: listed in an isolated process, then loaded.

What lists a file may crash, see `call_isolated`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HDF5_BLOCK = 512  # bytes that MATLAB writes before it
_MATLAB_5 = b"MATLAB 5.0 MAT-file"
_DTYPES = {"double": "f8", "single": "f4"} | {
    f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4)
}
"""MATLAB's class -> dtype; the others (logical, char, cell, sparse) are no images."""


class StoredArray(NamedTuple):
    """An array of numbers in a file, as an isolated process can return it.

    name: in structures such as `dive.frames`.  shape: as it is stored.
    is_matlab: whether MATLAB may have ordered its axes.
    """

    name: str
    shape: Sequence[int]
    dtype: str
    is_matlab: bool = False


def is_shard(path: str) -> bool:
    """Whether an HDF5 file claims to be a shard of a dataset."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "schema" in file.attrs
    except OSError as error:
        raise FactoryError(f"{error}") from error


def list_hdf5(path: str, is_matlab: bool = False) -> list[StoredArray]:
    """The arrays of an HDF5 file.  is_matlab: its axes are the other way round."""
    import h5py

    rows: list[StoredArray] = []

    def visit(name: str, item: Any) -> None:
        is_array = isinstance(item, h5py.Dataset) and item.dtype.kind in "uif"
        if not is_array or name.startswith("#"):
            return
        shape = [int(size) for size in item.shape]
        if not is_matlab:
            rows.append(StoredArray(name, shape, item.dtype.str))
        elif np.bytes_(item.attrs.get("MATLAB_class", b"")).decode() in _DTYPES:
            rows.append(StoredArray(name, shape[::-1], item.dtype.str, is_matlab=True))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except OSError as error:
        raise FactoryError(f"{error}") from error
    return rows


def load_hdf5(path: Path, name: str) -> Array:
    """An array of an HDF5 file."""
    import h5py

    with h5py.File(path, "r") as file:
        return np.asarray(file[name][...])


def list_mat(path: str) -> list[StoredArray]:
    """The arrays of a MATLAB file.  Raises FactoryError for a text file, and for damage."""
    import scipy.io

    with Path(path).open("rb") as file:
        head = file.read(_HDF5_BLOCK + len(_HDF5_SIGNATURE))
    if _is_hdf5(head):
        return list_hdf5(path, is_matlab=True)
    is_text = all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head)
    if head and is_text and not head.startswith(_MATLAB_5):
        raise FactoryError("it is a text file (save -ascii); save it with -v7, or as .npy")
    try:
        variables = scipy.io.whosmat(path)
    except Exception as error:  # SciPy raises nearly anything for damaged files
        raise FactoryError(f"{type(error).__name__}: {error}") from error
    rows = [
        StoredArray(name, [int(size) for size in shape], _DTYPES[kind], is_matlab=True)
        for name, shape, kind in variables
        if kind in _DTYPES
    ]
    nested = [name for name, _, kind in variables if kind in ("struct", "cell")]
    if nested:
        loaded = scipy.io.loadmat(path, squeeze_me=True, variable_names=nested)
        for name in nested:
            rows += [part.listed for part in _parts_of(loaded[name], name)]
    return rows


def load_mat(path: Path, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Array:
    """An array of a MATLAB file, of this shape and dtype.  May raise nearly anything."""
    import scipy.io

    with path.open("rb") as file:
        head = file.read(_HDF5_BLOCK + len(_HDF5_SIGNATURE))
    if _is_hdf5(head):
        return load_hdf5(path, name).transpose()
    variable = name.partition(".")[0]
    value = scipy.io.loadmat(path, squeeze_me=True, variable_names=[variable])[variable]
    if value.dtype.names or value.dtype.hasobject:
        return next(part.array for part in _parts_of(value, variable) if part.listed.name == name)
    if value.dtype.kind == "c":
        raise ValueError("its numbers are complex")
    # MATLAB stores whole numbers of class double as smaller ones.
    return np.asarray(value, dtype).reshape(shape)


def _is_hdf5(head: bytes) -> bool:
    """Whether a file is of version 7.3, which is HDF5."""
    return head.startswith(_HDF5_SIGNATURE) or head[_HDF5_BLOCK:] == _HDF5_SIGNATURE


class _Part(NamedTuple):
    """An array of numbers in a structure or cell."""

    listed: StoredArray
    array: Array


def _parts_of(value: Any, name: str) -> Iterator[_Part]:
    """The arrays in a structure of MATLAB, as SciPy loads it squeezed.

    Cells, and structures of an array, count images first.
    """
    if not isinstance(value, np.ndarray | np.void):
        return
    if value.dtype.names is not None:
        for field in value.dtype.names:
            content = value[field]
            if isinstance(content, np.ndarray) and content.shape == () and content.dtype.hasobject:
                content = content.item()
            yield from _parts_of(content, f"{name}.{field}")
        return
    array = np.asarray(value)
    is_joined = array.dtype.hasobject
    if is_joined:
        elements = [element for element in array.ravel() if isinstance(element, np.ndarray)]
        shapes = {element.shape for element in elements if not element.dtype.hasobject}
        if len(elements) != array.size or len(shapes) != 1:
            return
        array = np.stack(elements)
    if array.dtype.kind in "uif":
        yield _Part(StoredArray(name, array.shape, array.dtype.str, not is_joined), array)
