"""MATLAB files of images, of every version."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.isolated import call_isolated
from .hdf5_files import MATLAB_DTYPES, list_hdf5, load_hdf5, matlab_row, with_images_first
from .listed_arrays import Listed, Row, listed_of_rows

_HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_HDF5_BLOCK = 512  # bytes that MATLAB writes before it
_MATLAB_5 = b"MATLAB 5.0 MAT-file"
_MOST_DEPTH = 8  # of structures in structures


def list_mat(path: Path) -> list[Listed]:
    """The arrays in a file.

    Raises FrameError for a text file, FactoryError for one that is cut short.
    """
    head = _head(path)
    if _is_hdf5(head):
        return listed_of_rows(call_isolated(path, list_hdf5, str(path), True))
    if _is_text(head):
        raise FrameError(
            f"{path}: not a readable array: it is a text file (save -ascii); save it with -v7, or "
            "as .npy"
        )
    return listed_of_rows(call_isolated(path, list_matlab, str(path)))


def load_mat(path: Path, listed: Listed) -> Array:
    """An array of a file, the number of the image first.  May raise nearly anything."""
    if _is_hdf5(_head(path)):
        return load_hdf5(path, listed, is_matlab=True)
    with warnings.catch_warnings():
        # Where numbers are complex SciPy would leave out the imaginary part.
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        return _load_matlab_5(path, listed)


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HDF5_BLOCK + len(_HDF5_SIGNATURE))


def _is_hdf5(head: bytes) -> bool:
    """Whether a file is of version 7.3, which is HDF5."""
    return head.startswith(_HDF5_SIGNATURE) or head[_HDF5_BLOCK:] == _HDF5_SIGNATURE


def _is_text(head: bytes) -> bool:
    if not head or head.startswith(_MATLAB_5):
        return False
    return all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head)


def list_matlab(path: str) -> list[Row]:
    """[name, shape, dtype] of the numbers in a file, the number of the image first.

    Those in structures and cells have names such as `dive.frames`.  May crash, see `call_isolated`.
    """
    import scipy.io

    try:
        variables = scipy.io.whosmat(path)
    except Exception as error:  # SciPy raises nearly anything for damaged files
        raise FactoryError(f"{type(error).__name__}: {error}") from error
    rows = [
        matlab_row(name, shape, MATLAB_DTYPES[kind])
        for name, shape, kind in variables
        if kind in MATLAB_DTYPES
    ]
    nested = [name for name, _, kind in variables if kind in ("struct", "cell")]
    if nested:
        loaded = scipy.io.loadmat(path, squeeze_me=True, variable_names=nested)
        for name in nested:
            rows += list(_list_nested(loaded[name], name, 0))
    return rows


def _list_nested(value: Any, name: str, depth: int) -> Iterator[Row]:
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
        row: Row = [name, list(array.shape), array.dtype.str]
        yield row if is_joined else matlab_row(name, array.shape, array.dtype.str)


def _of_field(value: Any, field: str) -> Any:
    """What a field of a structure, or of each structure of an array, holds."""
    content = value[field]
    is_one = isinstance(content, np.ndarray) and content.shape == () and content.dtype.hasobject
    return content.item() if is_one else content


def _joined(value: Any) -> Array | None:
    """An array of numbers; of an array of equal ones, all behind each other; None for others."""
    if not value.dtype.hasobject:
        return np.asarray(value)
    arrays = [element for element in value.ravel() if isinstance(element, np.ndarray)]
    if not arrays or len(arrays) != value.size:
        return None
    if any(array.dtype.hasobject or array.shape != arrays[0].shape for array in arrays):
        return None
    return np.stack(arrays)


def _load_matlab_5(path: Path, listed: Listed) -> Array:
    import scipy.io

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
        return array if value.dtype.hasobject else with_images_first(array)
    # With its class: whole numbers of class double are stored as smaller ones.
    array = scipy.io.loadmat(path, mat_dtype=True, variable_names=[name])[name]
    return with_images_first(np.asarray(array))
