"""From files to a Frame: colour images and depth maps (TIFF, PNG, JPEG, PFM, .npy).

Pillow decodes, because it refuses a truncated file where other libraries return half an image.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ...common.array_types import Array, Float32s, UInt8s
from ...common.errors import FrameError
from ...common.quiet import quiet_stderr
from ...common.small_files import one_line
from ...dataset.frame_ref import FrameRef
from ..frames.frame import LIKELY_M, Frame, Intrinsics, checked
from .base import INTEGERS_PER_M

# Pillow modes whose conversion to RGB loses nothing but transparency.
_COLOUR_MODES = frozenset({"RGB", "RGBA", "RGBX", "L", "LA", "P", "PA", "YCbCr"})
# Orientations that exchange width and height (Exif 2.32, tag Orientation).
_LYING_ORIENTATIONS = frozenset({5, 6, 7, 8})
_READABLE_DEPTH = (
    "give PNG or TIFF (16- or 32-bit integers, 32- or 64-bit floats), PFM, or .npy of (H, W)"
)

_INTEGER_TYPES = ("int16", "uint16", "int32", "uint32", "int64", "uint64")
# A share of the pixels that no surface at the largest storable distance takes.
_LEAST_MARKED_SHARE = 0.01
# What uint16 depth is commonly divided by, also before it is stored as floating-point metres.
_COMMON_SCALES = (1.0, 100.0, 256.0, 1000.0, 4000.0, 5000.0, 10000.0)


def read_rgb(path: Path) -> UInt8s:
    """(H, W, 3) uint8 colour image, upright; grey images are repeated in the three channels.

    An EXIF orientation is applied, as image viewers and OpenCV do.
    Raises FrameError when the file is missing, damaged or not an 8-bit image.
    """
    image = _decode(path)
    mode = getattr(image, "mode", "none")
    if mode not in _COLOUR_MODES:
        raise FrameError(
            f"{path}: colour image must be 8-bit RGB or grey, this one has Pillow's mode {mode}; "
            "convert it"
        )
    return np.ascontiguousarray(np.asarray(image.convert("RGB"), dtype=np.uint8))


def read_depth(path: Path, units_per_m: float | None = None) -> Float32s:
    """(H, W) float32 depth in metres; see `stored_depth` and `in_metres`."""
    return in_metres(stored_depth(path), units_per_m)


def stored_depth(path: Path) -> Array:
    """(H, W) depth exactly as stored: NaN, negatives and 0 are kept.

    dtype: integers of 16 bits or more, or floating point.
    Raises FrameError when the file is missing, damaged or not a single-channel depth map.
    """
    stored = np.asarray(_decode(path))
    if stored.ndim == 3 and stored.shape[2] == 1:
        stored = stored[:, :, 0]
    if stored.ndim != 2:
        raise FrameError(f"{path}: depth must be one channel (H, W), got shape {stored.shape}")
    is_integer = stored.dtype.kind in "iu" and stored.dtype.itemsize > 1
    if not is_integer and stored.dtype.kind != "f":
        raise FrameError(
            f"{path}: depth is stored as {stored.dtype}, which holds no distances; "
            "give floating-point metres or integers of 16 bits or more"
        )
    return stored


def in_metres(stored: Array, units_per_m: float | None = None) -> Float32s:
    """(H, W) float32 metres.

    units_per_m: what the stored numbers are divided by (1000: millimetres); None: integers by
        `INTEGERS_PER_M`, and floating-point numbers are metres already.
    """
    # Half floats would overflow at what many a scale is.
    exact = stored.astype(np.promote_types(stored.dtype, np.float32), copy=False)
    with np.errstate(over="ignore"):  # too large for float32 becomes infinite: checked later
        depth_m = exact / _divisor(stored, units_per_m)
        return np.ascontiguousarray(depth_m, dtype=np.float32)


def refuse_mark(path: Path, stored: Array, units_per_m: float | None) -> None:
    """Raise FrameError when the largest number marks pixels without a measurement.

    It does where many pixels hold it, and it is the largest of the stored type, of uint16 (also
    scaled before it became floating point), or a distance that no sonar reaches.
    """
    largest = float(stored.max(initial=0, where=np.isfinite(stored)))
    share = np.count_nonzero(stored == largest) / max(stored.size, 1)
    if largest <= 0 or share < _LEAST_MARKED_SHARE:
        return

    largest_m = largest / _divisor(stored, units_per_m)
    reason = _mark_reason(stored.dtype, largest, largest_m)
    if reason:
        raise FrameError(
            f"{path}: {100 * share:.0f} % of the depth is {largest:.8g} ({largest_m:.4g} m), "
            f"{reason}: no measurement? Set scenes.invalid_above_m={0.999 * largest_m:.4g} "
            "to leave these pixels out, or a larger value to keep them"
        )


def _mark_reason(dtype: np.dtype[Any], largest: float, largest_m: float) -> str:
    """Why a number that many pixels share is hardly a distance; empty when it may be one."""
    largest_integers = {float(np.iinfo(kind).max): kind for kind in _INTEGER_TYPES}
    if dtype.kind in "iu" and largest in largest_integers:
        return f"the largest number of {largest_integers[largest]}"
    if dtype.kind == "f":
        scaled = np.iinfo(np.uint16).max / np.array(_COMMON_SCALES)
        if np.isclose(largest, scaled, rtol=1e-6, atol=0).any():
            return "the largest number of uint16, scaled"
    if largest_m > LIKELY_M[1]:
        return f"farther than any imaging sonar sees ({LIKELY_M[1]:g} m)"
    return ""


def _divisor(stored: Array, units_per_m: float | None) -> float:
    return units_per_m or (INTEGERS_PER_M if stored.dtype.kind in "iu" else 1.0)


def image_size(path: Path) -> tuple[int, int] | None:
    """Width and height of an upright image by its header alone; None when it cannot be read."""
    from PIL import Image

    if not os.path.isfile(path):
        return None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as image:
                width, height = image.size
                # Pillow turns the size of a TIFF itself.
                lies = image.format != "TIFF" and _orientation(image) in _LYING_ORIENTATIONS
    except MemoryError:
        raise
    except Exception:  # what is wrong with it is said when it is loaded
        return None
    return (height, width) if lies else (width, height)


def _orientation(image: Any) -> int:
    from PIL import ExifTags

    stated = image.getexif().get(ExifTags.Base.Orientation, 1)
    return stated if stated in range(1, 9) else 1


def _decode(path: Path) -> Any:
    """An upright Pillow image with all its pixels in memory, or the array of an .npy."""
    from PIL import Image, ImageOps

    if not os.path.isfile(path):  # a pipe may make wait for ever
        raise FrameError(f"{path}: no such file; copy or download the file again")
    try:
        # libtiff writes straight to the process's stderr what the exception says.
        with quiet_stderr(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if path.suffix.lower() == ".npy":
                return np.load(path, allow_pickle=False)
            _teach_float64_tiff()
            with Image.open(path) as image:
                _seek_image(path, image)
                image.load()
                ImageOps.exif_transpose(image, in_place=True)
                return image
    except (MemoryError, FrameError):
        raise
    except Exception as error:  # a damaged file makes decoders raise nearly anything
        raise FrameError(f"{path}: {_undecodable(error)}") from error


def _seek_image(path: Path, image: Any) -> None:
    """Turn to the one image of a TIFF; raise FrameError where it holds several.

    Smaller copies and masks count for nothing, those before it neither.
    """
    from PIL import ExifTags

    count = getattr(image, "n_frames", 1) if image.format == "TIFF" else 1
    full_pages = []
    for number in range(count):
        image.seek(number)
        subfile_type = image.tag_v2.get(ExifTags.Base.NewSubfileType, 0) if count > 1 else 0
        if subfile_type in (0, 2):  # bits: a smaller copy, a page of several, a mask
            full_pages.append(number)
    image.seek(full_pages[0] if full_pages else 0)
    if len(full_pages) > 1:
        raise FrameError(
            f"{path}: holds {len(full_pages)} images; give each frame a file of its own"
        )


def _undecodable(error: Exception) -> str:
    """What keeps a file from being decoded: its format, or damage."""
    from PIL import UnidentifiedImageError

    # Pillow knows some formats, such as HDF5, by their names alone.
    is_foreign = "Object arrays" in str(error) or "cannot find loader" in str(error)
    if isinstance(error, UnidentifiedImageError) or is_foreign:
        return f"is of no format that is read, or damaged; {_READABLE_DEPTH}"
    reason = one_line(error) or type(error).__name__
    return f"truncated or damaged file ({reason}); copy or download the file again"


def _teach_float64_tiff() -> None:
    """Let Pillow read TIFFs of 64-bit floats, numpy's default, for which it has the decoders."""
    from PIL import TiffImagePlugin

    for photometric in (0, 1):
        for endian, raw_mode in ((b"II", "F;64F"), (b"MM", "F;64BF")):
            key = (endian, photometric, (3,), 1, (64,), ())
            TiffImagePlugin.OPEN_INFO.setdefault(key, ("F", raw_mode))


def read_frame(
    ref: FrameRef,
    rgb: UInt8s,
    depth_m: Float32s,
    intrinsics: Intrinsics,
    bad_depth: str,
) -> Frame:
    """A checked frame of what was read; see `Frame`.  Raises FrameError that names the depth file.

    bad_depth: see `simnfnd.factory.simulation.frames.frame.checked`.
    """
    try:
        return checked(Frame(ref, rgb, depth_m, intrinsics), bad_depth=bad_depth)
    except FrameError as error:
        raise FrameError(f"{error} [{ref.paths[1]}]") from error
