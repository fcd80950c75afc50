"""Small scenes with known geometry, for tests of the cloud and of the renderers."""

from __future__ import annotations

import numpy as np
from PIL import Image

from simnfnd.factory.common.array_types import Float64s, Floats, UInt8s
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics
from tests.project_files import ROOT

FLSEA = ROOT / "../shared/data/flsea-vi"


def frame_of(
    depth_m: Floats,
    intrinsics: Intrinsics,
    rgb: UInt8s | None = None,
) -> Frame:
    height, width = depth_m.shape
    if rgb is None:
        rgb = np.full((height, width, 3), 128, np.uint8)
    return Frame(FrameRef("", "test", "0"), rgb, depth_m.astype(np.float32), intrinsics)


def rays(height: int, width: int, camera: Intrinsics) -> Float64s:
    """(H, W, 3) directions with z = 1, so that depth times direction is the point."""
    v, u = np.mgrid[:height, :width]
    return np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1
    )


def plane_depth(
    height: int, width: int, camera: Intrinsics, normal: tuple[float, ...], distance_m: float
) -> Float64s:
    """Depth of the plane normal . P = distance; 0 where the ray does not meet it."""
    along = rays(height, width, camera) @ np.asarray(normal)
    with np.errstate(divide="ignore"):
        depth_m = distance_m / along
    return np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, 0)


def box_depth(direction: Float64s, low: tuple[float, ...], high: tuple[float, ...]) -> Float64s:
    with np.errstate(divide="ignore", invalid="ignore"):
        low_distance = np.asarray(low) / direction
        high_distance = np.asarray(high) / direction
    enter = np.nanmax(np.minimum(low_distance, high_distance), axis=-1)
    leave = np.nanmin(np.maximum(low_distance, high_distance), axis=-1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)


def sphere_depth(direction: Float64s, centre: tuple[float, ...], radius_m: float) -> Float64s:
    square = (direction**2).sum(axis=-1)
    half = direction @ np.asarray(centre)
    under = half**2 - square * (np.asarray(centre) @ np.asarray(centre) - radius_m**2)
    return np.where(under > 0, (half - np.sqrt(np.maximum(under, 0))) / square, np.inf)


def yard(height: int, width: int, seed: int = 0) -> Frame:
    """A tilted ground with two boxes, two pillars and a sphere, a hole, and open water above."""
    camera = Intrinsics(1.21 * width, 1.2 * width, 0.48 * width, 0.45 * height)
    direction = rays(height, width, camera)
    with np.errstate(divide="ignore"):
        ground = 1.5 / (direction @ np.array([0.05, 0.94, 0.34]))
    depth_m = np.where(ground > 0, ground, np.inf)
    for low, high in (
        ((-1.2, 0.2, 3.0), (-0.6, 1.0, 3.6)),
        ((0.9, 0.0, 4.2), (1.3, 1.0, 4.8)),
        ((0.35, -0.9, 3.3), (0.45, 1.0, 3.4)),
        ((-0.25, -0.7, 4.5), (-0.1, 1.0, 4.65)),
    ):
        depth_m = np.minimum(depth_m, box_depth(direction, low, high))
    depth_m = np.minimum(depth_m, sphere_depth(direction, (0.0, 0.5, 2.6), 0.3))
    depth_m[depth_m > 12] = 0
    depth_m[int(0.7 * height) : int(0.75 * height), int(0.7 * width) : int(0.8 * width)] = 0
    rgb = np.random.default_rng(seed).integers(40, 216, (height, width, 3), dtype=np.uint8)
    return frame_of(depth_m, camera, rgb)


def flsea_frame() -> Frame:
    """A quarter of the first real frame there is (its terms keep it out of this project)."""
    depth_file = sorted(FLSEA.glob("*/*/depth/*.tif"))[0]
    name = depth_file.name.removesuffix("_SeaErra_abs_depth.tif")
    rgb = np.asarray(Image.open(depth_file.parents[1] / "imgs" / f"{name}.tiff"))
    depth_m = np.asarray(Image.open(depth_file))
    part = (slice(204, 508), slice(242, 726))
    return frame_of(depth_m[part], Intrinsics(1175.39, 1174.28, 224.26, 67.21), rgb[part].copy())
