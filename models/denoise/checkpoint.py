"""The state of an unfinished recording as bytes, and back.

It is a pickle of the objects that a sequence is made of.  A file in an output folder is not to be
trusted, so reading makes arrays, containers and the classes of this project alone: no function is
called by name, and a checksum reveals bytes that were damaged or cut off.
"""

from __future__ import annotations

import io
import pickle
import struct
import zlib
from typing import Any

_CHECKSUM = struct.Struct("<QI")  # of the length and the bytes
_ROOT = __name__.removesuffix("models.denoise.checkpoint")
_OWN_MODULES = (f"{_ROOT}models.", f"{_ROOT}factory.dataset.fan_geometry")
_OTHERS = {
    "builtins": {"set", "frozenset", "float", "int", "bytearray", "complex"},
    "collections": {"Counter", "OrderedDict", "defaultdict", "deque"},
    "fractions": {"Fraction"},
    "numpy": {"dtype", "ndarray"},
    "numpy.core.multiarray": {"_reconstruct", "scalar"},
    "numpy._core.multiarray": {"_reconstruct", "scalar"},
    "numpy.core.numeric": {"_frombuffer"},
    "numpy._core.numeric": {"_frombuffer"},
    "pathlib": {"Path", "PosixPath", "WindowsPath", "PurePosixPath", "PureWindowsPath"},
}


def packed(state: object) -> bytes:
    """The state as bytes with their checksum."""
    content = pickle.dumps(state, protocol=5)
    return _CHECKSUM.pack(len(content), zlib.crc32(content)) + content


def unpacked(content: bytes) -> Any:
    """The state in bytes.  Raises ValueError when they are damaged, or hold anything else."""
    body = memoryview(content)[_CHECKSUM.size :]
    stated = (len(body), zlib.crc32(body))
    if len(content) < _CHECKSUM.size or _CHECKSUM.unpack_from(content) != stated:
        raise ValueError("damaged, or cut off")
    try:
        return _Unpickler(io.BytesIO(body)).load()
    except (pickle.UnpicklingError, AttributeError, ImportError, TypeError, KeyError) as error:
        raise ValueError(f"of another version ({error})") from error


class _Unpickler(pickle.Unpickler):
    """Refuses every class and function that a state does not need."""

    def find_class(self, module: str, name: str) -> Any:
        if name in _OTHERS.get(module, ()):
            return super().find_class(module, name)
        if module.startswith(_OWN_MODULES):
            value = super().find_class(module, name)
            if isinstance(value, type):
                return value
        raise pickle.UnpicklingError(f"{module}.{name} belongs to no state")
