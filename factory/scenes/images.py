"""Colour images and depth maps from files: TIFF (LZW and others), PNG, JPEG, NumPy arrays.

Pillow decodes, because it refuses a truncated file where other libraries return half a picture.
It is imported inside the functions so that importing the settings of a reader stays light.
"""

from __future__ import annotations

import contextlib
import stat
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..quiet import quiet_stderr
from .base import INTEGERS_PER_M

# Pillow modes whose conversion to RGB loses nothing but transparency.
_COLOUR_MODES = frozenset({"RGB", "RGBA", "RGBX", "L", "LA", "P", "PA", "YCbCr"})


def read_rgb(path: Path) -> npt.NDArray[np.uint8]:
    """(H, W, 3) uint8 colour image; grey images are repeated in the three channels.

    Raises FrameError when the file is missing, damaged or not an 8-bit image.
    """
    image = _decoded(path)
    if image.mode not in _COLOUR_MODES:
        raise FrameError(
            f"{path}: colour image must be 8-bit RGB or grey, this one has Pillow's mode "
            f"{image.mode}; convert it"
        )
    coloured = image if image.mode == "RGB" else image.convert("RGB")
    return np.ascontiguousarray(np.asarray(coloured, dtype=np.uint8))


def read_depth(path: Path, units_per_m: float | None) -> npt.NDArray[np.float32]:
    """(H, W) float32 depth in metres, exactly as stored: NaN, negatives and 0 are kept.

    units_per_m: what the file's numbers are divided by (1000: millimetres); None: integers by
        `INTEGERS_PER_M`, and floating-point numbers are metres already.
    Raises FrameError when the file is missing, damaged or not a single-channel depth map.
    """
    if path.suffix.lower() == ".npy":
        with _readable(path):
            stored = np.load(path, allow_pickle=False)
    else:
        stored = np.asarray(_decoded(path))
    if stored.ndim != 2:
        raise FrameError(f"{path}: depth must be one channel (H, W), got shape {stored.shape}")
    if stored.dtype.kind == "f":
        if units_per_m is not None:
            # Half floats would overflow at what many a scale is.
            stored = stored.astype(np.promote_types(stored.dtype, np.float32)) / units_per_m
        with np.errstate(over="ignore"):  # too large for float32 becomes infinite: checked later
            return np.ascontiguousarray(stored, dtype=np.float32)
    if stored.dtype.kind in "iu" and stored.dtype.itemsize > 1:
        return np.ascontiguousarray(stored / (units_per_m or INTEGERS_PER_M), dtype=np.float32)
    raise FrameError(
        f"{path}: depth is stored as {stored.dtype}, which holds no distances; "
        "give floating-point metres or integers of 16 bits or more"
    )


def _decoded(path: Path) -> Any:
    """A Pillow image with all its pixels in memory."""
    from PIL import Image

    with _readable(path), Image.open(path) as image:
        image.load()
        return image


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise FrameError for what cannot be read, and for a pipe, which may make wait for ever.

    Decoders are silenced: libtiff writes straight to the process's stderr what the exception says.
    """
    try:
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise FrameError(f"{path}: no regular file; copy or download the file again")
        with quiet_stderr(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except FileNotFoundError as error:
        raise FrameError(f"{path}: no such file") from error
    except (MemoryError, FrameError):
        raise
    except Exception as error:  # a damaged file makes decoders raise nearly anything
        raise FrameError(f"{path}: {_damage(error)}; copy or download the file again") from error


def _damage(error: Exception) -> str:
    if isinstance(error, PermissionError | IsADirectoryError):
        return f"cannot be read ({error.strerror})"
    text = " ".join(str(error).split()) or type(error).__name__
    return f"truncated or damaged file ({text[:120]})"
