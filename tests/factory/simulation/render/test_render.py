"""Renderers against hand-computed values, each other, and the plain way; settings; repeats."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.common.array_types import Float64s, UInt8s
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.quality import psnr_db
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics
from simnfnd.factory.simulation.pairs import pair_maker as pairs
from simnfnd.factory.simulation.render import Rendered, Renderer, RenderSettings, open_renderer
from simnfnd.factory.simulation.render.base import Mount
from simnfnd.factory.simulation.render.surface import albedo, linear_luminance
from tests.project_files import ROOT
from tests.render_scenes import FLSEA, flsea_frame, frame_of, plane_depth, rays, yard

ABOVE = Mount((0.0, 0.0, 1.0))
LEFT = Mount((0.0, 0.8, 0.5))
HERE = Mount()
BESIDE = Mount((0.0, 1e-6, 0.0))
KINDS = ["analytic", "embree", "cycles", "mesh"]

_open: dict[RenderSettings, Renderer] = {}


def opened(kind: str, **keys: Any) -> Renderer:
    """One renderer for each setting: Blender starts once in a test session."""
    if kind in ("cycles", "embree"):
        pytest.importorskip({"cycles": "bpy", "embree": "open3d"}[kind])
    wanted: RenderSettings = build(RenderSettings, {"kind": kind, **keys})
    if wanted not in _open:
        _open[wanted] = open_renderer(wanted)
    return _open[wanted]


def render(kind: str, frame: Frame, mount: Mount = HERE, **keys: Any) -> Rendered:
    """`mesh`: by Cycles, beside the camera, where it traces a mesh instead of spheres."""
    if kind == "mesh":
        kind = "cycles"
        mount = BESIDE if mount == HERE else mount
    return opened(kind, **keys).render(frame, mount)


def relative_error(found: Rendered, expected: Rendered) -> Float64s:
    lit = (found.radiance > 0) & (expected.radiance > 0)
    return np.asarray(np.abs(found.radiance[lit].astype(np.float64) / expected.radiance[lit] - 1))


def digest(rendered: Rendered) -> str:
    return hashlib.sha256(rendered.radiance.tobytes() + rendered.surface.tobytes()).hexdigest()


CONSTANT = 0.5


# ---- the laws, computed by hand ----

CENTRED = Intrinsics(80.0, 80.0, 40.0, 30.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("tilt_deg", "distance_m"), [(0, 1.0), (0, 2.0), (0, 4.0), (30, 3.0), (60, 3.0), (75, 3.0)]
)
def test_inverse_square_law_and_lamberts_law(kind: str, tilt_deg: float, distance_m: float) -> None:
    """A plane through (0, 0, distance), turned by the angle about the vertical axis."""
    tilt = np.deg2rad(tilt_deg)
    normal = (np.sin(tilt), 0.0, np.cos(tilt))
    depth_m = plane_depth(61, 81, CENTRED, normal, distance_m * np.cos(tilt))
    depth_m[depth_m > 20] = 0
    actual = render(kind, frame_of(depth_m, CENTRED), albedo="constant", edge_ratio=0.3)
    golden = CONSTANT * np.cos(tilt) / distance_m**2
    assert actual.radiance[30, 40] == pytest.approx(golden, rel=1e-3 if tilt else 1e-4)
    if not tilt:  # at 45 degrees across (u - cx = fx): range sqrt(2) z, incidence 45 degrees
        wide = frame_of(depth_m, Intrinsics(40.0, 40.0, 40.0, 30.0))
        aside = render(kind, wide, albedo="constant").radiance[30, 80]
        assert aside == pytest.approx(golden * np.cos(np.pi / 4) / 2, rel=1e-4)


@pytest.mark.parametrize("kind", ["embree", "cycles"])
def test_shadow_of_a_plate_is_where_similar_triangles_put_it(kind: str) -> None:
    """A plate at 2 m before a wall at 4 m, sonar 0.5 m to the left of the camera.

    Seen from (-0.5, 0, 0), the plate |x|, |y| < 0.2 at z = 2 covers x in (0.1, 0.9), y in
    (-0.4, 0.4) of the wall at z = 4; the camera sees that part which the plate does not hide.
    """
    camera = Intrinsics(300.0, 300.0, 150.0, 100.0)
    direction = rays(201, 301, camera)
    plate = (np.abs(direction[..., 0]) < 0.1) & (np.abs(direction[..., 1]) < 0.1)
    frame = frame_of(np.where(plate, 2.0, 4.0), camera)
    x, y = 4 * direction[..., 0], 4 * direction[..., 1]
    expected = ~plate & (x > 0.1) & (x < 0.9) & (np.abs(y) < 0.4)
    actual = render(kind, frame, Mount((0.0, 0.5, 0.0)), albedo="constant")
    shadow = actual.surface & ~(actual.radiance > 0)
    assert actual.surface.all()
    assert expected.sum() > 1000
    # Half a pixel of the plate is a pixel of its shadow's outline (130 pixels long).
    assert (shadow != expected).sum() < 200
    inner = expected & (x < 0.86) & (np.abs(y) < 0.37)
    outer = ~plate & ((x > 0.94) | (np.abs(y) > 0.43) | (x < 0))
    assert shadow[inner].all()
    assert not shadow[outer].any()


# ---- the renderers against each other ----


@pytest.mark.parametrize("kind", ["cycles", "mesh"])
@pytest.mark.parametrize(
    # White noise, one pixel fine, is the hardest texture to be exact on.
    ("texture", "median"),
    [("constant", 1e-4), ("rgb", 0.005), ("flattened", 0.005)],
)
def test_cycles_is_the_analytic_solution_when_colocated(
    kind: str, texture: str, median: float
) -> None:
    frame = yard(152, 242)
    actual, expected = (render(name, frame, albedo=texture) for name in (kind, "analytic"))
    assert (actual.surface == expected.surface).mean() > 0.9999
    assert ((actual.radiance > 0) == (expected.radiance > 0)).mean() > 0.9999
    error = relative_error(actual, expected)
    assert np.median(error) < median
    assert np.percentile(error, 99) < max(0.01, 10 * median)


@pytest.mark.parametrize("mount", [ABOVE, LEFT], ids=["above", "left"])
def test_cycles_and_embree_agree_on_shadows(mount: Mount) -> None:
    frame = yard(152, 242)
    _assert_same_shadows(render("cycles", frame, mount), render("embree", frame, mount))


def _assert_same_shadows(found: Rendered, expected: Rendered) -> None:
    surface = expected.surface
    assert (found.surface == surface).mean() > 0.9999
    assert ((found.radiance > 0) == (expected.radiance > 0))[surface].mean() > 0.999
    assert np.median(relative_error(found, expected)) < 1e-3


@pytest.mark.parametrize("kind", ["cycles", "mesh"])
@pytest.mark.parametrize(
    "camera",
    [
        Intrinsics(90.0, 90.0, 10.5, 60.0),
        Intrinsics(90.0, 71.0, 77.0, 3.25),
        Intrinsics(64.0, 97.0, -20.0, 33.0),
    ],
)
def test_every_pixel_is_where_the_intrinsics_say(kind: str, camera: Intrinsics) -> None:
    """A chequered wall: an image shifted by a fraction of a pixel would miss its squares."""
    v, u = np.mgrid[:67, :93]
    rgb = np.where(((u + v) % 2)[..., None] == 0, 240, 60).astype(np.uint8) * np.ones(3, np.uint8)
    frame = frame_of(plane_depth(67, 93, camera, (0.1, -0.2, 1.0), 3.0), camera, rgb)
    actual, expected = (render(name, frame, albedo="rgb") for name in (kind, "analytic"))
    assert actual.surface.all()
    # The darkest and the brightest square differ by 20 : 1, so this is 1/400 of a pixel.
    np.testing.assert_allclose(actual.radiance, expected.radiance, rtol=0.05)


# ---- invalid pixels, edges, the mesh ----


@pytest.mark.parametrize("kind", KINDS)
def test_unmeasured_pixels_are_neither_surface_nor_bright(kind: str) -> None:
    frame = yard(152, 242)
    hole = np.random.default_rng(1).random(frame.depth_m.shape) < 0.2
    frame = replace(frame, depth_m=np.where(hole, np.float32(0), frame.depth_m))
    for mount in (HERE,) if kind == "analytic" else (HERE, LEFT):
        actual = render(kind, frame, mount)
        assert actual.radiance.dtype == np.float32
        assert actual.surface.dtype == np.bool_
        assert not actual.surface[~frame.valid].any()
        assert not actual.radiance[~actual.surface].any()
        assert actual.surface.sum() > 0.98 * frame.valid.sum()


# ---- spheres for every second pixel against the mesh of every pixel ----


@pytest.mark.skipif(not FLSEA.is_dir(), reason="no real data")
def test_images_of_a_real_frame_are_those_of_full_resolution() -> None:
    """40 dB is what is asked for; 87 to 92 dB is what six real frames give, at 512x512."""
    frame = flsea_frame()
    fast = render("cycles", frame)
    full = render("analytic", frame)
    sizes = ("beams", "range_bins", "image.width_px", "image.height_px")
    config = compose_config([f"sonar.{size}=512" for size in sizes])
    first_pair, second_pair = (
        pairs.make_pair(pairs.observe(frame, rendered, config), 0, config)
        for rendered in (fast, full)
    )
    assert psnr_db(first_pair.clean, second_pair.clean) > 65
    assert psnr_db(first_pair.noisy, second_pair.noisy) > 65
    np.testing.assert_array_equal(first_pair.shadow, second_pair.shadow)
    # And the mesh, which misses some pixels that the spheres show.
    mesh = render("mesh", frame)
    assert (fast.surface != mesh.surface).sum() < 10
    assert np.median(relative_error(fast, mesh)) < 1e-3


# ---- repeatability ----


@pytest.mark.parametrize("kind", KINDS)
def test_same_bytes_whatever_was_rendered_before(kind: str) -> None:
    frame = yard(152, 242)
    smaller = yard(100, 130, seed=3)
    mounts = (HERE,) if kind == "analytic" else (HERE, LEFT)
    first = [digest(render(kind, frame, mount)) for mount in mounts]
    render(kind, smaller, HERE if kind == "analytic" else ABOVE)
    assert [digest(render(kind, frame, mount)) for mount in mounts] == first


@pytest.mark.slow
def test_a_fresh_process_gives_the_same_bytes_and_prints_nothing_else() -> None:
    pytest.importorskip("bpy")
    script = (
        "from tests.factory.simulation.render.test_render import LEFT, digest, render, yard\n"
        "print(digest(render('cycles', yard(152, 242), LEFT)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, check=True
    )
    assert done.stdout == digest(render("cycles", yard(152, 242), LEFT)) + "\n"


# ---- albedo ----


def test_albedo_rgb_is_linear_luminance() -> None:
    rgb = np.array([[[255, 255, 255], [128, 128, 128], [255, 0, 0], [0, 0, 0]]], np.uint8)
    np.testing.assert_allclose(
        linear_luminance(rgb)[0], [1, 0.2158605, 0.2126, 0], rtol=1e-5, atol=1e-7
    )
    actual = albedo(rgb, np.array([[True, True, False, True]]), "rgb")
    np.testing.assert_allclose(actual[0], [1, 0.2158605, 0, 0.01], rtol=1e-5)


def test_flattened_albedo_forgets_light_and_keeps_texture() -> None:
    rng = np.random.default_rng(0)
    texture = rng.uniform(0.5, 1.5, (200, 300))
    haze = np.linspace(0.02, 0.5, 300)[None, :] * np.linspace(1, 0.4, 200)[:, None]

    def image(linear: Float64s) -> UInt8s:
        code = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        grey: UInt8s = np.round(255 * code).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)

    valid = np.ones((200, 300), np.bool_)
    valid[:, 200:] = False
    flat = albedo(image(texture * haze), valid, "flattened")
    assert not flat[:, 200:].any()
    flat = flat[:, :200]
    texture = texture[:, :200]
    assert flat.mean() == pytest.approx(0.5, abs=0.02)
    assert flat.min() >= 0.1
    assert flat.max() <= 1
    assert np.corrcoef(flat.ravel(), texture.ravel())[0, 1] > 0.97
    thirds = [part.mean() for part in np.array_split(flat, 3, axis=1)]
    assert max(thirds) - min(thirds) < 0.03
