"""Meshes and pictures of a .blend, whose scripts are never run.

All of this runs in the process that `mesh_parts` reads files in: one Blender, one open file.
"""

from __future__ import annotations

import importlib
import tempfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from ..small_files import one_line
from .painted import Part, linear, painted
from .seabed.meshes import Mesh, join

_SAMPLES = 8
_SENSOR_MM = 36.0


@lru_cache(maxsize=1)
def _opened(path: Path) -> Any:
    """Blender with the file open.  Raises FactoryError."""
    try:
        bpy: Any = importlib.import_module("bpy")
    except (ImportError, OSError) as error:
        raise FactoryError(
            f"needs the module bpy ({one_line(error)}): pip install 'simnfnd[blender]', "
            "or export a .glb"
        ) from error
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise FactoryError(f"no .blend file that Blender opens ({one_line(error)})") from error
    for image in bpy.data.images:
        linked = image.source == "FILE" and image.filepath and not image.packed_file
        if linked and not Path(bpy.path.abspath(image.filepath)).is_file():
            name = Path(image.filepath.replace("\\", "/")).name
            raise FactoryError(f"its texture {name} is missing; pack it (File, External Data)")
    return bpy


def parts(path: Path) -> list[Part]:
    """The meshes of a file as Blender shows them, a part for each object."""
    bpy, found = _opened(path.resolve()), []
    graph = bpy.context.evaluated_depsgraph_get()
    for instance in graph.object_instances:
        shown = instance.object
        if shown.type not in ("MESH", "CURVE", "SURFACE", "FONT", "META"):
            continue
        made = shown.to_mesh()
        if made is not None and len(made.polygons):
            whole = _whole(made, np.array(instance.matrix_world, np.float64))
            found.append(Part(shown.name, whole))
        shown.to_mesh_clear()
    return found


def _whole(made: Any, place: npt.NDArray[np.float64]) -> Mesh:
    made.calc_loop_triangles()
    points = _array(made.vertices, "co", 3, np.float32)
    points = (points.astype(np.float64) @ place[:3, :3].T + place[:3, 3]).astype(np.float32)
    triangles = _array(made.loop_triangles, "vertices", 3, np.int32)
    if np.linalg.det(place[:3, :3]) < 0:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    slots = _array(made.loop_triangles, "material_index", 1, np.int32).ravel()
    pieces = []
    for slot in np.unique(slots):
        material = made.materials[slot] if slot < len(made.materials) else None
        colour, image = _surface(material)
        some = triangles[slots == slot]
        if image is not None and made.uv_layers.active is not None:
            loops = _array(made.loop_triangles, "loops", 3, np.int32)[slots == slot]
            places = _array(made.uv_layers.active.uv, "vector", 2, np.float32)[loops]
            pieces.append(painted(points[some], places * (1, -1) + (0, 1), image))
        else:
            used, order = np.unique(some, return_inverse=True)
            colours = np.tile(np.array(colour, np.float32), (len(used), 1))
            faces = order.reshape(-1, 3).astype(np.int32)
            pieces.append(Mesh(points[used], colours, faces))
    return join(pieces)


def _array(of: Any, name: str, width: int, dtype: Any) -> npt.NDArray[Any]:
    values = np.empty(len(of) * width, dtype)
    of.foreach_get(name, values)
    return values.reshape(-1, width)


def _surface(material: Any) -> tuple[Sequence[float], npt.NDArray[np.float32] | None]:
    """Base colour of a material, and the albedo (H, W, 3) of its texture where it has one."""
    if material is None:
        return (0.5, 0.5, 0.5), None
    nodes = material.node_tree.nodes if material.node_tree is not None else ()
    for node in nodes:
        if node.type != "BSDF_PRINCIPLED":
            continue
        socket = node.inputs["Base Color"]
        source = socket.links[0].from_node if socket.is_linked else None
        if source is not None and source.type == "TEX_IMAGE" and source.image is not None:
            width, height = source.image.size
            pixels = np.empty(width * height * 4, np.float32)
            source.image.pixels.foreach_get(pixels)
            top_first = pixels.reshape(height, width, 4)[::-1, :, :3]
            return (1, 1, 1), linear(top_first * 255)
        return tuple(socket.default_value)[:3], None
    return tuple(material.diffuse_color)[:3], None


def photograph(
    path: Path, world_from_camera: list[list[float]], lens: list[float], width: int, height: int
) -> bytes:
    """PNG of what a camera sees, by Cycles, with the file's own materials and lights.

    world_from_camera: (4, 4) in units of the file.  lens: fx, fy, cx, cy in pixels.
    """
    bpy = _opened(path.resolve())
    import mathutils  # comes with Blender

    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device, cycles.samples, cycles.seed = "CYCLES", "CPU", _SAMPLES, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    render.threads_mode, render.threads = "FIXED", 1
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    scene.view_settings.view_transform = "Standard"
    camera = bpy.data.objects.get("simnfnd camera")
    if camera is None:
        data = bpy.data.cameras.new("simnfnd camera")
        camera = bpy.data.objects.new("simnfnd camera", data)
        scene.collection.objects.link(camera)
        if not any(one.type == "LIGHT" for one in scene.objects):
            # A lamp on the camera, as a vehicle has one.
            lamp = bpy.data.objects.new("simnfnd lamp", bpy.data.lights.new("lamp", "SUN"))
            lamp.data.energy, lamp.parent = 3.0, camera
            scene.collection.objects.link(lamp)
    fx, fy, cx, cy = lens
    camera.data.sensor_fit, camera.data.sensor_width = "HORIZONTAL", _SENSOR_MM
    camera.data.lens = fx * _SENSOR_MM / width
    camera.data.clip_start, camera.data.clip_end = 1e-3, 1e6
    camera.data.shift_x = (width / 2 - (cx + 0.5)) / width
    camera.data.shift_y = ((cy + 0.5) - height / 2) / width * fx / fy
    camera.matrix_world = mathutils.Matrix((np.array(world_from_camera) * (1, -1, -1, 1)).tolist())
    scene.camera = camera
    with tempfile.TemporaryDirectory() as folder:
        render.filepath = f"{folder}/seen.png"
        bpy.ops.render.render(write_still=True)
        return Path(render.filepath).read_bytes()
