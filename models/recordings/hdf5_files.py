"""HDF5 files of images, those that MATLAB writes among them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError
from .listed_arrays import LEAST_SIDE_PX, Listed, Row

_COLOURS = (1, 2, 3, 4)
LEAST_BEAMS = 40
"""Fewest beams of a multibeam sonar, and pixels of the shorter side of its images."""
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
        rows.append(
            matlab_row(name, item.shape[::-1], item.dtype.str)
            if is_matlab
            else [name, [int(size) for size in item.shape], item.dtype.str]
        )

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except OSError as error:
        raise FactoryError(f"{error}") from error
    return rows


def matlab_row(name: str, shape: Sequence[int], dtype: str) -> Row:
    """The row of an array of MATLAB, with its own shape where either end may count images."""
    row: Row = [name, images_first(shape), dtype]
    return [*row, [int(size) for size in shape]] if is_ambiguous(shape) else row


def is_shard(path: str) -> bool:
    """Whether an HDF5 file claims to be a shard of a dataset.  May crash, see `call_isolated`."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return "schema" in file.attrs
    except OSError as error:
        raise FactoryError(f"{error}") from error


def counting_axis(shape: Sequence[int]) -> int | None:
    """The axis of an array of MATLAB that counts images, 0 or -1; None for a single image.

    MATLAB's own functions have it last, (H, W, N) or (H, W, 3, N); arrays that Python or a user
    arranged, first.  Sides too short for an image of a sonar tell which; otherwise it is the last.
    """
    sides = [int(side) for side in shape]
    if len(sides) == 2 or sides[2:] == [3]:  # with four at the end, four images
        return None
    if len(sides) == 4 and sides[3] in _COLOURS and sides[2] not in _COLOURS:
        return 0
    if len(sides) != 3:
        return -1
    # The shorter side of an image, if the last or the first axis counts images.
    shorter_if_last = min(sides[:2])
    shorter_if_first = min(sides[1:])
    for least in (LEAST_SIDE_PX, LEAST_BEAMS):
        if shorter_if_last < least <= shorter_if_first:
            return 0
        if shorter_if_first < least <= shorter_if_last:
            return -1
    return -1


def is_ambiguous(shape: Sequence[int]) -> bool:
    """Whether the first axis of an array of MATLAB could count images as well as the last."""
    sides = [int(side) for side in shape]
    is_three = len(sides) == 3 and counting_axis(sides) is not None
    if not is_three:
        return False
    # Its images would be large enough either way.
    return min(sides) >= LEAST_BEAMS


def images_first(shape: Sequence[int]) -> list[int]:
    """The shape of an array of MATLAB with the axis first that counts images."""
    sizes = [int(size) for size in shape]
    return [sizes[-1], *sizes[:-1]] if counting_axis(sizes) == -1 else sizes


def with_images_first(array: Array) -> Array:
    """An array of MATLAB with the axis first that counts images."""
    is_last = counting_axis(array.shape) == -1
    return np.asarray(np.moveaxis(array, -1, 0) if is_last else array)


def load_hdf5(path: Path, listed: Listed, *, is_matlab: bool) -> Array:
    """An array of an HDF5 file.  May raise nearly anything."""
    import h5py

    with h5py.File(path, "r") as file:
        array = np.asarray(file[listed.name][...])
    if not is_matlab:
        return array
    return with_images_first(array.transpose())
