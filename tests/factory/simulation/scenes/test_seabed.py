"""The procedural seabed: reproducible, plausible, consistent, varied; its camera and shapes."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest

from simnfnd.factory.common.array_types import Float64s
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.meaning import CLASSES
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.config.root import from_mapping
from simnfnd.factory.simulation.frames.frame import Frame
from simnfnd.factory.simulation.meshes.camera import moved, movements, pose
from simnfnd.factory.simulation.meshes.triangle_mesh import grid_triangles
from simnfnd.factory.simulation.scenes import open_reader
from simnfnd.factory.simulation.scenes.seabed import SeabedReader, SeabedSettings
from simnfnd.factory.simulation.scenes.seabed.terrain import PLACE_NAMES, ObjectPlaceName, catalogue
from simnfnd.factory.simulation.scenes.seabed.world import SeabedWorld
from tests.project_files import ROOT

LOCATIONS = range(8)
POSES = (0, 1)


def small_reader(**keys: Any) -> SeabedReader:
    """A reader of images a quarter as wide and high as FLSea's."""
    return SeabedReader(SeabedSettings(**{"width": 242, "height": 152, **keys}))


def ref(location: int, pose: int) -> FrameRef:
    return FrameRef("seabed", f"seabed-{location:04d}", f"{pose:04d}")


def fingerprint(frame: Frame) -> str:
    digest = hashlib.sha256()
    arrays = (frame.rgb, frame.depth_m, frame.world_from_camera, frame.segmentation, frame.instance)
    for array in arrays:
        assert array is not None
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def world_points(frame: Frame) -> Float64s:
    """(H, W, 3) points of a frame in world axes, by the pinhole model."""
    assert frame.world_from_camera is not None
    v, u = np.indices(frame.depth_m.shape)
    camera = frame.intrinsics
    depth = frame.depth_m.astype(np.float64)
    x = (u - camera.cx) / camera.fx * depth
    y = (v - camera.cy) / camera.fy * depth
    points = np.stack([x, y, depth], axis=-1)
    return np.asarray(points @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3])


@cache
def small_frame(location: int, pose: int) -> Frame:
    return small_reader().load(ref(location, pose))


@pytest.fixture(scope="module")
def frames() -> dict[tuple[int, int], Frame]:
    return {(k, pose): small_frame(k, pose) for k in LOCATIONS for pose in POSES}


@pytest.mark.slow
def test_frames_are_measured_labelled_and_look_a_little_down(
    frames: dict[tuple[int, int], Frame],
) -> None:
    """Close ground, one class an instance and none for ground, rigid poses, every class seen."""
    observed: set[int] = set()
    for name, frame in frames.items():
        depth = frame.depth_m[frame.valid]
        assert 0.5 < frame.valid.mean() < 0.95, name
        assert 0.5 < depth.min() < depth.max() < 20, name
        assert 1.0 < np.median(depth) < 8, name
        assert frame.segmentation is not None
        assert frame.instance is not None
        np.testing.assert_array_equal(frame.segmentation > 0, frame.instance > 0)
        for number in np.unique(frame.instance):
            classes = np.unique(frame.segmentation[frame.instance == number])
            assert len(classes) == 1
            observed.update(map(int, classes))
        assert frame.world_from_camera is not None
        rotation = frame.world_from_camera[:3, :3]
        np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert 8 <= np.rad2deg(np.arcsin(-rotation[2, 2])) <= 35, name  # pitch
        assert rotation[2, 1] < -0.8, name  # the image's y axis points down
    assert {CLASSES[k] for k in observed} == set(CLASSES)


def test_two_views_show_the_same_surface() -> None:
    """Points of one view, seen from the next, are never in front of what that view measured."""
    checked = 0
    for location in LOCATIONS[:4]:
        first_view, second_view = (small_frame(location, pose) for pose in POSES)
        assert second_view.world_from_camera is not None
        points = world_points(first_view)[first_view.valid]
        inverse = np.linalg.inv(second_view.world_from_camera)
        x, y, z = (points @ inverse[:3, :3].T + inverse[:3, 3]).T
        camera = second_view.intrinsics
        with np.errstate(divide="ignore", invalid="ignore"):
            u = camera.fx * x / z + camera.cx
            v = camera.fy * y / z + camera.cy
        inside = (z > 0.3) & (u > 1) & (u < 240) & (v > 1) & (v < 150)
        column = u[inside].round().astype(int)
        row = v[inside].round().astype(int)
        measured = second_view.depth_m[row, column]
        expected = z[inside]
        # A pixel away from depth edges, whose neighbours agree, may be compared point to pixel.
        around = np.stack(
            [second_view.depth_m[row + dy, column + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
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
    assert checked >= 2


@pytest.mark.slow
def test_a_frame_depends_on_its_name_alone(frames: dict[tuple[int, int], Frame]) -> None:
    """Neither the order of work, nor other frames, nor how many are asked for, nor the process."""
    expected = [fingerprint(frames[key]) for key in ((3, 1), (4, 0), (3, 0))]
    script = (
        "from tests.factory.simulation.scenes.test_seabed import *\n"
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
    observed = np.unique(np.concatenate([reader.load(ref(k, 0)).segmentation for k in range(3)]))
    assert {CLASSES[k] for k in observed} == {"Background", "Tire", "Boulder"}
    bare = small_reader(objects=0, kinds=(), places=("sand",)).load(ref(0, 0))
    assert bare.segmentation is not None
    assert not bare.segmentation.any()
    assert bare.valid.mean() > 0.5


def test_the_table_has_every_place_and_class() -> None:
    table = catalogue()
    assert set(table["places"]) == {*PLACE_NAMES, *get_args(ObjectPlaceName)}
    assert len({tuple(sorted(place)) for place in table["places"].values()}) == 1
    assert set(table["finishes"]) == {*CLASSES[1:], "Fitting", "own"}


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"locations": 0}, "scenes.locations"),
        ({"width": 10}, "scenes.width"),
        ({"kinds": ["Shark"]}, "scenes.kinds"),
        ({"places": ["moon"]}, "scenes.places"),
        ({"sharks": 1}, "scenes.sharks: unknown key"),
    ],
)
def test_bad_settings_are_refused_with_their_key(values: dict[str, object], key: str) -> None:
    with pytest.raises(FactoryError, match=key) as caught:
        build(SeabedSettings, values, "scenes")
    assert "\n" not in str(caught.value)


def test_the_path_keeps_clear_of_everything() -> None:
    """By Open3D's own distances: somebody else's arithmetic."""
    open3d: Any = pytest.importorskip("open3d")
    world = SeabedWorld(3, PLACE_NAMES, 1.0, None)
    side = np.arange(-36, 36, 0.3)
    x, y = np.meshgrid(side, side, indexing="ij")
    ground = np.stack([x, y, world.terrain.height_m(x, y)], axis=-1).reshape(-1, 3)
    things = world.objects.mesh
    meshes = ((ground, grid_triangles(len(side), len(side))), (things.vertices, things.triangles))
    scenes = []
    for vertices, triangles in meshes:
        scenes.append(open3d.t.geometry.RaycastingScene(nthreads=1))
        scenes[-1].add_triangles(vertices.astype(np.float32), triangles.astype(np.uint32))
    for number in (*range(0, 60, 6), 5000):
        eye = world.path.view(number)[0]
        query = open3d.core.Tensor(eye[None].astype(np.float32))
        for scene in scenes:
            assert scene.compute_distance(query).numpy()[0] > 0.4
        ground_m = world.terrain.height_m(eye[:1], eye[1:2])[0]
        assert 0.7 <= eye[2] - ground_m <= 3.0


PATH = "time_s,surge_m,heave_m,yaw_deg\n0,0,0,0\n0.2,0.5,0.1,10\n"


def written(folder, text):
    path = folder / "path.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "expected a header"),
        ("surge_m,depth_m\n0,0\n", "expected a header of some of time_s, surge_m"),
        ("surge_m\n", "a line for each frame"),
        ("surge_m,yaw_deg\n0,0\n1\n", "path.csv:3: expected 2 numbers"),
        ("surge_m\nnan\n", "path.csv:2"),
    ],
)
def test_bad_paths_are_one_line(tmp_path, text, says):
    with pytest.raises(FactoryError, match=says):
        movements(written(tmp_path, text))


def test_movements_are_along_the_first_heading():
    start = pose(np.array([1.0, 2.0, 3.0]), 90, 20, 0)  # looks along +y, 20 degrees down
    shifted = moved(start, {"surge_m": 1, "sway_m": 2, "heave_m": 0.5})
    assert shifted.eye == pytest.approx([-1, 3, 3.5])
    assert shifted.rotation == pytest.approx(start.rotation)
    turned = moved(start, {"yaw_deg": 30, "pitch_deg": 5, "roll_deg": 3})
    assert turned.rotation == pytest.approx(pose(start.eye, 120, 25, 3).rotation)


def test_frames_are_the_lines(tmp_path):
    path = written(tmp_path, PATH)
    still = {"time_s": 0, "surge_m": 0, "heave_m": 0, "yaw_deg": 0}
    assert movements(path) == (
        still,
        {"time_s": 0.2, "surge_m": 0.5, "heave_m": 0.1, "yaw_deg": 10},
    )
    scenes = {"kind": "seabed", "locations": 1, "path": str(path), "width": 96, "height": 64}
    config = from_mapping({"scenes": scenes})
    reader = open_reader(config.scenes)
    refs = reader.discover().frames
    assert [ref.frame for ref in refs] == ["0000", "0001"]
    first, second = (reader.load(ref) for ref in refs)
    assert (first.time_s, second.time_s) == (0.0, 0.2)
    assert first.altitude_m is not None
    assert first.altitude_m > 0.5
    first_pose = first.world_from_camera
    second_pose = second.world_from_camera
    assert first_pose is not None
    assert second_pose is not None
    assert np.linalg.norm(second_pose[:2, 3] - first_pose[:2, 3]) == pytest.approx(0.5)
    assert second_pose[2, 3] - first_pose[2, 3] == pytest.approx(0.1)
    known = identity(config)["scenes"]["path"]
    path.write_text(PATH + "0.4,1,0,0\n", encoding="utf-8")
    assert identity(config)["scenes"]["path"] != known
    path.unlink()
    with pytest.raises(FactoryError, match="cannot be read"):
        identity(config)


@pytest.mark.parametrize("sonar", ["aris_3000", "gemini_720is", "oculus_m750d_lf"])
def test_every_sonar_has_ground_all_over_its_sector(sonar: str) -> None:
    words = ("scenes.width=320", "scenes.height=200", "scenes.places=[sand]")
    config = compose_config([f"sonar={sonar}", *words])
    frame = open_reader(config.scenes).load(ref(0, 0))
    columns = np.flatnonzero((frame.depth_m > 0).any(axis=0))
    azimuth_deg = np.rad2deg(np.arctan((columns - frame.intrinsics.cx) / frame.intrinsics.fx))
    half = config.sonar.hfov_deg / 2
    inside = azimuth_deg[np.abs(azimuth_deg) <= half]
    assert inside.max() - inside.min() >= 0.95 * config.sonar.hfov_deg


def test_what_is_asked_for_wins_over_the_sonar() -> None:
    config = compose_config(["sonar=oculus_m750d_lf", "scenes.hfov_deg=50", "scenes.vfov_deg=30"])
    assert isinstance(config.scenes, SeabedSettings)
    assert (config.scenes.hfov_deg, config.scenes.vfov_deg) == (50, 30)
    with pytest.raises(FactoryError, match="hfov_deg and vfov_deg"):
        compose_config(["scenes.hfov_deg=50"])
