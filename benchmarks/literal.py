"""The paper's recipe taken to the letter, with the tools it names, to measure ours against.

Open3D cloud, PLY file out, Blender import, Cycles with the default number of bounces and 16
samples, PNG file out, noise points, matplotlib scatter images.  Written from the paper's text
(sections 3.1 to 3.3 and 5.2); what it leaves open is taken as these tools have it by default.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simnfnd.factory.common.array_types import Float64s
from simnfnd.factory.simulation.frames.frame import Frame

SAMPLES = 16
IMAGE_PX = 512


class LiteralRecipe:
    """Makes a pair of PNG images of a frame; keeps Blender open between frames."""

    def __init__(self, folder: Path) -> None:
        import bpy
        import matplotlib
        import open3d

        matplotlib.use("Agg")
        self.bpy = bpy
        self.open3d = open3d
        self.folder = folder

    def pair(self, frame: Frame) -> list[Path]:
        """The noisy and the clean image of `frame`, as files."""
        points_m = self._save_cloud(frame)
        self._fill_scene(frame)
        grey = self._render(frame)
        rows, columns = np.nonzero(frame.valid)
        strength = grey[rows, columns]
        rng = np.random.default_rng(0)
        noisy_m, noisy_strength = _with_noise(points_m, strength, rng)
        return [
            self._scatter("clean", points_m, strength),
            self._scatter("noisy", noisy_m, noisy_strength),
        ]

    def _save_cloud(self, frame: Frame) -> Float64s:
        geometry = self.open3d.geometry
        height, width = frame.depth_m.shape
        k = frame.intrinsics
        rgbd = geometry.RGBDImage.create_from_color_and_depth(
            geometry.Image(np.ascontiguousarray(frame.rgb)),
            geometry.Image(frame.depth_m),
            depth_scale=1.0,
            depth_trunc=1e3,
            convert_rgb_to_intensity=False,
        )
        camera = self.open3d.camera.PinholeCameraIntrinsic(width, height, k.fx, k.fy, k.cx, k.cy)
        cloud = geometry.PointCloud.create_from_rgbd_image(rgbd, camera)
        self.open3d.io.write_point_cloud(self.folder / "cloud.ply", cloud)
        return np.asarray(cloud.points)

    def _fill_scene(self, frame: Frame) -> None:
        bpy = self.bpy
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.ply_import(filepath=str(self.folder / "cloud.ply"), import_colors="SRGB")
        cloud = bpy.context.selected_objects[0]
        cloud.matrix_world = ((1, 0, 0, 0), (0, -1, 0, 0), (0, 0, -1, 0), (0, 0, 0, 1))
        material = bpy.data.materials.new("colours")
        material.use_nodes = True
        nodes = material.node_tree.nodes
        links = material.node_tree.links
        colour = nodes.new("ShaderNodeAttribute")
        colour.attribute_name = cloud.data.color_attributes[0].name
        links.new(colour.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
        radius_m = float(np.median(frame.depth_m[frame.valid])) / frame.intrinsics.fx
        tree = _points_as_spheres(bpy, radius_m, material)
        cloud.modifiers.new("spheres", "NODES").node_group = tree
        scene = bpy.context.scene
        light = bpy.data.objects.new("sonar", bpy.data.lights.new("sonar", "POINT"))
        light.data.energy = 500
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        height, width = frame.depth_m.shape
        camera.data.lens = frame.intrinsics.fx * camera.data.sensor_width / width
        scene.collection.objects.link(light)
        scene.collection.objects.link(camera)
        scene.camera = camera
        scene.render.resolution_x = width
        scene.render.resolution_y = height

    def _render(self, frame: Frame) -> Float64s:
        import cv2

        scene = self.bpy.context.scene
        scene.render.engine = "CYCLES"
        scene.cycles.device = "CPU"
        scene.cycles.samples = SAMPLES
        scene.cycles.use_denoising = False
        target = self.folder / "render.png"
        scene.render.filepath = str(target)
        self.bpy.ops.render.render(write_still=True)
        image = cv2.imread(str(target), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        assert image.shape == frame.depth_m.shape
        return np.asarray(image / 255.0)

    def _scatter(self, name: str, points_m: Float64s, strength: Float64s) -> Path:
        import matplotlib.pyplot as plt

        figure = plt.figure(figsize=(IMAGE_PX / 100, IMAGE_PX / 100), dpi=100)
        axes = figure.add_axes((0, 0, 1, 1), facecolor="black")
        axes.scatter(points_m[:, 0], points_m[:, 2], c=strength, cmap="gray", s=1, linewidths=0)
        axes.set_aspect("equal")
        target = self.folder / f"{name}.png"
        figure.savefig(target, facecolor="black")
        plt.close(figure)
        return target


def _points_as_spheres(bpy: Any, radius_m: float, material: Any) -> Any:
    tree = bpy.data.node_groups.new("spheres", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    start = tree.nodes.new("NodeGroupInput")
    end = tree.nodes.new("NodeGroupOutput")
    points = tree.nodes.new("GeometryNodeMeshToPoints")
    points.inputs["Radius"].default_value = radius_m
    paint = tree.nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = material
    tree.links.new(start.outputs[0], points.inputs["Mesh"])
    tree.links.new(points.outputs["Points"], paint.inputs["Geometry"])
    tree.links.new(paint.outputs["Geometry"], end.inputs[0])
    return tree


def _with_noise(
    points_m: Float64s, strength: Float64s, rng: np.random.Generator
) -> tuple[Float64s, Float64s]:
    """Section 3.3 with mid-range numbers: spreading, background, a ghost and a spoke; resampled."""
    range_m = np.linalg.norm(points_m, axis=1)
    spread = points_m + np.abs(rng.standard_normal(points_m.shape)) * (0.02 * range_m[:, None])
    count = len(points_m) // 20
    far_m = range_m.max()
    half_rad = np.deg2rad(22.5)
    azimuth = [
        rng.uniform(-half_rad, half_rad, count),
        rng.normal(0.1, 0.02, count),
        rng.normal(-0.2, 0.004, count),
    ]
    distance = [
        rng.uniform(0, far_m, count),
        rng.normal(far_m / 2, 0.2, count),
        rng.uniform(0, far_m, count),
    ]
    theta = np.concatenate(azimuth)
    r = np.concatenate(distance)
    added = np.stack([r * np.sin(theta), np.zeros_like(r), r * np.cos(theta)], axis=1)
    cloud = np.concatenate([spread, added])
    level = np.concatenate([strength, rng.random(len(r))])
    is_sampled = rng.random(len(cloud)) < 0.5
    return cloud[is_sampled], level[is_sampled]
