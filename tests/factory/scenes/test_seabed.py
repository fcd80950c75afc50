"""The procedural seabed: reproducible, plausible, consistent, varied; its camera and shapes."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import yaml

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import FactoryConfig, from_mapping, identity
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import Frame, FrameRef
from simnfnd.factory.labels import CLASSES
from simnfnd.factory.scenes import open_reader
from simnfnd.factory.scenes.seabed import SeabedSettings, kernels, view
from simnfnd.factory.scenes.seabed.biomes import PLACE_NAMES
from simnfnd.factory.scenes.seabed.camera import Movement, Optics, camera, movements, pose, z_buffer
from simnfnd.factory.scenes.seabed.meshes import Mesh, box, grid_triangles, lathe, sphere, tube
from simnfnd.factory.scenes.seabed.terrain import view_mesh
from simnfnd.factory.scenes.seabed.view import choose_pose
from simnfnd.factory.scenes.seabed.world import build_world
from simnfnd.factory.seeds import stream
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


@pytest.mark.parametrize("location", [3])
def test_the_path_keeps_clear_of_everything(location: int) -> None:
    open3d: Any = pytest.importorskip("open3d")
    world = build_world(location, PLACE_NAMES, 1.0, None)
    side = np.arange(-36, 36, 0.3)
    x, y = np.meshgrid(side, side, indexing="ij")
    ground = np.stack([x, y, world.terrain.height_m(x, y)], axis=-1).reshape(-1, 3)
    things = world.objects.mesh
    meshes = ((ground, grid_triangles(len(side), len(side))), (things.vertices, things.triangles))
    scenes = [ray_casting(open3d, *one) for one in meshes]
    for number in (*range(0, 60, 6), 5000):
        eye = world.path.eye(number, world.terrain)
        query = open3d.core.Tensor(eye[None].astype(np.float32))
        for scene in scenes:
            assert scene.compute_distance(query).numpy()[0] > 0.4
        ground_m = world.terrain.height_m(eye[:1], eye[1:2])[0]
        assert 0.7 <= eye[2] - ground_m <= 3.0


def ray_casting(open3d: Any, vertices: npt.NDArray[Any], triangles: npt.NDArray[Any]) -> Any:
    """Open3D's own ray-casting scene of a mesh: somebody else's arithmetic."""
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        open3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return scene


@pytest.mark.parametrize(
    ("location", "optics"), [(2, camera(242, 152)), (6, camera(242, 152, 130, 20))]
)
def test_the_z_buffer_meets_what_rays_meet(location: int, optics: Optics) -> None:
    """Depth and triangle of every pixel against Open3D's rays, near the lens and in wide views."""
    open3d: Any = pytest.importorskip("open3d")
    world = build_world(location, PLACE_NAMES, 1.0, None)
    where = choose_pose(world, 1)
    ground = view_mesh(world.terrain, where.eye, (-4.0, 4.0), (-0.9, 0.3), (80, 200)).points
    objects = world.objects
    seen = z_buffer(where, optics, ground, objects)
    toward = optics.directions(where.rotation)
    rays = np.concatenate([np.broadcast_to(where.eye, toward.shape), toward], axis=-1)
    floor = grid_triangles(*ground.shape[:2])
    answers = [
        ray_casting(open3d, points, triangles).cast_rays(
            open3d.core.Tensor(rays.astype(np.float32)), nthreads=1
        )
        for points, triangles in (
            (ground.reshape(-1, 3), floor),
            (objects.mesh.vertices, objects.mesh.triangles),
        )
    ]
    floor_m, object_m = (answer["t_hit"].numpy() for answer in answers)
    expected = np.minimum(floor_m, object_m)
    met = seen.which >= 0
    assert (met == np.isfinite(expected)).mean() > 0.9999
    both = met & np.isfinite(expected)
    error = np.abs(1 / seen.inverse[both] - expected[both]) / expected[both]
    assert np.percentile(error, 99) < 1e-4
    on_object = object_m < floor_m
    assert ((seen.which >= len(floor)) == on_object)[both].mean() > 0.999


def test_shadows_fall_where_rays_to_the_sun_are_blocked(monkeypatch: pytest.MonkeyPatch) -> None:
    """By two pictures of one view, with the sun's own picture of objects and without."""
    open3d: Any = pytest.importorskip("open3d")
    world = build_world(4, PLACE_NAMES, 1.0, None)
    optics, where = camera(484, 304), choose_pose(world, 1)
    ground = view_mesh(world.terrain, where.eye, *view.field_of_view(where, optics), (220, 160))
    seen = z_buffer(where, optics, ground.points, world.objects)
    colours: list[npt.NDArray[np.float32]] = []
    monkeypatch.setattr(kernels, "expose", lambda colour, *_: colours.append(colour))
    view.photograph(world, where, optics, ground, seen, 0.8)
    sight, picture = view.shadows(world, where)
    monkeypatch.setattr(view, "shadows", lambda *_: (sight, np.zeros_like(picture)))
    view.photograph(world, where, optics, ground, seen, 0.8)
    dark, bright = (colour.sum(axis=-1) for colour in colours)
    assert (dark <= bright).all()
    toward = optics.directions(where.rotation)[::2, ::2]
    depth = seen.depth_m[::2, ::2]
    near = np.isfinite(depth) & (depth < 6)
    start = where.eye + np.where(near, depth, 1)[..., None] * toward
    sun = np.broadcast_to(world.look.sun_direction, start.shape)
    rays = np.concatenate([start + 0.04 * sun, sun], axis=-1)[near].astype(np.float32)
    things = ray_casting(open3d, world.objects.mesh.vertices, world.objects.mesh.triangles)
    blocked = things.test_occlusions(open3d.core.Tensor(rays), nthreads=1).numpy()
    shaded = (dark < 0.999 * bright)[near]
    assert shaded.mean() > 0.02  # there is something to find
    assert blocked[shaded].mean() > 0.8
    # What is blocked, but no darker without the objects, is turned away from the sun.
    assert shaded[blocked].mean() > 0.3


def volume(mesh: Mesh) -> float:
    """Signed volume by the divergence theorem: positive where triangles face outward."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (lambda: box((2, 3, 4), (5, 5, 5)), 24),
        (lambda: sphere(4), 4 / 3 * np.pi),
        (lambda: lathe([[0, 0], [1, 0], [1, 2], [0, 2]], 200, crease=True), 2 * np.pi),
        (lambda: tube([[0, 0, 0], [1, 0, 0], [3, 0, 0]], 0.5, 200), 3 * np.pi / 4),
        (lambda: tube(_ring(400), 0.1, 200, closed=True), 2 * np.pi**2 * 0.01),
    ],
    ids=["box", "sphere", "lathe", "tube", "torus"],
)
def test_meshes_are_closed_and_face_outward(shape: Callable[[], Mesh], expected: float) -> None:
    assert volume(shape()) == pytest.approx(expected, rel=0.01)


def _ring(count: int) -> npt.NDArray[np.float64]:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])


def test_depth_is_lost_far_away_and_behind_edges_in_the_share_drawn() -> None:
    depth_m = np.full((608, 968), 3.0, np.float32)
    depth_m[:, 500:] = 4.5
    depth_m[:60] = np.inf
    keep = view.measured(stream(1, "gaps"), depth_m, depth_m, 5.0)
    assert not keep[:60].any()
    assert 0.6 < keep.mean() < 0.93
    behind, before = keep[200:400, 500:504].mean(), keep[200:400, 496:500].mean()
    assert behind < 0.6 < before
    assert not view.measured(stream(1, "gaps"), depth_m, depth_m, 1.0).any()


PATH = "time_s,surge_m,heave_m,yaw_deg\n0,0,0,0\n0.2,0.5,0.1,10\n"


def written(folder, text):
    path = folder / "path.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_path_is_read(tmp_path):
    found = movements(written(tmp_path, PATH))
    assert found == (Movement(0.0), Movement(0.2, surge_m=0.5, heave_m=0.1, yaw_deg=10.0))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "expected a header"),
        ("surge,yaw\n0,0\n", "expected a header"),
        ("surge_m,surge_m\n0,0\n", "expected a header"),
        ("surge_m\n", "0 lines"),
        ("surge_m,yaw_deg\n0,0\n1\n", "path.csv:3: expected 2 numbers"),
        ("surge_m\nnan\n", "path.csv:2"),
        ("surge_m\nx\n", "path.csv:2"),
    ],
)
def test_bad_files_are_one_line(tmp_path, text, says):
    with pytest.raises(FactoryError, match=says):
        movements(written(tmp_path, text))


def test_movements_are_along_the_first_heading():
    start = pose(np.array([1.0, 2.0, 3.0]), 90, 20, 0)  # looks along +y, 20 degrees down
    eye, rotation = Movement(surge_m=1, sway_m=2, heave_m=0.5).moved(start.eye, start.rotation)
    assert eye == pytest.approx([-1, 3, 3.5])
    assert rotation == pytest.approx(start.rotation)
    turn = Movement(yaw_deg=30, pitch_deg=5, roll_deg=3)
    _, rotation = turn.moved(start.eye, start.rotation)
    assert rotation == pytest.approx(pose(start.eye, 120, 25, 3).rotation)


def test_frames_are_the_lines(tmp_path):
    path = written(tmp_path, PATH)
    config = from_mapping(
        {
            "scenes": {
                "kind": "seabed", "locations": 1, "path": str(path), "width": 96, "height": 64,
            }
        }
    )  # fmt: skip
    reader = open_reader(config.scenes)
    refs = reader.discover().frames
    assert [ref.frame for ref in refs] == ["0000", "0001"]
    first, second = (reader.load(ref) for ref in refs)
    assert (first.time_s, second.time_s) == (0.0, 0.2)
    assert first.altitude_m is not None
    assert first.altitude_m > 0.5
    there, here = first.world_from_camera, second.world_from_camera
    assert there is not None
    assert here is not None
    assert np.linalg.norm(here[:2, 3] - there[:2, 3]) == pytest.approx(0.5)
    assert here[2, 3] - there[2, 3] == pytest.approx(0.1)
    known = identity(config)["scenes"]["path"]
    path.write_text(PATH + "0.4,1,0,0\n", encoding="utf-8")
    assert identity(config)["scenes"]["path"] != known
    path.unlink()
    with pytest.raises(FactoryError, match="cannot be read"):
        identity(config)


SMALL = ("scenes.width=320", "scenes.height=200")


@cache
def config_of(*words: str) -> FactoryConfig:
    return compose_config([*SMALL, *words])


@pytest.mark.parametrize(("hfov_deg", "vfov_deg"), [(60, 12), (90, 20), (130, 20)])
def test_a_sector_is_seen_whole_and_costs_its_solid_angle(hfov_deg: int, vfov_deg: int) -> None:
    optics = camera(968, 608, hfov_deg, vfov_deg)
    azimuth, elevation = np.deg2rad([hfov_deg / 2, vfov_deg / 2])
    x = optics.intrinsics.fx * np.tan(azimuth)
    y = optics.intrinsics.fy * np.tan(elevation) / np.cos(azimuth)
    assert optics.intrinsics.cx + x < optics.width - 1
    assert optics.intrinsics.cy + y < optics.height - 1
    angle = 2 * 2 * azimuth * np.sin(elevation)
    usual = 2 * np.deg2rad(45) * np.sin(np.deg2rad(29.2 / 2))
    assert optics.width * optics.height / (968 * 608) == pytest.approx(angle / usual, rel=0.02)


@cache
def frame_of(scenes: SeabedSettings) -> Frame:
    return open_reader(scenes).load(FrameRef("seabed", "seabed-0000", "0000"))


@pytest.mark.parametrize("sonar", ["aris_3000", "gemini_720is", "oculus_m750d_lf"])
def test_every_sonar_has_ground_all_over_its_sector(sonar: str) -> None:
    config = config_of(f"sonar={sonar}", "scenes.places=[sand]")
    assert isinstance(config.scenes, SeabedSettings)
    frame = frame_of(config.scenes)
    columns = np.flatnonzero((frame.depth_m > 0).any(axis=0))
    azimuth_deg = np.rad2deg(np.arctan((columns - frame.intrinsics.cx) / frame.intrinsics.fx))
    half = config.sonar.hfov_deg / 2
    inside = azimuth_deg[np.abs(azimuth_deg) <= half]
    assert inside.max() - inside.min() >= 0.95 * config.sonar.hfov_deg


def test_what_is_asked_for_wins_over_the_sonar() -> None:
    config = config_of("sonar=oculus_m750d_lf", "scenes.hfov_deg=50", "scenes.vfov_deg=30")
    assert isinstance(config.scenes, SeabedSettings)
    assert (config.scenes.hfov_deg, config.scenes.vfov_deg) == (50, 30)
    with pytest.raises(FactoryError, match="give hfov_deg and vfov_deg, or neither"):
        compose_config(["scenes.hfov_deg=50"])
