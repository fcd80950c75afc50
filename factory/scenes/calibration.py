"""From arrays as they were on disk to a Frame: calibration, undistortion, range to z.

OpenCV is imported inside the function that needs it so that importing settings stays light.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field

from ..errors import FactoryError, FrameError
from ..frame import Frame, FrameRef, Intrinsics, checked
from .base import SceneSettings


def _four(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 4:
        raise ValueError("give fx, fy, cx, cy in pixels, for example [525, 525, 319.5, 239.5]")
    return value


_Positive = Annotated[float, Field(gt=0)]

# The `intrinsics` key of readers: fx, fy, cx, cy in pixels of the images as they are.
Pinhole = Annotated[tuple[_Positive, _Positive, float, float], BeforeValidator(_four)]

_MODEL = r"^\s*(?:Camera model|Distortion model):\s*(\w+)"
_KNOWN_MODELS = frozenset({"pinhole", "radtan", "none"})


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
        fx=intrinsics.fx * x,
        fy=intrinsics.fy * y,
        cx=(intrinsics.cx + 0.5) * x - 0.5,
        cy=(intrinsics.cy + 0.5) * y - 0.5,
        distortion=intrinsics.distortion,
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

    height, width = depth_m.shape
    x, y = _distorting_maps(intrinsics, width, height)
    flat_rgb = cv2.remap(rgb, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    flat_depth = cv2.remap(depth_m, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(flat_rgb, dtype=np.uint8), np.asarray(flat_depth, dtype=np.float32)


@lru_cache(maxsize=4)
def _distorting_maps(
    intrinsics: Intrinsics, width: int, height: int
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    import cv2

    camera = np.array(
        [[intrinsics.fx, 0, intrinsics.cx], [0, intrinsics.fy, intrinsics.cy], [0, 0, 1]]
    )
    distortion = np.array(intrinsics.distortion)
    x, y = cv2.initUndistortRectifyMap(
        camera, distortion, np.eye(3), camera, (width, height), cv2.CV_32FC1
    )
    return x, y


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


@lru_cache(maxsize=16)
def read_kalibr(path: Path) -> Intrinsics:
    """Intrinsics of cam0 from a Kalibr result text, `results-imucam`.

    Raises FactoryError unless it is a pinhole camera with radial-tangential distortion or none.
    """
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise _not_kalibr(path, error.strerror or "cannot be read") from error
    found = re.search(r"^\s*cam0\b.*?(?=^\s*cam1\b|\Z)", text, re.MULTILINE | re.DOTALL)
    camera = found.group() if found else text
    models = re.findall(_MODEL, camera, re.MULTILINE)
    other = next((model for model in models if model not in _KNOWN_MODELS), None)
    if other:
        raise _not_kalibr(path, f"the camera model is {other}")
    projection = _numbers(camera, "Focal length") + _numbers(camera, "Principal point")
    distortion = _numbers(camera, "Distortion coefficients")
    if len(projection) != 4 or not all(map(math.isfinite, projection)) or min(projection[:2]) <= 0:
        raise _not_kalibr(path, "no focal lengths and principal point of cam0")
    expected = 0 if "none" in models else 4
    if len(distortion) != expected or not all(map(math.isfinite, distortion)):
        raise _not_kalibr(path, f"not {expected} distortion coefficients of cam0")
    return Intrinsics(*projection, distortion=distortion)


def _numbers(text: str, label: str) -> tuple[float, ...]:
    """The numbers of a `label: [a, b, ...]` line; NaN for a word that is none."""
    found = re.search(rf"^\s*{label}:\s*\[([^\]]*)\]", text, re.MULTILINE)
    return tuple(map(_number, found[1].replace(",", " ").split())) if found else ()


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _not_kalibr(path: Path, why: str) -> FactoryError:
    return FactoryError(
        f"{path}: not a Kalibr pinhole + radtan result ({why}); restore the file, or remove it "
        "to use the built-in intrinsics"
    )
