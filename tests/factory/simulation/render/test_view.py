"""Points, triangles and normals of depth images, and the format of a view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.common.array_types import Bools, Floats
from simnfnd.factory.common.settings import build
from simnfnd.factory.simulation.frames.frame import Intrinsics
from simnfnd.factory.simulation.render import RenderSettings, kernels
from simnfnd.factory.simulation.render.base import Mount, Rendered
from simnfnd.factory.simulation.render.surface import Surface, pixels_of
from simnfnd.factory.simulation.render.view import DEPTH, RADIANCE, decode, encode, fold, view_of
from tests.factory.simulation.render.small_views import same, some_view
from tests.frames import ground_and_post, plain_render
from tests.render_scenes import frame_of, rays, sphere_depth, yard

CAMERA = Intrinsics(70.0, 66.0, 22.3, 31.7)


def surface_of(depth_m: Floats, edge_ratio: float = 0.1, camera: Intrinsics = CAMERA) -> Surface:
    settings: RenderSettings = build(RenderSettings, {"edge_ratio": edge_ratio})
    return pixels_of(frame_of(depth_m, camera), settings).surface()


def joined(depth_m: Floats, bit: int, edge_ratio: float = 0.1) -> Bools:
    joints = kernels.joints(np.ascontiguousarray(depth_m, np.float32), edge_ratio)
    return np.asarray(np.asarray(joints) & bit != 0)


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
    flying = np.full((9, 9), 4.0)
    flying[4, 4] = 4.2
    assert not surface_of(flying).mask[4, 4]
    assert surface_of(flying).mask.sum() == 80


def test_what_is_stored_is_what_images_are_made_of() -> None:
    view = some_view()
    assert same(decode(encode(view)), view)
    frame = ground_and_post()
    rendered = plain_render(frame)
    surface = rendered.surface
    depth_error = np.abs(view.unnamed_frame.depth_m[surface] / frame.depth_m[surface] - 1)
    assert 0 < depth_error.max() < 1.01 * DEPTH.step / 2
    lit = surface & (rendered.radiance > 0)
    radiance_error = np.abs(view.radiance[lit] / rendered.radiance[lit] - 1)
    assert 0 < radiance_error.max() < 1.01 * RADIANCE.step / 2
    assert not view.unnamed_frame.depth_m[~surface].any()
    assert not view.radiance[surface & ~lit].any()


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**31),
    height=st.integers(1, 9),
    width=st.integers(1, 9),
    empty=st.booleans(),
)
def test_any_view_comes_back(seed: int, height: int, width: int, empty: bool) -> None:
    rng = np.random.default_rng(seed)
    frame = replace(
        ground_and_post(),
        depth_m=np.exp(rng.uniform(-8, 7, (height, width))).astype(np.float32),
        rgb=np.zeros((height, width, 3), np.uint8),
        segmentation=rng.integers(0, 20, (height, width), dtype=np.uint8),
        instance=rng.integers(0, 65535, (height, width), dtype=np.uint16),
        world_from_camera=None if seed % 2 else rng.normal(size=(4, 4)),
    )
    surface = (rng.random((height, width)) < 0.7) & (not empty)
    radiance = np.exp(rng.uniform(-25, 10, (height, width))).astype(np.float32)
    radiance = np.where(surface & (rng.random((height, width)) < 0.8), radiance, np.float32(0))
    mount = Mount((0.1, -0.2, 0.3), 4.0, 5.0)
    view = view_of(frame, Rendered(radiance, surface), mount)
    again = decode(encode(view))
    assert same(again, view)
    assert view.unnamed_frame.world_from_camera is frame.world_from_camera
    for name in ("segmentation", "instance"):
        np.testing.assert_array_equal(getattr(again.unnamed_frame, name), getattr(frame, name))


@given(cut=st.integers(0, 4000), content=st.binary(max_size=60))
@settings(max_examples=40)
def test_anything_else_is_no_view(cut: int, content: bytes) -> None:
    for bad in (content, encode(some_view())[:cut]):
        with pytest.raises(ValueError):  # noqa: PT011 (the cause is what was met first)
            decode(bad)


def test_folded_planes_keep_their_bytes() -> None:
    """Caches and packs hold them: 5 is +5, folded to 10; 3 after 5 is -2, folded to 3."""
    assert fold(np.array([[5, 3], [5, 300]], np.uint16)) == bytes([10, 3, 0, 82, 0, 0, 0, 2])


@settings(max_examples=60, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_never_changes_an_image(place: float, bit: int) -> None:
    view = some_view()
    content = bytearray(encode(view))
    whole = decode(bytes(content))
    content[int(place * len(content))] ^= 1 << bit
    try:
        actual = decode(bytes(content))
    except ValueError:
        return
    assert same(actual, whole)  # a bit that the codec does not look at
