"""The procedural seabed: reproducible, plausible, consistent in the world, and varied."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import numpy.typing as npt
import pytest
import yaml

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import Frame
from simnfnd.factory.labels import CLASSES
from simnfnd.factory.scenes.seabed import SeabedSettings
from simnfnd.factory.scenes.seabed.biomes import PLACE_NAMES
from simnfnd.factory.scenes.seabed.world import build_world
from simnfnd.factory.settings import build
from tests.factory.scenes.seabed_frames import fingerprint, ref, small_reader
from tests.project_files import ROOT

LOCATIONS, POSES = range(10), (0, 1)


def world_points(frame: Frame) -> npt.NDArray[np.float64]:
    """(H, W, 3) points of a frame in world axes, by the pinhole model."""
    assert frame.world_from_camera is not None
    v, u = np.indices(frame.depth_m.shape)
    camera = frame.intrinsics
    depth = frame.depth_m.astype(np.float64)
    x, y = (u - camera.cx) / camera.fx * depth, (v - camera.cy) / camera.fy * depth
    points = np.stack([x, y, depth], axis=-1)
    return np.asarray(points @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3])


@pytest.fixture(scope="module")
def frames() -> dict[tuple[int, int], Frame]:
    reader = small_reader()
    return {(k, pose): reader.load(ref(k, pose)) for k in LOCATIONS for pose in POSES}


def test_every_frame_is_measured_in_part_and_at_close_range(
    frames: dict[tuple[int, int], Frame],
) -> None:
    for name, frame in frames.items():
        depth = frame.depth_m[frame.valid]
        assert 0.5 < frame.valid.mean() < 0.95, name
        assert depth.min() > 0.5, name
        assert depth.max() < 20, name
        assert 1.0 < np.median(depth) < 8, name


def test_an_instance_is_of_one_class_and_ground_has_none(
    frames: dict[tuple[int, int], Frame],
) -> None:
    for frame in frames.values():
        assert frame.segmentation is not None
        assert frame.instance is not None
        np.testing.assert_array_equal(frame.segmentation > 0, frame.instance > 0)
        for number in np.unique(frame.instance):
            assert len(np.unique(frame.segmentation[frame.instance == number])) == 1


def test_every_class_is_seen(frames: dict[tuple[int, int], Frame]) -> None:
    seen = {int(k) for f in frames.values() for k in np.unique(f.segmentation)}  # type: ignore[arg-type]
    assert {CLASSES[k] for k in seen} == set(CLASSES)


def test_poses_are_rigid_and_look_a_little_down(frames: dict[tuple[int, int], Frame]) -> None:
    for name, frame in frames.items():
        assert frame.world_from_camera is not None
        rotation = frame.world_from_camera[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert 8 <= np.rad2deg(np.arcsin(-rotation[2, 2])) <= 35, name  # pitch
        assert rotation[2, 1] < -0.8, name  # the picture's y axis points down


def test_two_views_show_the_same_surface(frames: dict[tuple[int, int], Frame]) -> None:
    """Points of one view, seen from the next, are never in front of what that view measured."""
    checked = 0
    for location in LOCATIONS:
        one, two = (frames[location, pose] for pose in POSES)
        assert two.world_from_camera is not None
        points = world_points(one)[one.valid]
        inverse = np.linalg.inv(two.world_from_camera)
        x, y, z = (points @ inverse[:3, :3].T + inverse[:3, 3]).T
        camera = two.intrinsics
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        inside = (z > 0.3) & (u > 1) & (u < 240) & (v > 1) & (v < 150)
        column, row = u[inside].round().astype(int), v[inside].round().astype(int)
        measured, expected = two.depth_m[row, column], z[inside]
        # A pixel away from depth edges, whose neighbours agree, may be compared point to pixel.
        around = np.stack(
            [two.depth_m[row + dy, column + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
        )
        flat = (around.min(axis=0) > 0) & (np.ptp(around, axis=0) < 0.04 * measured)
        if flat.sum() < 300:
            continue
        checked += 1
        error = (expected - measured)[flat] / measured[flat]
        assert (error < -0.06).mean() < 0.01
        visible = error < 0.06  # the others are hidden in the second view
        assert visible.mean() > 0.3
        assert np.median(np.abs(error[visible])) < 0.012
    assert checked >= 3


def test_a_frame_depends_on_its_name_alone(frames: dict[tuple[int, int], Frame]) -> None:
    """Neither the order of work, nor other frames, nor how many are asked for, nor the process."""
    expected = [fingerprint(frames[key]) for key in ((3, 1), (4, 0), (3, 0))]
    script = (
        "from tests.factory.scenes.seabed_frames import *\n"
        "reader = small_reader(locations=9, first_location=1, frames_per_location=1)\n"
        "print(*(fingerprint(reader.load(ref(k, pose))) for k, pose in ((4, 0), (3, 0), (3, 1))))"
    )
    run = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True
    )
    elsewhere = run.stdout.split()
    assert [elsewhere[2], elsewhere[0], elsewhere[1]] == expected


def test_only_wanted_kinds_lie_there() -> None:
    reader = small_reader(kinds=("Tire", "Boulder"), places=("debris",))
    seen = np.unique(np.concatenate([reader.load(ref(k, 0)).segmentation for k in range(3)]))
    assert {CLASSES[k] for k in seen} == {"Background", "Tire", "Boulder"}


def test_an_empty_seabed_works() -> None:
    reader = small_reader(objects=0, kinds=(), places=("sand",))
    frame = reader.load(ref(0, 0))
    assert frame.segmentation is not None
    assert not frame.segmentation.any()
    assert frame.valid.mean() > 0.5


def test_leaving_a_kind_out_does_not_move_the_ground() -> None:
    whole = build_world(0, PLACE_NAMES, 1.0, None)
    fewer = build_world(0, PLACE_NAMES, 1.0, ("Tire",))
    assert len(fewer.objects.labels) < len(whole.objects.labels)
    x = np.linspace(-9, 9, 50, dtype=np.float32)
    np.testing.assert_array_equal(whole.terrain.height_m(x, x), fewer.terrain.height_m(x, x))
    np.testing.assert_array_equal(whole.path.loop.points, fewer.path.loop.points)
    np.testing.assert_array_equal(whole.look.water, fewer.look.water)


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"locations": 0}, "scenes.locations"),
        ({"frames_per_location": 0}, "scenes.frames_per_location"),
        ({"width": 10}, "scenes.width"),
        ({"objects": -1}, "scenes.objects"),
        ({"objects": float("nan")}, "scenes.objects"),
        ({"kinds": ["Shark"]}, "scenes.kinds"),
        ({"places": []}, "scenes.places"),
        ({"places": ["moon"]}, "scenes.places"),
        ({"depth_kind": "range"}, "scenes.depth_kind"),
        ({"first_location": 9999, "locations": 2}, "first_location"),
        ({"sharks": 1}, "scenes.sharks: unknown key"),
    ],
)
def test_bad_settings_are_refused_with_their_key(values: dict[str, object], key: str) -> None:
    with pytest.raises(FactoryError, match=key) as caught:
        build(SeabedSettings, values, "scenes")
    assert "\n" not in str(caught.value)


def test_the_config_file_lists_every_key_with_its_default() -> None:
    values = yaml.safe_load((ROOT / "conf/scenes/seabed.yaml").read_text())
    assert build(SeabedSettings, values, "scenes") == SeabedSettings()
    assert set(values) == set(SeabedSettings.__dataclass_fields__)
