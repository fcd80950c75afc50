"""Points, triangles and normals of depth images against independent computations."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.factory.frame import Intrinsics
from simnfnd.factory.render import RenderSettings, kernels
from simnfnd.factory.render.surface import Surface, pixels_of
from simnfnd.factory.settings import build
from tests.render_scenes import frame_of, rays, sphere_depth, yard

Array = npt.NDArray[np.floating]

CAMERA = Intrinsics(70.0, 66.0, 22.3, 31.7)


def surface_of(depth_m: Array, edge_ratio: float = 0.1, camera: Intrinsics = CAMERA) -> Surface:
    settings: RenderSettings = build(RenderSettings, {"edge_ratio": edge_ratio})
    return pixels_of(frame_of(depth_m, camera), settings).surface()


def joints_of(depth_m: Array, edge_ratio: float = 0.1) -> npt.NDArray[np.uint8]:
    return np.asarray(kernels.joints(np.ascontiguousarray(depth_m, np.float32), edge_ratio))


def joined(depth_m: Array, bit: int, edge_ratio: float = 0.1) -> npt.NDArray[np.bool_]:
    return np.asarray(joints_of(depth_m, edge_ratio) & bit != 0)


def test_points_are_those_of_open3d_and_of_equation_2() -> None:
    open3d = pytest.importorskip("open3d")
    frame = yard(152, 242)
    camera = frame.intrinsics
    image = open3d.geometry.Image(frame.depth_m)
    pinhole = open3d.camera.PinholeCameraIntrinsic(
        242, 152, camera.fx, camera.fy, camera.cx, camera.cy
    )
    cloud = open3d.geometry.PointCloud.create_from_depth_image(
        image, pinhole, depth_scale=1.0, depth_trunc=1000.0
    )
    ours = pixels_of(frame, RenderSettings()).surface().points_m
    np.testing.assert_allclose(ours[frame.valid], np.asarray(cloud.points), rtol=1e-6, atol=1e-7)
    matrix = np.array([[70.0, 0, 22.3], [0, 66.0, 31.7], [0, 0, 1]])
    expected = 3.0 * np.linalg.solve(matrix, [11.0, 29.0, 1.0])
    points_m = surface_of(np.full((40, 60), 3.0)).points_m
    np.testing.assert_allclose(points_m[29, 11], expected, rtol=1e-6)


def test_normals_of_a_sphere() -> None:
    camera = Intrinsics(600.0, 600.0, 150.0, 150.0)
    centre = np.array([0.1, -0.05, 3.0])
    depth_m = sphere_depth(rays(300, 300, camera), tuple(centre), 0.6).astype(np.float32)
    depth_m[~np.isfinite(depth_m)] = 0
    surface = surface_of(depth_m, camera=camera)
    points_m = surface.points_m
    true = (points_m - centre) / 0.6
    facing = (depth_m > 0) & ((true * points_m).sum(axis=-1) < -0.3 * depth_m)
    off_deg = np.rad2deg(np.arccos(np.clip((true * surface.normals).sum(axis=-1), -1, 1)))
    assert facing.sum() > 10_000
    assert off_deg[facing].max() < 0.2


def test_ground_at_grazing_incidence_stays_whole_and_a_low_step_is_cut() -> None:
    steady = 5.0 * 1.04 ** np.arange(30)[:, None] * np.ones((1, 20))
    assert joined(steady, kernels.DOWN)[:-1].all()
    assert surface_of(steady).mask.all()
    step = np.where(np.arange(30) < 15, 5.0, 5.2)[:, None] * np.ones((1, 20))
    assert not joined(step, kernels.DOWN)[:-1][14].any()
    assert joined(step, kernels.DOWN)[:-1].sum() == 28 * 20
    sloping = step * 1.004 ** np.arange(30)[:, None]
    assert joined(sloping, kernels.DOWN)[:-1].sum() == 28 * 20
    small = np.where(np.arange(30) < 15, 5.0, 5.05)[:, None] * np.ones((1, 20))
    assert joined(small, kernels.DOWN)[:-1].all()


def test_a_flying_pixel_is_no_surface() -> None:
    depth_m = np.full((9, 9), 4.0)
    depth_m[4, 4] = 4.2
    assert not surface_of(depth_m).mask[4, 4]
    assert surface_of(depth_m).mask.sum() == 80
    depth_m[4, 4] = 0
    assert surface_of(depth_m).mask.sum() == 80
