"""An RGBD frame as every reader delivers it, and the checks that no reader may skip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ...common.array_types import Bools, Float32s, Float64s, Floats, Int32s, Int64s, UInt8s, UInt16s
from ...common.errors import FrameError
from ...dataset.frame_ref import FrameRef

LIKELY_M = (0.005, 300.0)
"""Limits of a likely median depth: no imaging sonar sees farther, and no camera nearer."""

# Twice the principal point in widths (heights) of the image is 1 in its middle.
_LIKELY_CENTRE = (0.6, 1.6)
# Fewer measured pixels make a frame useless.
_LEAST_VALID = 16
BOX_FIELDS = 11


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole camera: focal lengths and principal point in pixels (OpenCV axes, x right, y down).

    `distortion` holds the radial-tangential coefficients (k1, k2, p1, p2), or nothing.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def directions(self, height: int, width: int) -> tuple[Float64s, Float64s]:
        """(W,) x / z of the columns and (H,) y / z of the rows: P = z K^-1 (u, v, 1)^T."""
        return (np.arange(width) - self.cx) / self.fx, (np.arange(height) - self.cy) / self.fy

    def misfit(self, width: int, height: int) -> str | None:
        """Why they cannot be those of an image of this size, with a remedy; None when they can.

        The principal point of a camera lies near the middle of its image: outside of it, or off the
        same way in both directions, the intrinsics are of an image of another size.
        """
        values = np.array([self.fx, self.fy, self.cx, self.cy])
        if not np.isfinite(values).all() or min(self.fx, self.fy) <= 0:
            shown = ", ".join(f"{value:.6g}" for value in values)
            return f"intrinsics fx, fy, cx, cy are {shown}; focal lengths are positive, in pixels"
        # 1 in the middle of the image.
        across = 2 * (self.cx + 0.5) / width
        down = 2 * (self.cy + 0.5) / height
        least, most = _LIKELY_CENTRE
        is_inside = min(across, down) >= 0 and max(across, down) < 2
        if is_inside and max(across, down) > least and min(across, down) < most:
            return None
        return (
            f"principal point {self.cx:g}, {self.cy:g} is not that of a {width}x{height} image; "
            "give fx, fy, cx, cy of the images as they are, in pixels"
        )


def turned(matrix: Float64s, points: Float64s) -> Float64s:
    """(N, 3) points times a (3, 3) matrix, summed in one order on every machine."""
    x, y, z = points.T
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix], axis=-1)


GROUND_STEPS = 24
"""Heights of the ground that are known around a recording's beginning, to each side."""
GROUND_STEP_M = 1.0


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Where a recording begins, for its moving objects.

    world_from_start: (4, 4) float64, pose of the camera at the first frame.
    ground_m: (N, N) float32, height of the ground at places `step_m` apart; the middle is the
        camera's place at the first frame, rows go along the world's y and columns along its x.
    """

    world_from_start: Float64s
    ground_m: Float32s
    step_m: float


class Body(Protocol):
    """A moving object in one frame, as its echoes need it."""

    @property
    def salt(self) -> int:
        """32 bits that tell its cells from those of the world and of other objects."""

    def camera_m(self, own_m: Floats) -> Float64s:
        """(N, 3) places in camera axes of (N, 3) places in the object's own axes, at rest."""


@dataclass(frozen=True, eq=False)
class MovingPixels:
    """The M pixels of a frame that show moving objects.

    pixel: (M,) int32 flat, ascending.  body: (M,) int32, index into `bodies`.
    own_m: (M, 3) float64 place on the object, in its own axes and at rest.
    alone_px: (B,) int64, pixels that each body would cover alone, beyond the image, too.
    hidden_px: (B,) int64, of those in the image, hidden by something nearer.
    """

    pixel: Int32s
    body: Int32s
    own_m: Float64s
    bodies: tuple[Body, ...]
    alone_px: Int64s
    hidden_px: Int64s


@dataclass(frozen=True, eq=False)
class Frame:
    """One RGBD frame.

    rgb: (H, W, 3) uint8.
    depth_m: (H, W) float32, distance along the optical axis (z, never slant range) in metres,
        0 = no measurement.
    intrinsics: of this very image size.
    world_from_camera: (4, 4) float64 pose, or None where the recording has none.
    segmentation: (H, W) uint8 object class, or None without labels.
    instance: (H, W) uint16 object number within the scene (0 = none), or None.
    time_s: when it was taken, seconds from any beginning, or None.
    altitude_m: height of the camera above the ground right under it, or None.
    boxes: (N, 11) float64 of the objects in the image, or None: number in `instance`, class; box
        around it, centre ahead, left, up (m), length, width, height (m), yaw from ahead to the left
        (rad), all in the camera's own axes; pixels it would cover alone; those hidden by others.
    surroundings: of a recording in which objects can move, or None.
    moving: pixels that show moving objects, or None where nothing moves.
    """

    ref: FrameRef
    rgb: UInt8s
    depth_m: Float32s
    intrinsics: Intrinsics
    world_from_camera: Float64s | None = None
    segmentation: UInt8s | None = None
    instance: UInt16s | None = None
    time_s: float | None = None
    altitude_m: float | None = None
    boxes: Float64s | None = None
    surroundings: Surroundings | None = None
    moving: MovingPixels | None = None

    @property
    def valid(self) -> Bools:
        """(H, W) bool: pixels that carry a depth."""
        return self.depth_m > 0


def checked(frame: Frame, *, bad_depth: str = "reject") -> Frame:
    """Return `frame` with clean depth, or raise FrameError that says what is wrong with it.

    bad_depth: "reject" refuses NaN, infinite and negative depths; "mask" makes them invalid (0).
    """
    name = frame.ref.name
    depth_m = frame.depth_m
    if frame.rgb.ndim != 3 or frame.rgb.shape[2] != 3 or frame.rgb.dtype != np.uint8:
        raise FrameError(
            f"{name}: colour image must be (H, W, 3) uint8, got {frame.rgb.shape} {frame.rgb.dtype}"
        )
    if depth_m.shape != frame.rgb.shape[:2]:
        h, w = depth_m.shape[:2]
        rgb_h, rgb_w = frame.rgb.shape[:2]
        raise FrameError(
            f"{name}: depth is {w}x{h} but colour is {rgb_w}x{rgb_h}; "
            "give a depth map registered to the colour image"
        )
    misfit = frame.intrinsics.misfit(depth_m.shape[1], depth_m.shape[0])
    if misfit is not None:
        raise FrameError(f"{name}: {misfit}")
    # Two looks tell that nothing is wrong, as nearly always; NaN compares false.
    if not (depth_m.size > 0 and depth_m.min() >= 0 and depth_m.max() < np.inf):
        nan = np.isnan(depth_m)
        infinite = np.isinf(depth_m)
        negative = ~infinite & (depth_m < 0)
        bad = nan | infinite | negative
        if bad_depth == "reject" and bad.any():
            raise FrameError(
                f"{name}: depth has {nan.sum()} NaN, {infinite.sum()} infinite, "
                f"{negative.sum()} negative pixels; repair the file, or set "
                "scenes.bad_depth=mask to treat them as unmeasured"
            )
        depth_m = np.where(bad, np.float32(0), depth_m)
    valid = int(np.count_nonzero(depth_m > 0))
    if valid < _LEAST_VALID:
        raise FrameError(f"{name}: depth has only {valid} valid pixels; nothing to render")
    depth_m = np.ascontiguousarray(depth_m, dtype=np.float32)
    measured = depth_m[::4, ::4] if min(depth_m.shape) > 64 else depth_m
    measured = measured[measured > 0]
    median = float(np.median(measured)) if len(measured) else 1.0
    if not LIKELY_M[0] <= median <= LIKELY_M[1]:  # said here, not as a lack of echoes
        unit = "millimetres?" if median > LIKELY_M[1] else "divided twice?"
        raise FrameError(
            f"{name}: median depth {median:,.4g} m: {unit} set scenes.depth_scale to what the "
            "stored depth is divided by to give metres"
        )
    return replace(frame, depth_m=depth_m)
