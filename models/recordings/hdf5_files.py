"""HDF5 files of images, those that MATLAB writes among them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.common.errors import FactoryError
from .base import Samples
from .listed_arrays import Listed, Row

MATLAB_DTYPES = {"double": "f8", "single": "f4"} | {
    f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4)
}
"""MATLAB's class -> dtype; the others (logical, char, cell, sparse) are no images."""


def list_hdf5(path: str, is_matlab: bool) -> list[Row]:
    """[name, shape, dtype] of the numbers in an HDF5 file, the number of the image first.

    is_matlab: axes are the other way round.  May crash, see `call_isolated`.
    """
    import h5py

    rows: list[Row] = []

    def visit(name: str, item: Any) -> None:
        if (
            not isinstance(item, h5py.Dataset)
            or name.startswith("#")
            or item.dtype.kind not in "uif"
        ):
            return
        kind = item.attrs.get("MATLAB_class", b"")
        if (
            is_matlab
            and (kind.decode() if isinstance(kind, bytes) else str(kind)) not in MATLAB_DTYPES
        ):
            return
        shape = images_first(item.shape[::-1]) if is_matlab else [int(size) for size in item.shape]
        rows.append([name, shape, item.dtype.str])

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except OSError as error:
        raise FactoryError(f"{error}") from error
    return rows


def _matlab_class(dataset: Any) -> str:
    kind = dataset.attrs.get("MATLAB_class", b"")
    return kind.decode() if isinstance(kind, bytes) else str(kind)


def is_shard(path: str) -> bool:
    """Whether an HDF5 file claims to be a shard of a dataset.  May crash, see `call_isolated`."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "schema" in file.attrs
    except OSError as error:
        raise FactoryError(f"{error}") from error


def images_first(shape: Sequence[int]) -> list[int]:
    """The shape with the last axis first where it counts images, (H, W, N) or (H, W, 3, N)."""
    sizes = [int(size) for size in shape]
    single = len(sizes) == 2 or sizes[2:] == [3]  # four are rather four images
    return sizes if single else [sizes[-1], *sizes[:-1]]


def load_hdf5(path: Path, listed: Listed, *, is_matlab: bool) -> Samples:
    """An array of an HDF5 file.  May raise nearly anything."""
    import h5py

    with h5py.File(path, "r") as file:
        array = np.asarray(file[listed.name][...])
    if not is_matlab:
        return array
    array = array.transpose()
    is_stack = images_first(array.shape) != list(array.shape)
    return np.asarray(np.moveaxis(array, -1, 0) if is_stack else array)
