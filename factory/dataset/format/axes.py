"""The axes of image stacks, read from a file that may be damaged."""

from __future__ import annotations

import h5py
import numpy as np

from ...errors import FactoryError
from .layers import CAMERA_LAYERS, ECHO_FOLDER
from .sample import Axis

# First byte, end and name of a piece of data.
Place = tuple[int, int, str]


def image_axes(stack: h5py.Dataset) -> tuple[Axis, Axis]:
    """Row and column axes of an image stack.  Raises FactoryError when one cannot be read."""
    _check_scale_references(stack)
    return _axis(_scale(stack, 1)), _axis(_scale(stack, 2))


def axis_names(stack: h5py.Dataset) -> tuple[str, ...]:
    """The names of both: what is asked of every layer of a shard, whose axes are the same.

    The pictures of the camera and the lists of echoes have none.
    """
    name = str(stack.name).lstrip("/")
    if name in CAMERA_LAYERS or name.startswith(ECHO_FOLDER):
        return ()
    _check_scale_references(stack)
    return _name(_scale(stack, 1)), _name(_scale(stack, 2))


def contiguous_place(dataset: h5py.Dataset, name: str, file_bytes: int) -> list[Place]:
    """Where a dataset lies that is stored in one piece, as it must be; nothing for an empty one."""
    if dataset.id.get_create_plist().get_layout() != h5py.h5d.CONTIGUOUS:
        raise FactoryError(f"/{name} is stored in chunks; the schema keeps it in one piece")
    size = int(np.prod(dataset.shape, dtype=np.int64)) * dataset.id.get_type().get_size()
    if not size:
        return []
    start = dataset.id.get_offset()
    if start is None or start + size > file_bytes or dataset.id.get_storage_size() != size:
        raise FactoryError(f"/{name} is not where the file says; generate it again")
    return [(start, start + size, f"/{name}")]


def _scale(stack: h5py.Dataset, dimension: int) -> h5py.Dataset:
    size = stack.shape[dimension]
    try:
        scale = stack.dims[dimension][0] if len(stack.dims[dimension]) else None
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise FactoryError(f"the axes of {stack.name} are damaged; generate it again") from error
    if scale is None or scale.shape != (size,) or scale.dtype.kind not in "iuf":
        raise FactoryError(f"dimension {dimension} of {stack.name} has no axis of {size} numbers")
    contiguous_place(scale, f"axes/{_name(scale)}", scale.file.id.get_filesize())
    return scale


def _axis(scale: h5py.Dataset) -> Axis:
    texts = [str(scale.attrs.get(key, "")) for key in ("units", "description")]
    return Axis(_name(scale), texts[0], np.asarray(scale[()], dtype=np.float64), texts[1])


def _name(scale: h5py.Dataset) -> str:
    return str(scale.name).removeprefix("/axes/")


def _check_scale_references(stack: h5py.Dataset) -> None:
    """HDF5 follows whatever stands in DIMENSION_LIST, and dies of numbers there."""
    name = b"DIMENSION_LIST"
    if not h5py.h5a.exists(stack.id, name):
        raise FactoryError(f"{stack.name} has no axes; generate the shard again")
    attribute = h5py.h5a.open(stack.id, name)
    kind = attribute.get_type()
    listed = isinstance(kind, h5py.h5t.TypeVlenID) and attribute.shape == (stack.ndim,)
    if not listed or not kind.get_super().equal(h5py.h5t.STD_REF_OBJ):
        raise FactoryError(f"the axes of {stack.name} are damaged; generate it again")
