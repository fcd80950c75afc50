"""Rendering with Blender's Cycles: a point light at the sonar, seen by the RGBD camera.

One sample without bounces is not an estimate: a point light has one direction, and the ray goes
through the pixel's centre.  With bounces, sound that was scattered before adds to each pixel (also
in shadow), as noisily as `samples` allow.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..frame import Frame
from . import blender
from .base import Rendered, RenderSettings
from .mesh import SHADOW_BIAS, surface_mesh
from .mount import Mount
from .surface import Surface, pixels_of


class CyclesRenderer:
    """Keeps a Blender scene and puts one frame after another into it.

    geometry mesh: `surface_mesh`, shaded with the pixels' normals.  geometry points: a sphere per
    pixel, shaded likewise; right with the sonar at the camera, but neither a surface that casts
    whole shadows nor one that sound bounces off.
    """

    def __init__(self, settings: RenderSettings) -> None:
        """Raises FactoryError when bpy is not there."""
        self._settings = settings
        self._bpy = blender.import_bpy()
        self._stage = blender.make_stage(self._bpy, settings)
        self._mesh = self._new_object("surface")
        self._mesh.data.materials.append(_material(self._bpy, normal_attribute=None))
        self._caster = self._new_object("shadow caster", self._mesh.data)
        self._caster.scale = (1 + SHADOW_BIAS,) * 3
        self._mesh.visible_shadow = False
        for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter"):
            setattr(self._caster, f"visible_{ray}", False)
        self._points = self._new_object("points")
        self._points.data.materials.append(_material(self._bpy, normal_attribute=_NORMAL))
        _turn_into_spheres(self._bpy, self._points)
        for shown in (self._mesh, self._points):
            _hide_from_terminator(shown)

    def render(self, frame: Frame, mount: Mount) -> Rendered:
        """Render one frame; see `simnfnd.factory.render.base.Renderer`."""
        pixels = pixels_of(frame, self._settings, self._settings.stride_at(mount))
        surface = pixels.surface()
        if not surface.mask.any():
            return Rendered(np.zeros(pixels.mask.shape, np.float32), pixels.mask)
        blender.aim(self._stage, surface.intrinsics, *surface.mask.shape)
        light = self._stage.light
        light.location = mount.position_camera_m()
        # What the camera sees, a sonar at its place insonifies: no shadow rays, no rounding.
        light.data.use_shadow = not mount.colocated
        as_points = self._settings.as_points(mount)
        self._points.hide_render = not as_points
        self._mesh.hide_render = as_points
        self._caster.hide_render = as_points or mount.colocated
        if as_points:
            self._fill_points(surface)
        else:
            self._fill_mesh(surface, pixels.traced_edge_ratio)
        picture = blender.render_pixels(self._stage)
        (self._points if as_points else self._mesh).data.clear_geometry()
        hit = surface.mask & (picture[..., 3] > 0.5)
        if pixels.stride == 1:
            return Rendered(np.where(hit, picture[..., 0], np.float32(0)), hit)
        radiance = pixels.radiance(mount.position_camera_m())
        return Rendered(pixels.apply(radiance, picture[..., 0], hit), pixels.mask)

    def _new_object(self, name: str, mesh: Any = None) -> Any:
        new = self._bpy.data.objects.new(name, mesh or self._bpy.data.meshes.new(name))
        self._stage.scene.collection.objects.link(new)
        return new

    def _fill_mesh(self, surface: Surface, edge_ratio: float) -> None:
        grid = surface_mesh(surface.points_m, surface.normals, surface.intrinsics, edge_ratio)
        mesh = self._mesh.data
        mesh.clear_geometry()
        mesh.vertices.add(len(grid.vertices_m))
        mesh.loops.add(grid.triangles.size)
        mesh.polygons.add(len(grid.triangles))
        # Straight into the attributes: by way of vertices.co and loops.vertex_index it takes 4 x
        # the time.
        _set(mesh, "position", grid.vertices_m)
        _set(mesh, ".corner_vert", grid.triangles)
        starts = np.arange(0, grid.triangles.size, 3, dtype=np.int32)
        mesh.polygons.foreach_set("loop_start", starts)
        _set(mesh, _ALBEDO, surface.albedo.ravel()[grid.pixel])
        # The name by which Blender takes a vertex attribute as the mesh's own shading normals.
        _set(mesh, "custom_normal", surface.normals.reshape(-1, 3)[grid.pixel])
        mesh.update_tag()

    def _fill_points(self, surface: Surface) -> None:
        # Whole rows of three by their places: a third of the time of a mask.
        chosen = np.flatnonzero(surface.mask)
        points_m = surface.points_m.reshape(-1, 3).take(chosen, axis=0)
        camera = surface.intrinsics
        radius_m = points_m[:, 2] * np.float32(_RADIUS_PX / max(camera.fx, camera.fy))
        # The ray through the centre meets a sphere's front: that is what must lie at the point.
        x, y, z = points_m.T
        set_back = 1 + radius_m / np.sqrt(x * x + y * y + z * z)
        mesh = self._points.data
        mesh.clear_geometry()
        mesh.vertices.add(len(points_m))
        _set(mesh, "position", points_m * set_back[:, None])
        _set(mesh, _RADIUS, radius_m)
        _set(mesh, _ALBEDO, surface.albedo.ravel()[chosen])
        _set(mesh, _NORMAL, surface.normals.reshape(-1, 3).take(chosen, axis=0))
        mesh.update_tag()


# Far more than the camera's looking past a pixel's centre, and so small that the spheres' boxes
# hardly overlap: a tenth less time than with half a pixel.
_RADIUS_PX = 0.2

_ALBEDO, _NORMAL, _RADIUS = "albedo", "surface_normal", "sphere_radius"


def _set(mesh: Any, name: str, values: npt.NDArray[Any]) -> None:
    """Write a mesh attribute, as a new one on the vertices where Blender has none of that name."""
    field = "vector" if values.ndim == 2 and values.dtype == np.float32 else "value"
    kind = "FLOAT_VECTOR" if field == "vector" else "FLOAT"
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(field, np.ascontiguousarray(values).ravel())


def _hide_from_terminator(shown: Any) -> None:
    """Take back what Cycles does to soften the shading of coarse meshes; ours is a pixel fine."""
    shown.shadow_terminator_geometry_offset = 0
    shown.shadow_terminator_shading_offset = 0


def _material(bpy: Any, normal_attribute: str | None) -> Any:
    """A Lambert surface with the albedo of the vertices, and their normals where named."""
    material = bpy.data.materials.new("sonar")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Roughness"].default_value = 0
    albedo = nodes.new("ShaderNodeAttribute")
    albedo.attribute_name = _ALBEDO
    links.new(albedo.outputs["Fac"], diffuse.inputs["Color"])
    if normal_attribute is not None:
        normal = nodes.new("ShaderNodeAttribute")
        normal.attribute_name = normal_attribute
        links.new(normal.outputs["Vector"], diffuse.inputs["Normal"])
    output = nodes.new("ShaderNodeOutputMaterial")
    links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    return material


def _turn_into_spheres(bpy: Any, shown: Any) -> None:
    """Geometry nodes: vertices -> points with their own radius -> the object's material."""
    tree = bpy.data.node_groups.new("spheres", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes, links = tree.nodes, tree.links
    start, end = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    radius = nodes.new("GeometryNodeInputNamedAttribute")
    radius.data_type = "FLOAT"
    radius.inputs["Name"].default_value = _RADIUS
    points = nodes.new("GeometryNodeMeshToPoints")
    paint = nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = shown.data.materials[0]
    links.new(start.outputs[0], points.inputs["Mesh"])
    links.new(radius.outputs["Attribute"], points.inputs["Radius"])
    links.new(points.outputs["Points"], paint.inputs["Geometry"])
    links.new(paint.outputs["Geometry"], end.inputs[0])
    shown.modifiers.new("spheres", "NODES").node_group = tree
