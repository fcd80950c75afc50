"""Flat places where objects are looked for, their fittings, and detailed models of objects."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.meaning import CLASSES, FITTING
from simnfnd.factory.simulation.meshes.triangle_mesh import box
from simnfnd.factory.simulation.scenes.seabed import SeabedReader, SeabedSettings, detailed
from simnfnd.factory.simulation.scenes.seabed.world import Own, SeabedWorld

NAMES = (*CLASSES, "crate", FITTING)


@cache
def tank() -> SeabedWorld:
    crate = Own("crate", (2, 2), (0.0, 0.0), (0.0, 0.0), box((0.2, 0.2, 0.2)))
    return SeabedWorld(3, ["tank"], 0.4, ["Tire", "Wall"], [crate], NAMES)


def test_a_tank_has_walls_a_flat_floor_and_fittings_without_numbers() -> None:
    world = tank()
    objects = world.objects
    walls = np.flatnonzero(objects.labels == CLASSES.index("Wall"))
    assert len(walls) == 1
    low, high = _limits(world, int(walls[0]))
    assert (low[:2] < -1.5).all()
    assert (high[:2] > 1.5).all()
    x, y = np.meshgrid(np.linspace(-2, 2, 9), np.linspace(-2, 2, 9))
    assert np.ptp(world.terrain.height_m(x, y)) < 0.25
    fittings = objects.labels == NAMES.index(FITTING)
    assert fittings.sum() >= 6
    assert not objects.instances[fittings].any()
    numbers = objects.instances[objects.instances > 0]
    assert numbers.tolist() == list(range(1, len(numbers) + 1))


def test_objects_of_the_catalogue_and_of_the_user_lie_in_the_tank() -> None:
    world = tank()
    walls = int(np.flatnonzero(world.objects.labels == CLASSES.index("Wall"))[0])
    low, high = _limits(world, walls)
    for name in ("Tire", "crate"):
        own = np.flatnonzero(world.objects.labels == NAMES.index(name))
        assert len(own) >= (2 if name == "crate" else 1)
        for number in own:
            least, most = _limits(world, int(number))
            assert (least[:2] > low[:2]).all()
            assert (most[:2] < high[:2]).all()


def _limits(world: SeabedWorld, number: int) -> tuple[np.ndarray, np.ndarray]:
    first, _, last, _ = world.objects.parts[number]
    points = world.objects.mesh.vertices[first:last]
    return points.min(axis=0), points.max(axis=0)


@pytest.mark.parametrize("place", ["harbour", "mud"])
def test_frames_of_flat_places_have_depth_everywhere(place: Any) -> None:
    settings = SeabedSettings(
        width=160, height=100, places=(place,), objects=0.2, depth_gaps=False, locations=1
    )
    assert settings.own_classes() == ((FITTING,) if place == "harbour" else ())
    frame = SeabedReader(settings).load(FrameRef("seabed", "seabed-0000", "0000"))
    # Below the horizon there is ground, or what stands on it.
    assert frame.valid[70:].all()
    gaps = SeabedSettings(width=160, height=100, places=(place,), objects=0.2, locations=1)
    with_gaps = SeabedReader(gaps).load(frame.ref)
    assert with_gaps.valid.sum() < frame.valid.sum()
    np.testing.assert_array_equal(
        with_gaps.depth_m[with_gaps.valid], frame.depth_m[with_gaps.valid]
    )


@pytest.mark.parametrize("kind", detailed.BUILDERS)
def test_detailed_models_rest_on_the_ground_in_their_real_sizes(kind: str) -> None:
    heights = set()
    for builder in dict.fromkeys(detailed.BUILDERS[kind]):
        for seed in (1, 2):
            mesh = builder(np.random.default_rng(seed))
            size = np.ptp(mesh.vertices, axis=0)
            assert np.isfinite(mesh.vertices).all()
            assert mesh.triangles.max() < len(mesh.vertices)
            assert abs(float(mesh.vertices[:, 2].min())) < 0.01
            assert 0.08 < size.max() < 2.5
            heights.add(round(float(size[2]), 4))
    assert len(heights) > 2


def test_a_propeller_has_the_pitch_of_a_helicoid() -> None:
    """z over the angle is the pitch over a turn at every radius."""
    pitch = 1.1
    blade = detailed._helicoid_blade(np.random.default_rng(0), pitch, 0.2, 0.6)
    x, y, z = blade.vertices.astype(float).T
    slope = np.polyfit(np.arctan2(y, x), z, 1)[0]
    # A propeller of radius 1 has a diameter of 2, so one turn advances it by 2 pitch.
    assert slope == pytest.approx(2 * pitch / (2 * np.pi), rel=0.02)
