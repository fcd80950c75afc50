"""What makes renders fast, against the plain way: compiled loops, traced every n-th pixel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.factory import pairs
from simnfnd.factory.config import FactoryConfig
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import Frame, Intrinsics
from simnfnd.factory.render import Rendered, RenderSettings, check_renderer
from simnfnd.factory.render.kernels import apply_traced
from simnfnd.factory.render.surface import pixels_of
from simnfnd.factory.settings import build
from tests.factory.render.renderers import ABOVE, HERE, LEFT, digest, relative_error, render
from tests.render_scenes import FLSEA, flsea_frame, frame_of, rays, yard

CAMERA = Intrinsics(21.0, 19.0, 10.3, 8.6)


@pytest.mark.parametrize("stride", [2, 3, 5])
def test_traced_pixels_are_pixels_of_the_frame(stride: int) -> None:
    frame = yard(62, 93)
    whole, some = (pixels_of(frame, RenderSettings(), n) for n in (1, stride))
    at = (some.traced, some.traced)
    surface, every = some.surface(), whole.surface()
    lit = surface.mask
    assert lit.shape == frame.depth_m[at].shape
    np.testing.assert_array_equal(surface.points_m[lit], every.points_m[at][lit])
    np.testing.assert_array_equal(surface.normals, every.normals[at])
    np.testing.assert_array_equal(surface.albedo, whole.albedo[at])
    np.testing.assert_array_equal(lit, whole.mask[at])
    # A camera of these pixels alone puts them where they are.
    alone = frame.depth_m[at][..., None] * rays(len(lit), lit.shape[1], surface.intrinsics)
    np.testing.assert_allclose(alone[lit], surface.points_m[lit], rtol=1e-5, atol=1e-6)


def spread_in_words(
    radiance: Any, depth_m: Any, known: Any, ratio: Any, first: int, stride: int, limit: Any
) -> Any:
    """`apply_traced` as its docstring says it, pixel by pixel."""
    made = np.zeros(radiance.shape)
    for row, column in np.argwhere(radiance > 0):
        i, j = (row - first) // stride, (column - first) // stride
        v, u = (row - first) / stride - i, (column - first) / stride - j
        here, lit, dark, total = float(depth_m[row, column]), 0.0, 0.0, 0.0
        for down, across in ((0, 0), (0, 1), (1, 0), (1, 1)):
            at = np.clip(i + down, 0, len(known) - 1), np.clip(j + across, 0, len(known[0]) - 1)
            there = float(depth_m[first + at[0] * stride, first + at[1] * stride])
            step = abs(there - here) / min(there, here) / limit if there > 0 else 1.0
            if known[at] and step < 1:
                weight = (v if down else 1 - v) * (u if across else 1 - u) + 1e-6
                weight *= 1 - step
                lit += weight * (ratio[at] > 0)
                dark += weight * (ratio[at] == 0)
                total += weight * ratio[at]
        if lit + dark == 0:
            made[row, column] = radiance[row, column]
        elif lit >= dark:
            made[row, column] = radiance[row, column] * total / lit
    return made


@pytest.mark.parametrize("stride", [1, 3])
def test_tracing_is_spread_as_its_words_say(stride: int) -> None:
    rng = np.random.default_rng(stride)
    depth_m = (2 + rng.integers(0, 3, (37, 42)) + 0.3 * rng.random((37, 42))).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.1] = 0
    radiance = (rng.random(depth_m.shape) * (depth_m > 0)).astype(np.float32)
    radiance[rng.random(depth_m.shape) < 0.1] = 0
    first = (stride - 1) // 2
    shape = depth_m[first::stride, first::stride].shape
    known, heard = rng.random(shape) < 0.8, rng.random(shape) < 0.6
    ratio = np.where(known & heard, rng.random(shape), 0).astype(np.float32)
    told = (radiance, depth_m, known, ratio, first, stride, np.float32(0.2))
    expected = spread_in_words(*told)
    assert (expected > 0).mean() > 0.2
    np.testing.assert_allclose(apply_traced(*told), expected, rtol=1e-4, atol=1e-7)


# ---- renders: traced every n-th pixel against every pixel ----

FINE = [
    "sonar.beams=512",
    "sonar.range_bins=512",
    "sonar.image.width_px=512",
    "sonar.image.height_px=512",
]


def _config() -> FactoryConfig:
    from simnfnd.factory.cli.compose import compose_config

    return compose_config(FINE)


def _psnr_db(found: npt.NDArray[np.generic], expected: npt.NDArray[np.generic]) -> float:
    difference = (found.astype(np.float64) - expected.astype(np.float64)) / 255
    return float(-10 * np.log10(max((difference**2).mean(), 1e-12)))


def _assert_same_pictures(frame: Frame, found: Rendered, expected: Rendered, least: float) -> None:
    """Clean and noisy pictures, 512x512, of the same draws."""
    config = _config()
    one, other = (
        pairs.make_pair(pairs.observe(frame, rendered, config), 0, config)
        for rendered in (found, expected)
    )
    assert one.clean.shape == (512, 512)
    assert _psnr_db(one.clean, other.clean) > least
    assert _psnr_db(one.noisy, other.noisy) > least
    np.testing.assert_array_equal(one.shadow, other.shadow)


@pytest.mark.skipif(not FLSEA.is_dir(), reason="no real data")
def test_pictures_of_a_real_frame_are_those_of_full_resolution() -> None:
    """40 dB is what is asked for; 87 to 92 dB is what six real frames give."""
    frame = flsea_frame()
    fast = render("cycles", frame, geometry="auto", stride="auto")
    full = render("cycles", frame, geometry="auto")
    _assert_same_pictures(frame, fast, full, 65)
    # And the other geometry, which misses some pixels that the other sees.
    mesh = render("cycles", frame)
    assert (fast.surface != mesh.surface).sum() < 10
    assert np.median(relative_error(fast, mesh)) < 1e-3


@pytest.mark.parametrize("stride", [2, 4])
def test_pictures_of_a_procedural_frame_are_those_of_full_resolution(stride: int) -> None:
    frame = yard(304, 484)
    fast = render("points", frame, stride=stride)
    _assert_same_pictures(frame, fast, render("points", frame), 70)


@pytest.mark.parametrize(("kind", "stride"), [("embree", 3), ("cycles", 2)])
def test_shadows_move_by_the_outline_alone(kind: str, stride: int) -> None:
    frame = yard(304, 484)
    full, fast = (render(kind, frame, LEFT, stride=n) for n in (1, stride))
    assert (fast.surface == full.surface).mean() > 0.9999
    # Cycles' mesh blends the one pixel fine noise of this frame's texture a little, either way.
    assert np.median(relative_error(fast, full)) < (1e-4 if kind == "embree" else 3e-3)
    shadow = full.surface & ~full.insonified
    differs = fast.insonified != full.insonified
    assert differs.sum() < 0.004 * stride * full.surface.sum()
    # Where they differ, an outline of full resolution is within reach.
    reach = 2 * stride + 1
    near = np.zeros_like(shadow)
    for down in range(-reach, reach + 1):
        for across in range(-reach, reach + 1):
            near |= np.roll(shadow, (down, across), (0, 1)) != shadow
    assert (differs & ~near).sum() < 0.001 * full.surface.sum()


def test_auto_traces_what_the_scene_needs() -> None:
    auto: RenderSettings = build(RenderSettings, {})
    assert (auto.stride_at(HERE), auto.as_points(HERE)) == (2, True)
    assert (auto.stride_at(LEFT), auto.as_points(LEFT)) == (1, False)
    bounced = replace(auto, bounces=1)
    assert (bounced.stride_at(HERE), bounced.as_points(HERE)) == (1, False)
    fixed = replace(auto, stride=3, geometry="points")
    assert (fixed.stride_at(LEFT), fixed.as_points(LEFT)) == (3, True)


def test_auto_renders_the_same_bytes_after_any_other_frame() -> None:
    """One renderer goes from spheres to meshes and back, and leaves nothing behind."""
    keys = {"geometry": "auto", "stride": "auto"}
    frame = yard(100, 130)
    first = [digest(render("cycles", frame, mount, **keys)) for mount in (HERE, LEFT)]
    render("cycles", yard(62, 93, seed=3), ABOVE, **keys)
    again = [digest(render("cycles", frame, mount, **keys)) for mount in (LEFT, HERE)]
    assert again[::-1] == first
    assert first[1] == digest(render("cycles", frame, LEFT))


@pytest.mark.parametrize("stride", [0, -1, 9, 1.5, "fine", True])
def test_stride_that_is_none(stride: object) -> None:
    with pytest.raises(FactoryError, match=r"stride: give auto, or .* from 1 to 8 \(given:"):
        build(RenderSettings, {"stride": stride})


def test_stride_and_bounces_exclude_each_other() -> None:
    wanted: RenderSettings = build(RenderSettings, {"kind": "cycles", "stride": 2, "bounces": 1})
    with pytest.raises(FactoryError, match=r"render\.stride=2 .* render\.bounces=0"):
        check_renderer(wanted)
    check_renderer(build(RenderSettings, {"kind": "analytic", "bounces": 1}))


def test_nothing_measured_at_any_stride() -> None:
    empty = frame_of(np.zeros((20, 30)), CAMERA)
    for kind, mount in (("embree", LEFT), ("cycles", LEFT), ("points", HERE)):
        found = render(kind, empty, mount, stride=3)
        assert found.radiance.shape == (20, 30)
        assert not found.surface.any()
