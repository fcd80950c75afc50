"""From files to a Frame: colour images, depth maps (TIFF, PNG, JPEG, .npy), undistortion.

Pillow decodes, because it refuses a truncated file where other libraries return half a picture.
Pillow and OpenCV are imported inside the functions so that importing settings stays light.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field

from ..errors import FrameError
from ..frame import Frame, FrameRef, Intrinsics, checked
from ..quiet import quiet_stderr
from ..small_files import one_line
from .base import INTEGERS_PER_M, SceneSettings

# Pillow modes whose conversion to RGB loses nothing but transparency.
_COLOUR_MODES = frozenset({"RGB", "RGBA", "RGBX", "L", "LA", "P", "PA", "YCbCr"})


def _four(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 4:
        raise ValueError("give fx, fy, cx, cy in pixels, for example [525, 525, 319.5, 239.5]")
    return value


_Positive = Annotated[float, Field(gt=0)]

# The `intrinsics` key of readers: fx, fy, cx, cy in pixels of the images as they are.
Pinhole = Annotated[tuple[_Positive, _Positive, float, float], BeforeValidator(_four)]


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
        what = "no regular file" if os.path.lexists(path) else "no such file"
        raise FrameError(f"{path}: {what}; copy or download the file again")
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


def scaled(
    intrinsics: Intrinsics, calibrated_size: tuple[int, int], size: tuple[int, int]
) -> Intrinsics:
    """`intrinsics` of (width, height) `calibrated_size` for the same view at `size`.

    Pixel centres are at whole numbers, so the principal point scales about -0.5.  The distortion
    acts on normalised coordinates and stays.
    """
    x, y = size[0] / calibrated_size[0], size[1] / calibrated_size[1]
    if (x, y) == (1.0, 1.0):
        return intrinsics
    return Intrinsics(
        intrinsics.fx * x,
        intrinsics.fy * y,
        (intrinsics.cx + 0.5) * x - 0.5,
        (intrinsics.cy + 0.5) * y - 0.5,
        intrinsics.distortion,
    )


def finished_frame(
    ref: FrameRef,
    rgb: npt.NDArray[np.uint8],
    depth_m: npt.NDArray[np.float32],
    intrinsics: Intrinsics,
    settings: SceneSettings,
    *,
    undistort: bool = False,
) -> Frame:
    """A checked frame with z depth, undistorted on demand.

    rgb: (H, W, 3) uint8.  depth_m: (H, W) float32, z or slant range as `settings.depth_kind` says.
    intrinsics: of this image size.  Raises FrameError that names the depth file (`ref.paths[1]`).

    The files are checked before anything is made of them (a message about pixels must be about
    the file's pixels) and once more after undistortion, which moves pixels out of the picture.
    """
    try:
        frame = checked(Frame(ref, rgb, depth_m, intrinsics), bad_depth=settings.bad_depth)
        if undistort and intrinsics.distortion:
            rgb, depth_m = undistorted(frame.rgb, frame.depth_m, intrinsics)
            flat = replace(intrinsics, distortion=())
            frame = checked(replace(frame, rgb=rgb, depth_m=depth_m, intrinsics=flat))
        if settings.depth_kind == "range":
            frame = replace(frame, depth_m=z_from_range(frame.depth_m, frame.intrinsics))
        return frame
    except FrameError as error:
        raise FrameError(f"{error} [{ref.paths[1]}]") from error


def undistorted(
    rgb: npt.NDArray[np.uint8], depth_m: npt.NDArray[np.float32], intrinsics: Intrinsics
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """The images a lens without distortion would have made, with the same camera matrix.

    rgb: (H, W, 3) uint8, interpolated linearly.  depth_m: (H, W) float32, nearest neighbour (a
    mean of two surfaces would be neither).  Pixels that the lens did not see become 0.
    """
    import cv2

    x, y = _distorting_maps(intrinsics, depth_m.shape)
    flat_rgb = cv2.remap(rgb, x, y, cv2.INTER_LINEAR)
    flat_depth = cv2.remap(depth_m, x, y, cv2.INTER_NEAREST)
    return np.asarray(flat_rgb, dtype=np.uint8), np.asarray(flat_depth, dtype=np.float32)


@lru_cache(maxsize=4)
def _distorting_maps(lens: Intrinsics, shape: tuple[int, ...]) -> tuple[npt.NDArray[Any], ...]:
    import cv2

    camera = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    distortion, size = np.array(lens.distortion), (shape[1], shape[0])
    return cv2.initUndistortRectifyMap(camera, distortion, np.eye(3), camera, size, cv2.CV_32FC1)


def z_from_range(
    range_m: npt.NDArray[np.float32], intrinsics: Intrinsics
) -> npt.NDArray[np.float32]:
    """(H, W) float32 slant range in metres -> z along the optical axis; 0 stays 0.

    z = r / sqrt(1 + ((u - cx) / fx)^2 + ((v - cy) / fy)^2), the inverse of the pinhole
    back-projection that later turns z into points, so the point's distance is r.
    """
    x, y = intrinsics.directions(*range_m.shape)
    stretch = np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    return np.asarray(range_m / stretch, dtype=np.float32)
