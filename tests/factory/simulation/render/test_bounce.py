"""Ghosts of one bounce against closed forms: a corner, a bowl, and the level of a mirror image."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import optimize

from simnfnd.factory.common.array_types import Float64s
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.schema import config_hash
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.config.renderer_choice import renderer_of
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.frames.frame import Frame, Intrinsics
from simnfnd.factory.simulation.imaging.coherent import CoherentScene, received
from simnfnd.factory.simulation.imaging.effect import DrawnEffect, Effect
from simnfnd.factory.simulation.noise.path_speckle import PATH_SPECKLE
from simnfnd.factory.simulation.noise.speckle import SPECKLE
from simnfnd.factory.simulation.pairs.pair_maker import make_pair, observe
from simnfnd.factory.simulation.render import Rendered, RenderSettings, open_renderer
from simnfnd.factory.simulation.render.base import Bounces, Mount
from simnfnd.factory.simulation.render.view import decode, encode, view_of
from simnfnd.factory.simulation.sonar.ghosts import GhostPaths, ghost_paths
from simnfnd.factory.simulation.sonar.surface import LitSurface
from simnfnd.factory.simulation.sonar.window import Window
from tests.render_scenes import frame_of, rays

APEX_M = 3.0
LOSS_DB = 6.0
LENS = Intrinsics(300.0, 300.0, 120.0, 60.0)
SHAPE = (121, 241)
BOWL_M = 3.0
BOWL_RADIUS_M = 1.0


def corner() -> Frame:
    """Two upright plates at right angles, their line 3 m ahead, each at 45 degrees to the view."""
    ray = rays(*SHAPE, LENS)
    return frame_of(APEX_M / (1 + np.abs(ray[..., 0])), LENS)


def bowl() -> Frame:
    """A hemisphere of radius 1 m that opens towards the camera, its centre 3 m ahead."""
    lens = Intrinsics(330.0, 330.0, 120.0, 120.0)
    ray = rays(241, 241, lens)
    square = (ray**2).sum(axis=-1)
    root = BOWL_M**2 - square * (BOWL_M**2 - BOWL_RADIUS_M**2)
    depth_m = (BOWL_M + np.sqrt(np.maximum(root, 0))) / square
    return frame_of(np.where((root > 0) & (depth_m > BOWL_M), depth_m, 0), lens)


def rendered(frame: Frame, mount: Mount | None = None) -> Rendered:
    pytest.importorskip("open3d")
    settings = RenderSettings("embree", "constant", bounces=1, reflection_loss_db=LOSS_DB)
    return open_renderer(settings).render(frame, mount or Mount())


@cache
def corner_render() -> Rendered:
    return rendered(corner())


def config(*words: str) -> FactoryConfig:
    fan = ("sonar.range.auto=false", "sonar.range.min_m=1", "sonar.range.max_m=5")
    return compose_config(["render=embree", "render.bounces=1", "noise=none", *fan, *words])


def coherent() -> FactoryConfig:
    return config("acoustics=coherent", "water=fresh", "sonar=oculus_m750d_lf")


def paths_of(frame: Frame, image: Rendered, sonar: Any) -> GhostPaths:
    paths = ghost_paths(LitSurface(frame, image, Window("slant_range", 1, 5, -1, 1), sonar))
    assert paths is not None
    return paths


def length(points_m: Float64s) -> Float64s:
    return np.asarray(np.linalg.norm(points_m, axis=-1))


def half_paths_m(paths: GhostPaths) -> Float64s:
    return (length(paths.image_m) + length(paths.second_m)) / 2


def test_a_corner_echoes_at_the_range_of_its_line() -> None:
    """Of a ray at the bearing a, c = cos a and s = |sin a|, in the plane of the sonar:

    it meets the plate at D / (c + s), the other one after t = 2 D s / cos 2a, and comes back over
    the root of r^2 + t^2 - 4 r t s c.  So the echo of a ray to the line itself arrives at D, and
    that of a ray beside it later by a part of the order a^2.
    """
    paths = paths_of(corner(), corner_render(), config().sonar)
    forward_m, left_m, up_m = paths.image_m.T
    ground_m = np.hypot(forward_m, left_m)
    c, s = forward_m / ground_m, np.abs(left_m) / ground_m
    mirror_m = APEX_M / (c + s)
    apart_m = 2 * APEX_M * s / (c * c - s * s)
    back_m = np.hypot(np.sqrt(mirror_m**2 + apart_m**2 - 4 * mirror_m * apart_m * s * c), up_m)
    golden_m = (np.hypot(APEX_M / (c - s), up_m) + back_m) / 2
    assert len(golden_m) > 2000
    assert half_paths_m(paths) == pytest.approx(golden_m, abs=0.01)
    assert (np.sign(paths.image_m[:, 1]) == -np.sign(paths.second_m[:, 1])).mean() > 0.98
    near = (s < np.sin(np.deg2rad(5))) & (np.abs(up_m) < 0.1)
    assert near.sum() > 100
    assert half_paths_m(paths)[near] == pytest.approx(APEX_M, rel=0.01)


def test_paths_in_a_bowl_are_those_of_least_change() -> None:
    """Fermat: of all points of the bowl, the mirror is where the path's length is stationary."""
    frame = bowl()
    paths = paths_of(frame, rendered(frame), config().sonar)
    centre_m = np.array([BOWL_M, 0.0, 0.0])

    def on_bowl(angles: Float64s) -> Float64s:
        tilt, turn = angles
        outwards = [np.cos(tilt), np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)]
        return np.asarray(centre_m + BOWL_RADIUS_M * np.array(outwards))

    def stationary_path_m(start_m: Float64s, second_m: Float64s) -> float:
        outwards = (start_m - centre_m) / length(start_m - centre_m)
        angles = np.array([np.arccos(outwards[0]), np.arctan2(outwards[2], outwards[1])])

        def path_m(angles: Float64s) -> float:
            mirror_m = on_bowl(angles)
            return float(length(mirror_m) + length(second_m - mirror_m) + length(second_m))

        solved = optimize.root(lambda at: optimize.approx_fprime(at, path_m, 1e-6), angles)
        return path_m(solved.x)

    chosen = np.linspace(0, len(paths.radiance) - 1, 25).astype(int)
    image_range_m = length(paths.image_m)
    for index in chosen:
        toward = paths.image_m[index] / image_range_m[index]
        along_m = toward @ centre_m
        reach_m = along_m + np.sqrt(along_m**2 - BOWL_M**2 + BOWL_RADIUS_M**2)
        golden_m = stationary_path_m(reach_m * toward, paths.second_m[index])
        assert 2 * half_paths_m(paths)[index] == pytest.approx(golden_m, abs=0.03)


def test_a_ghost_is_as_loud_as_the_mirror_image() -> None:
    """Direct echo times R and the solid angle of the image over that of the patch itself."""
    frame = corner()
    point_m = rays(*SHAPE, LENS) * frame.depth_m[..., None]
    is_patch = (np.abs(point_m[..., 0] - 0.5) < 0.05) & (np.abs(point_m[..., 1]) < 0.15)
    image = replace(corner_render(), radiance=corner_render().radiance * is_patch)
    found = observe(frame, image, coherent()).scene
    assert isinstance(found, CoherentScene)
    ghosts = found.scatterers.ghosts
    assert ghosts is not None

    patch_m = np.array([0.5, 0, APEX_M - 0.5])
    normal = np.array([-1, 0, -1]) / np.sqrt(2)
    image_of_sonar_m = np.array([-APEX_M, 0, APEX_M])
    solid_angles = [
        abs((patch_m - from_m) @ normal) / length(patch_m - from_m) ** 3
        for from_m in (image_of_sonar_m, np.zeros(3))
    ]
    golden_db = -LOSS_DB + 10 * np.log10(solid_angles[0] / solid_angles[1])
    for direction in (0, 1):
        power = ghosts.powers[ghosts.direction == direction].sum()
        level_db = 10 * np.log10(power / found.scatterers.surface_power.sum())
        assert level_db == pytest.approx(golden_db, abs=0.4)


@pytest.mark.parametrize("acoustics", ["pointwise", "coherent"])
def test_images_show_ghosts_and_are_as_before_without(acoustics: str) -> None:
    """Behind the plates of a corner lies nothing: what is beyond its line is a ghost."""
    settings = config() if acoustics == "pointwise" else coherent()
    plain = replace(corner_render(), bounces=None)
    with_ghosts, without = (
        make_pair(observe(corner(), image, settings), 0, settings)
        for image in (corner_render(), plain)
    )
    brighter = with_ghosts.clean.astype(int) - without.clean
    assert (brighter > 0).sum() > 50
    np.testing.assert_array_equal(with_ghosts.shadow, without.shadow)


@pytest.mark.parametrize("effect", [SPECKLE, PATH_SPECKLE])
def test_speckle_of_ghosts_has_their_power(effect: Effect) -> None:
    found = observe(corner(), corner_render(), coherent()).scene
    assert isinstance(found, CoherentScene)
    beyond = found.range_m > 1.03 * APEX_M
    assert found.scatterers.power[beyond].sum() > 0
    values = {"looks": 12}
    level = received(found, [DrawnEffect("speckle", effect, values, 0, (1,))])
    golden = (found.expected * found.gain[:, None])[beyond].sum()
    assert (level[beyond] ** 2).sum() == pytest.approx(golden, rel=0.15)


def test_views_keep_bounces_and_refuse_damaged_ones() -> None:
    view = view_of(corner(), corner_render(), Mount())
    again = decode(encode(view)).bounces
    assert again is not None
    assert view.bounces is not None
    for name in ("mirror", "second", "distance_m"):
        np.testing.assert_array_equal(getattr(again, name), getattr(view.bounces, name))
    outside = replace(view.bounces, second=view.bounces.second + SHAPE[0] * SHAPE[1])
    with pytest.raises(ValueError, match="bounce"):
        decode(encode(replace(view, bounces=outside)))


def test_moving_objects_cover_paths() -> None:
    ends = np.array([0, 1, 2], np.int32)
    bounces = Bounces(ends, ends[::-1] + 3, np.ones(3, np.float32), LOSS_DB, 4)
    covered = np.zeros(6, np.bool_)
    covered[[0, 3]] = True
    assert bounces.clear_of(covered).mirror.tolist() == [1]


@pytest.mark.slow
def test_bounces_off_leave_hashes_and_need_embree() -> None:
    plain = compose_config(["render=embree"])
    assert identity(plain)["render"]["bounces"] == 0
    assert "reflection_loss_db" not in identity(plain)["render"]
    hashes = {
        config_hash(identity(compose_config(["render=embree", *words])))
        for words in (
            (),
            ("render.bounces=1",),
            ("render.bounces=1", "render.reflection_loss_db=3"),
        )
    }
    assert len(hashes) == 3
    assert renderer_of(compose_config(["render.bounces=1"])).settings.kind == "embree"
    for words, key in (
        (["render=cycles", "render.bounces=1"], "render.bounces"),
        (["render=analytic", "render.bounces=1"], "render.bounces"),
        (["render=embree", "render.bounces=2"], "render.bounces"),
        (["render=embree", "render.bounces=1", "render.reflection_loss_db=-1"], "reflection_loss"),
    ):
        with pytest.raises(FactoryError, match=key):
            compose_config(words)
