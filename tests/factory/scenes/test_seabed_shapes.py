"""What the seabed is drawn with: depth and shadows as rays meet them, meshes, waves, noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.factory.scenes.seabed import kernels, view
from simnfnd.factory.scenes.seabed.biomes import PLACE_NAMES
from simnfnd.factory.scenes.seabed.camera import Optics, camera, z_buffer
from simnfnd.factory.scenes.seabed.meshes import Mesh, box, grid_triangles, lathe, sphere, tube
from simnfnd.factory.scenes.seabed.terrain import view_mesh
from simnfnd.factory.scenes.seabed.view import choose_pose
from simnfnd.factory.scenes.seabed.world import build_world
from simnfnd.factory.seeds import stream


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
    for pose in (*range(0, 60, 6), 5000):
        eye = world.path.eye(pose, world.terrain)
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
