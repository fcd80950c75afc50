"""The renderers: light in closed form, with Embree's shadows (through Open3D), by Blender's Cycles.

One sample of Cycles is not an estimate: a point light has one direction, and the ray goes through
the pixel's centre.

bpy is one Blender for the whole process.  All that is made here lives in a scene of its own, so
nothing else in that Blender is touched.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Array, Bools, Float32s, Float64s
from ...common.errors import FactoryError
from ...common.quiet import quiet
from ...common.small_files import one_line
from ..frames.frame import Frame, Intrinsics
from .base import Mount, Rendered, RenderSettings
from .bounce import trace_bounces
from .ray_caster import RayCaster
from .surface import SHADOW_BIAS, Pixels, Surface, pixels_of, surface_mesh


def _loaded(module: str, kind: str) -> Any:
    try:
        return import_module(module)
    except (ImportError, OSError) as error:
        raise FactoryError(
            f"render.kind={kind} needs the module {module} ({one_line(error)}): make setup "
            "installs what it needs, or choose render=analytic"
        ) from error


class ClosedFormRenderer:
    """Shades the normals of the pixel grid; with Embree a ray from each pixel to the sonar.

    Without rays nothing casts a shadow: exact when the sonar is at the camera, where all that the
    camera sees is insonified; with any other mount it lights what the sonar cannot see.
    """

    def __init__(self, settings: RenderSettings) -> None:
        """Raises FactoryError when Open3D is asked for and not there: half a second, 100 MB."""
        self._settings = settings
        self._open3d: Any = _loaded("open3d", "embree") if settings.kind == "embree" else None

    def render(self, frame: Frame, mount: Mount) -> Rendered:
        """Render one frame; see `simnfnd.factory.simulation.render.base.Renderer`."""
        pixels = pixels_of(frame, self._settings)
        sonar_m = mount.position_camera_m()
        radiance = pixels.radiance(sonar_m)
        if self._open3d and not mount.colocated and pixels.mask.any():
            radiance[self._shadow(pixels, sonar_m)] = 0
        bounces = None
        if self._open3d and self._settings.bounces:
            bounces = trace_bounces(self._open3d, frame, self._settings, radiance, sonar_m)
        return Rendered(radiance, pixels.mask, bounces)

    def _shadow(self, pixels: Pixels, sonar_m: Float64s) -> Bools:
        """(H, W) bool: surface pixels that the mesh hides from the sonar."""
        caster = RayCaster(self._open3d, pixels)
        surface = caster.surface
        shadow = np.zeros(surface.mask.shape, np.bool_)
        points_m = surface.points_m[surface.mask]
        shadow[surface.mask] = caster.hidden(points_m, sonar_m.astype(np.float32))
        return shadow


class CyclesRenderer:
    """Keeps a Blender scene and puts one frame after another into it.

    With the sonar at the camera, where nothing casts a shadow, a sphere for every second pixel
    (half the time of a mesh), and closed form between them; else `surface_mesh`, with a vertex for
    each pixel.  Both are shaded with the pixels' normals.
    """

    def __init__(self, settings: RenderSettings) -> None:
        """Raises FactoryError when bpy cannot be loaded: a second and 260 MB."""
        self._settings = settings
        # It may greet the world (a warning where /etc/mtab is missing): stdout is the user's.
        with _one_core(), quiet(1):
            self._bpy = _loaded("bpy", "cycles")
        self._scene, self._camera, self._light = _stage(self._bpy)
        self._mesh = self._new_object("surface")
        self._mesh.data.materials.append(_material(self._bpy, normals=False))
        self._caster = self._new_object("shadow caster", self._mesh.data)
        self._caster.scale = (1 + SHADOW_BIAS,) * 3
        self._mesh.visible_shadow = False
        for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter"):
            setattr(self._caster, f"visible_{ray}", False)
        self._points = self._new_object("points")
        self._points.data.materials.append(_material(self._bpy, normals=True))
        _turn_into_spheres(self._bpy, self._points)
        for shown in (self._mesh, self._points):
            # Cycles softens the shading of coarse meshes; ours is a pixel fine.
            shown.shadow_terminator_geometry_offset = 0
            shown.shadow_terminator_shading_offset = 0

    def render(self, frame: Frame, mount: Mount) -> Rendered:
        """Render one frame; see `simnfnd.factory.simulation.render.base.Renderer`."""
        as_points = mount.colocated
        pixels = pixels_of(frame, self._settings, stride=2 if as_points else 1)
        surface = pixels.surface()
        if not surface.mask.any():
            return Rendered(np.zeros(pixels.mask.shape, np.float32), pixels.mask)
        _aim(self._scene, self._camera.data, surface.intrinsics, *surface.mask.shape)
        self._light.location = mount.position_camera_m()
        # What the camera sees, a sonar at its place insonifies: no shadow rays, no rounding.
        self._light.data.use_shadow = not as_points
        self._points.hide_render = not as_points
        self._mesh.hide_render = self._caster.hide_render = as_points
        mesh = (self._points if as_points else self._mesh).data
        mesh.clear_geometry()
        if as_points:
            _fill_points(mesh, surface)
        else:
            _fill_mesh(mesh, pixels, surface)
        mesh.update_tag()
        image = _pixels(self._bpy, self._scene)
        mesh.clear_geometry()
        hit = surface.mask & (image[..., 3] > 0.5)
        if as_points:
            radiance = pixels.radiance(mount.position_camera_m())
            return Rendered(pixels.apply(radiance, image[..., 0], hit), pixels.mask)
        return Rendered(np.where(hit, image[..., 0], np.float32(0)), hit)

    def _new_object(self, name: str, mesh: Any = None) -> Any:
        new = self._bpy.data.objects.new(name, mesh or self._bpy.data.meshes.new(name))
        self._scene.collection.objects.link(new)
        return new


def _fill_mesh(mesh: Any, pixels: Pixels, surface: Surface) -> None:
    grid = surface_mesh(pixels, surface)
    mesh.vertices.add(len(grid.vertices_m))
    mesh.loops.add(grid.triangles.size)
    mesh.polygons.add(len(grid.triangles))
    # Straight into the attributes: by way of vertices.co and loops.vertex_index it takes 4 x the
    # time.
    _set(mesh, "position", grid.vertices_m)
    _set(mesh, ".corner_vert", grid.triangles)
    mesh.polygons.foreach_set("loop_start", np.arange(0, grid.triangles.size, 3, dtype=np.int32))
    _set(mesh, _ALBEDO, surface.albedo.ravel()[grid.pixel])
    # The name by which Blender takes a vertex attribute as the mesh's own shading normals.
    _set(mesh, "custom_normal", surface.normals.reshape(-1, 3)[grid.pixel])


def _fill_points(mesh: Any, surface: Surface) -> None:
    # Whole rows of three by their places: a third of the time of a mask.
    chosen = np.flatnonzero(surface.mask)
    points_m = surface.points_m.reshape(-1, 3).take(chosen, axis=0)
    camera = surface.intrinsics
    radius_m = points_m[:, 2] * np.float32(_RADIUS_PX / max(camera.fx, camera.fy))
    # The ray through the centre meets a sphere's front: that is what must lie at the point.
    x, y, z = points_m.T
    set_back = 1 + radius_m / np.sqrt(x * x + y * y + z * z)
    mesh.vertices.add(len(points_m))
    _set(mesh, "position", points_m * set_back[:, None])
    _set(mesh, _RADIUS, radius_m)
    _set(mesh, _ALBEDO, surface.albedo.ravel()[chosen])
    _set(mesh, _NORMAL, surface.normals.reshape(-1, 3).take(chosen, axis=0))


# Far more than the camera's looking past a pixel's centre, and so small that the spheres' boxes
# hardly overlap: a tenth less time than with half a pixel.
_RADIUS_PX = 0.2

_ALBEDO = "albedo"
_NORMAL = "surface_normal"
_RADIUS = "sphere_radius"


def _set(mesh: Any, name: str, values: Array) -> None:
    """Write a mesh attribute, as a new one on the vertices where Blender has none of that name."""
    field = "vector" if values.ndim == 2 and values.dtype == np.float32 else "value"
    kind = "FLOAT_VECTOR" if field == "vector" else "FLOAT"
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(field, np.ascontiguousarray(values).ravel())


def _material(bpy: Any, normals: bool) -> Any:
    """A Lambert surface with the albedo of the vertices, and their normals where asked."""
    material = bpy.data.materials.new("sonar")
    nodes = material.node_tree.nodes
    links = material.node_tree.links
    nodes.clear()
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    output = nodes.new("ShaderNodeOutputMaterial")
    diffuse.inputs["Roughness"].default_value = 0
    links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
    wired = [(_ALBEDO, "Fac", "Color"), (_NORMAL, "Vector", "Normal")]
    for name, source, target in wired if normals else wired[:1]:
        attribute = nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = name
        links.new(attribute.outputs[source], diffuse.inputs[target])
    return material


def _turn_into_spheres(bpy: Any, shown: Any) -> None:
    """Geometry nodes: vertices -> points with their own radius -> the object's material."""
    tree = bpy.data.node_groups.new("spheres", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeMeshToPoints", "GeometryNodeSetMaterial")
    start, points, paint = map(tree.nodes.new, kinds)
    end, radius = map(tree.nodes.new, ("NodeGroupOutput", "GeometryNodeInputNamedAttribute"))
    radius.data_type = "FLOAT"
    radius.inputs["Name"].default_value = _RADIUS
    paint.inputs["Material"].default_value = shown.data.materials[0]
    tree.links.new(start.outputs[0], points.inputs["Mesh"])
    tree.links.new(radius.outputs["Attribute"], points.inputs["Radius"])
    tree.links.new(points.outputs["Points"], paint.inputs["Geometry"])
    tree.links.new(paint.outputs["Geometry"], end.inputs[0])
    shown.modifiers.new("spheres", "NODES").node_group = tree


_SENSOR_WIDTH_MM = 36.0

# Pixel centres are vertices of the mesh, and a ray through the very meeting point of six triangles
# can miss them all.  So the camera looks past them by a little more than the rounding of 32-bit
# coordinates (1e-4 of a pixel), in a direction along none of the mesh's edges.
_OFF_VERTEX_PX = (2e-3, 1e-3)

# A point light of P watts has the intensity P / (4 pi), and a Lambert surface returns albedo / pi
# of it, so this power makes a pixel albedo * cos / range^2.
_LIGHT_POWER_W = 4 * np.pi**2


@contextmanager
def _one_core() -> Iterator[None]:
    """Let libraries loaded meanwhile believe that the machine has one core.

    Blender counts cores when it starts.  With more than one, a second thread of its spins in
    sched_yield all through a render, whatever the scene's thread count: twice the CPU time for
    nothing.  Afterwards every thread may run anywhere again.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):  # threads end as they like
                os.sched_setaffinity(int(thread), cores)


class _Stage(NamedTuple):
    """Blender's objects for a scene, its camera, and the sonar as a light."""

    scene: Any
    camera: Any
    light: Any


def _stage(bpy: Any) -> _Stage:
    """A scene that renders direct light exactly at pixel centres, the same bytes every time.

    Its camera lies at the origin and looks along +z, with y down.  World axes are therefore the
    camera axes of `simulation.frames.frame`.
    """
    scene = bpy.data.scenes.new("sonar")
    render = scene.render
    cycles = scene.cycles
    render.engine = "CYCLES"
    render.resolution_percentage = 100
    render.film_transparent = True  # alpha becomes the mask of what the camera's rays hit
    render.threads_mode = "FIXED"
    render.threads = 1
    render.use_compositing = render.use_sequencer = False

    cycles.device = "CPU"
    cycles.samples = 1
    cycles.max_bounces = cycles.diffuse_bounces = 0
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
    cycles.light_sampling_threshold = 0
    cycles.use_light_tree = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.sampling_pattern = "TABULATED_SOBOL"
    cycles.seed = 0
    cycles.debug_bvh_type = "DYNAMIC_BVH"
    # Further samples would be spread over the pixel, where neighbours' edges are; keep them at its
    # centre (a box filter is always a pixel wide).
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.filter_width = 0.01

    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.matrix_world = ((1, 0, 0, 0), (0, -1, 0, 0), (0, 0, -1, 0), (0, 0, 0, 1))
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.sensor_width = _SENSOR_WIDTH_MM
    camera.data.clip_start = 1e-4
    camera.data.clip_end = 1e6
    scene.collection.objects.link(camera)
    scene.camera = camera

    light = bpy.data.objects.new("sonar", bpy.data.lights.new("sonar", "POINT"))
    light.data.energy = _LIGHT_POWER_W
    light.data.shadow_soft_size = 0
    light.data.use_soft_falloff = False
    scene.collection.objects.link(light)
    return _Stage(scene, camera, light)


def _aim(scene: Any, lens: Any, intrinsics: Intrinsics, height: int, width: int) -> None:
    """Give the camera of a scene these intrinsics and image size, pixel for pixel."""
    render = scene.render
    render.resolution_x = width
    render.resolution_y = height
    # Blender has one focal length; unequal ones are pixels that are not square.
    render.pixel_aspect_x = max(1.0, intrinsics.fy / intrinsics.fx)
    render.pixel_aspect_y = max(1.0, intrinsics.fx / intrinsics.fy)
    lens.lens = intrinsics.fx * _SENSOR_WIDTH_MM / width
    across, down = _OFF_VERTEX_PX
    lens.shift_x = (width / 2 - (intrinsics.cx + 0.5) + across) / width
    rise = (intrinsics.cy + 0.5) - height / 2 + down
    lens.shift_y = rise / width * intrinsics.fx / intrinsics.fy


def _pixels(bpy: Any, scene: Any) -> Float32s:
    """(H, W, 4) float32 linear RGBA of a scene, premultiplied, top row first.

    Taken as soon as Cycles has it: later on, without a window, it cannot be read.
    """
    from cycles import CyclesRender

    taken: list[Float32s] = []
    original: Callable[..., None] = CyclesRender.render

    def render_and_take(self: Any, depsgraph: Any) -> None:
        original(self, depsgraph)
        result = self.get_result()
        pixels = np.empty((result.resolution_y, result.resolution_x, 4), np.float32)
        result.layers[0].passes["Combined"].rect.foreach_get(pixels.ravel())
        taken.append(pixels[::-1])

    CyclesRender.render = render_and_take
    try:
        bpy.ops.render.render(scene=scene.name)
    finally:
        CyclesRender.render = original
    return taken[0]
