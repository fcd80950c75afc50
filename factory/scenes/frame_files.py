"""From files to a Frame: colour images and depth maps (TIFF, PNG, JPEG, .npy).

Pillow decodes, because it refuses a truncated file where other libraries return half a picture.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..frame import Frame, FrameRef, Intrinsics, checked
from ..quiet import quiet_stderr
from ..small_files import one_line
from .base import INTEGERS_PER_M

# Pillow modes whose conversion to RGB loses nothing but transparency.
_COLOUR_MODES = frozenset({"RGB", "RGBA", "RGBX", "L", "LA", "P", "PA", "YCbCr"})


def read_rgb(path: Path) -> npt.NDArray[np.uint8]:
    """(H, W, 3) uint8 colour image; grey images are repeated in the three channels.

    Raises FrameError when the file is missing, damaged or not an 8-bit image.
    """
    image = _decoded(path)
    mode = getattr(image, "mode", "none")
    if mode not in _COLOUR_MODES:
        raise FrameError(
            f"{path}: colour image must be 8-bit RGB or grey, this one has Pillow's mode {mode}; "
            "convert it"
        )
    return np.ascontiguousarray(np.asarray(image.convert("RGB"), dtype=np.uint8))


def read_depth(path: Path, units_per_m: float | None = None) -> npt.NDArray[np.float32]:
    """(H, W) float32 depth in metres, exactly as stored: NaN, negatives and 0 are kept.

    units_per_m: what the file's numbers are divided by (1000: millimetres); None: integers by
        `INTEGERS_PER_M`, and floating-point numbers are metres already.
    Raises FrameError when the file is missing, damaged or not a single-channel depth map.
    """
    stored = np.asarray(_decoded(path))
    if stored.ndim != 2:
        raise FrameError(f"{path}: depth must be one channel (H, W), got shape {stored.shape}")
    whole = stored.dtype.kind in "iu" and stored.dtype.itemsize > 1
    if not whole and stored.dtype.kind != "f":
        raise FrameError(
            f"{path}: depth is stored as {stored.dtype}, which holds no distances; "
            "give floating-point metres or integers of 16 bits or more"
        )
    # Half floats would overflow at what many a scale is.
    exact = stored.astype(np.promote_types(stored.dtype, np.float32), copy=False)
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite: checked later
        depth_m = exact / (units_per_m or (INTEGERS_PER_M if whole else 1.0))
        return np.ascontiguousarray(depth_m, dtype=np.float32)


def _decoded(path: Path) -> Any:
    """A Pillow image with all its pixels in memory, or the array of an .npy."""
    from PIL import Image

    if not os.path.isfile(path):  # a pipe may make wait for ever
        raise FrameError(f"{path}: no such file; copy or download the file again")
    try:
        # libtiff writes straight to the process's stderr what the exception says.
        with quiet_stderr(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if path.suffix.lower() == ".npy":
                return np.load(path, allow_pickle=False)
            with Image.open(path) as image:
                image.load()
                return image
    except MemoryError:
        raise
    except Exception as error:  # a damaged file makes decoders raise nearly anything
        reason = one_line(error) or type(error).__name__
        raise FrameError(
            f"{path}: truncated or damaged file ({reason}); copy or download the file again"
        ) from error


def read_frame(
    ref: FrameRef,
    rgb: npt.NDArray[np.uint8],
    depth_m: npt.NDArray[np.float32],
    intrinsics: Intrinsics,
    bad_depth: str,
) -> Frame:
    """A checked frame of what was read; see `Frame`.  Raises FrameError that names the depth file.

    bad_depth: see `simnfnd.factory.frame.checked`.
    """
    try:
        return checked(Frame(ref, rgb, depth_m, intrinsics), bad_depth=bad_depth)
    except FrameError as error:
        raise FrameError(f"{error} [{ref.paths[1]}]") from error
