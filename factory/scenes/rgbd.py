"""From arrays as they were on disk to a Frame as the factory wants it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..frame import Frame, FrameRef, Intrinsics, checked
from .base import SceneSettings
from .calibration import undistorted, z_from_range


def finished_frame(
    ref: FrameRef,
    rgb: npt.NDArray[np.uint8],
    depth_m: npt.NDArray[np.float32],
    intrinsics: Intrinsics,
    settings: SceneSettings,
    *,
    undistort: bool = False,
    world_from_camera: npt.NDArray[np.float64] | None = None,
) -> Frame:
    """A checked frame with z depth, undistorted on demand.

    rgb: (H, W, 3) uint8.  depth_m: (H, W) float32, z or slant range as `settings.depth_kind` says.
    intrinsics: of this image size.  Raises FrameError that names the depth file (`ref.paths[1]`).

    The files are checked before anything is made of them (a message about pixels must be about
    the file's pixels) and once more after undistortion, which moves pixels out of the picture.
    """
    try:
        frame = checked(
            Frame(ref, rgb, depth_m, intrinsics, world_from_camera), bad_depth=settings.bad_depth
        )
        if undistort and intrinsics.distortion:
            rgb, depth_m = undistorted(frame.rgb, frame.depth_m, intrinsics)
            flat = replace(intrinsics, distortion=())
            frame = checked(replace(frame, rgb=rgb, depth_m=depth_m, intrinsics=flat))
        if settings.depth_kind == "range":
            frame = replace(frame, depth_m=z_from_range(frame.depth_m, frame.intrinsics))
        return frame
    except FrameError as error:
        raise FrameError(f"{error} [{ref.paths[1]}]") from error
