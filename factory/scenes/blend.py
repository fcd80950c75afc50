"""Meshes and pictures of a .blend, whose scripts are never run.

All of this runs in the process that `mesh_parts` reads files in: one Blender, one open file.
"""

from __future__ import annotations

import importlib
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FactoryError
from ..small_files import one_line

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


def as_gltf(path: Path, made: Path) -> None:
    """Write the meshes of a file as Blender shows them."""
    _opened(path.resolve()).ops.export_scene.gltf(
        filepath=str(made), export_apply=True, use_visible=True, export_animations=False,
        export_skins=False, export_morph=False, export_normals=False,
    )  # fmt: skip


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
