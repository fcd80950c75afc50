"""Ray casting: what each pixel of a camera meets, and which points the sun reaches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import Intrinsics
from simnfnd.factory.scenes.seabed.fields import Arrays, Floats
from simnfnd.factory.scenes.seabed.meshes import Indices, Mesh, vertex_normals
from simnfnd.factory.scenes.seabed.terrain import GroundMesh

if TYPE_CHECKING:
    from open3d.t.geometry import RaycastingScene

Points = npt.NDArray[np.float64]


def _open3d() -> Any:
    """Open3D, imported late: it takes a second, and a run that only plans frames needs none."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise FactoryError(
            f'scenes=seabed needs Open3D ({error}): pip install "simnfnd[open3d]"'
        ) from error
    return open3d


def raycasting_scene(vertices: Floats, triangles: Indices) -> RaycastingScene:
    """An Open3D scene of one mesh, built by one thread so that ties always fall the same way."""
    open3d = _open3d()
    scene = open3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        open3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        open3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return scene


def cast(scene: RaycastingScene, rays: Floats) -> dict[str, Any]:
    """Open3D's answer for (..., 6) rays as numpy arrays; t_hit is in lengths of the direction."""
    answer = scene.cast_rays(_open3d().core.Tensor(rays), nthreads=1)
    return {name: tensor.numpy() for name, tensor in answer.items()}


def blocked(scene: RaycastingScene, rays: Floats, reach: float) -> npt.NDArray[np.bool_]:
    """(...) whether (..., 6) rays meet anything within `reach` lengths of their direction."""
    tensor = scene.test_occlusions(_open3d().core.Tensor(rays), tnear=0.0, tfar=reach, nthreads=1)
    return np.asarray(tensor.numpy())


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a camera is and how it is turned: rotation (3, 3) takes camera to world axes."""

    eye: Points
    rotation: Points

    @property
    def matrix(self) -> Points:
        """(4, 4) world from camera."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.eye
        return matrix


def pose(eye: Points, heading_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """A camera that looks along a heading (counter-clockwise from +x), pitched down, rolled."""
    heading, pitch, roll = np.deg2rad([heading_deg, pitch_deg, roll_deg])
    level = np.array([np.cos(heading), np.sin(heading), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cos(pitch) * level - np.sin(pitch) * up
    down = -np.sin(pitch) * level - np.cos(pitch) * up
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    x = np.cos(roll) * right + np.sin(roll) * down
    y = -np.sin(roll) * right + np.cos(roll) * down
    return Pose(np.asarray(eye, dtype=np.float64), np.stack([x, y, forward], axis=-1))


def directions(
    rotation: Points, intrinsics: Intrinsics, width: int, height: int, every: int = 1
) -> Floats:
    """(H, W, 3) ray directions in world axes whose length along the optical axis is 1.

    every: only each such pixel of each such row.
    """
    x = ((np.arange(0, width, every) - intrinsics.cx) / intrinsics.fx)[None, :, None]
    y = ((np.arange(0, height, every) - intrinsics.cy) / intrinsics.fy)[:, None, None]
    return np.asarray(x * rotation[:, 0] + y * rotation[:, 1] + rotation[:, 2], dtype=np.float32)


def rays_from(origins: Arrays, toward: Arrays) -> Floats:
    """(..., 6) rays from broadcast origins and directions, (..., 3) each."""
    shape = np.broadcast_shapes(origins.shape, toward.shape)
    rays = np.empty((*shape[:-1], 6), dtype=np.float32)
    rays[..., :3], rays[..., 3:] = origins, toward
    return rays


@dataclass(frozen=True, eq=False)
class Objects:
    """All objects of a location as one mesh; owner: (T,) object number of each triangle."""

    mesh: Mesh
    normals: Floats
    owner: npt.NDArray[np.uint16]
    scene: RaycastingScene


def objects_scene(mesh: Mesh, owner: npt.NDArray[np.uint16]) -> Objects:
    """Build the ray-casting scene of the objects."""
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    return Objects(mesh, normals, owner, raycasting_scene(mesh.vertices, mesh.triangles))


@dataclass(frozen=True, eq=False)
class Hits:
    """What the pixels of a view meet.

    depth_m: (H, W) along the optical axis, inf where there is nothing.
    points, normals: (H, W, 3).  ground: (H, W, 3) attributes of `Terrain.surface`, where ground.
    on_object: (H, W).  owner: (H, W) object number, where on an object.  colours: (H, W, 3) there.
    """

    depth_m: Floats
    points: Floats
    normals: Floats
    ground: Floats
    on_object: npt.NDArray[np.bool_]
    owner: npt.NDArray[np.uint16]
    colours: Floats


def view(
    eye: Points, toward: Floats, ground: GroundMesh, ground_scene: RaycastingScene, objects: Objects
) -> Hits:
    """Cast the (H, W, 3) directions of a view from `eye` on ground and objects."""
    rays = rays_from(eye, toward)
    on_ground, on_objects = cast(ground_scene, rays), cast(objects.scene, rays)
    nearer = on_objects["t_hit"] < on_ground["t_hit"]
    depth = np.minimum(on_objects["t_hit"], on_ground["t_hit"])
    reach = np.where(np.isfinite(depth), depth, np.float32(0))
    points = eye.astype(np.float32) + reach[..., None] * toward
    row, column = _grid_position(on_ground, ground.points.shape[1])
    normals = _sampled(ground.normals, column, row)
    attributes = _sampled(ground.attributes, column, row)
    owner = np.zeros(depth.shape, dtype=np.uint16)
    colours = np.zeros_like(points)
    hit = on_objects["primitive_ids"][nearer].astype(np.int64)
    owner[nearer] = objects.owner[hit]
    corners = objects.mesh.triangles[hit]
    uv = on_objects["primitive_uvs"][nearer]
    weights = (1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1])
    smooth = _blend(objects.normals, corners, weights)
    # Thin sheets and inner sides are seen from behind: turn their normals to the camera.
    away = (smooth * toward[nearer]).sum(axis=-1, keepdims=True) > 0
    facing = on_objects["primitive_normals"][nearer]
    behind = (facing * toward[nearer]).sum(axis=-1, keepdims=True) > 0
    normals[nearer] = np.where(away & behind, -smooth, smooth)
    colours[nearer] = _blend(objects.mesh.colours, corners, weights)
    return Hits(depth, points, normals, attributes, nearer, owner, colours)


def _sampled(picture: Floats, column: Floats, row: Floats) -> Floats:
    return np.asarray(cv2.remap(picture, column, row, cv2.INTER_LINEAR), dtype=np.float32)


def _blend(values: Floats, corners: Indices, weights: tuple[Floats, Floats, Floats]) -> Floats:
    """Values at points inside triangles, from those at the corners."""
    parts = [values[corners[:, k]] * weights[k][:, None] for k in range(3)]
    return np.asarray(parts[0] + parts[1] + parts[2])


def _grid_position(answer: dict[str, Any], columns: int) -> tuple[Floats, Floats]:
    """Row and column, with fractions, where rays met a mesh with `grid_triangles`."""
    triangle = answer["primitive_ids"].astype(np.int64)
    cell, second = triangle >> 1, (triangle & 1).astype(bool)
    u, v = answer["primitive_uvs"][..., 0], answer["primitive_uvs"][..., 1]
    row = (cell // (columns - 1)).astype(np.float32) + np.where(second, u, u + v)
    column = (cell % (columns - 1)).astype(np.float32) + np.where(second, u + v, v)
    return np.asarray(row, dtype=np.float32), np.asarray(column, dtype=np.float32)
