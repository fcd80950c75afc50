"""What Blender opens, in the isolated process: exported as .glb; a .blend is rendered, too.

One Blender has one file open.  Its scripts are never run, images and libraries that it names must
lie beside it, and of its output settings none is kept.
"""

from __future__ import annotations

import importlib
import tempfile
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import FactoryError
from ...common.files import real_path
from ...common.small_files import one_line

BLENDER_SUFFIXES = (".blend", ".fbx", ".usd", ".usda", ".usdc", ".usdz")
"""Files that Blender opens, or imports into an empty scene."""
_SAMPLES = 8


@dataclass
class Opened:
    """Blender with a file open.  linked: files that it names.  camera: ours, once there is one."""

    bpy: Any
    linked: list[Path]
    camera: Any = None


def linked_by_blend(path: Path) -> list[Path]:
    """Libraries, textures and other files that a file of Blender's names.  Raises FactoryError."""
    return _opened(real_path(path)).linked


def export_blend(path: Path, target: Path) -> None:
    """Write what the active scene shows as a .glb.  Raises FactoryError."""
    _opened(real_path(path)).bpy.ops.export_scene.gltf(
        filepath=str(target), export_apply=True, use_visible=True, use_renderable=True,
        use_active_scene=True, export_animations=False, export_skins=False, export_morph=False,
        export_normals=False,
    )  # fmt: skip


def _opened(path: Path) -> Opened:
    """Blender with the file open and its output settings reset.  Raises FactoryError."""
    return _opened_once(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=1)
def _opened_once(path: Path, _modified_ns: int) -> Opened:
    """Open a file in Blender's module, without its scripts, and hide what exporters leave out.

    Raises FactoryError without that module, and for a file that Blender does not open.
    """
    try:
        bpy: Any = importlib.import_module("bpy")
    except (ImportError, OSError) as error:
        raise FactoryError(
            f"needs the module bpy ({one_line(error)}): pip install 'simnfnd[blender]', "
            "or export a .glb"
        ) from error
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    suffix = path.suffix.lower()
    try:
        if suffix == ".blend":
            bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
        else:
            bpy.ops.wm.read_factory_settings(use_empty=True)
            importer = bpy.ops.import_scene.fbx if suffix == ".fbx" else bpy.ops.wm.usd_import
            importer(filepath=str(path))
    except RuntimeError as error:
        raise FactoryError(f"no {suffix} file that Blender opens ({one_line(error)})") from error

    linked = _linked_files(bpy, path.parent)
    for scene_object in bpy.context.scene.objects:
        # What the exporter leaves out must not be in the images either.
        if not scene_object.visible_get():
            scene_object.hide_render = True
    _reset_output(bpy.context)
    return Opened(bpy, linked)


def _linked_files(bpy: Any, folder: Path) -> list[Path]:
    """Files that are not packed.  Raises FactoryError for one that is missing or elsewhere."""
    stated = bpy.utils.blend_paths(absolute=True, packed=False, local=False)
    linked = sorted({Path(text.replace("\\", "/")) for text in stated if text})
    for file in linked:
        if not real_path(file).is_relative_to(real_path(folder)):
            raise FactoryError(
                f"names {file}, which is not in the mesh's own folder; pack it (File, External "
                "Data) or put it beside the mesh"
            )
        # A number of a tile or frame stands in for several files.
        if "<" not in file.name and not file.is_file():
            raise FactoryError(f"its {file.name} is missing; pack it (File, External Data)")
    return [file for file in linked if file.is_file()]


def _reset_output(context: Any) -> None:
    """Set the output to one whole, plain PNG of the active view layer."""
    scene = context.scene
    render = scene.render
    render.engine = "CYCLES"
    render.use_multiview = False
    render.use_border = False
    render.use_crop_to_border = False
    render.use_stamp = False
    render.use_motion_blur = False
    render.use_freestyle = False
    render.use_compositing = False
    render.use_sequencer = False
    render.use_file_extension = True
    render.use_overwrite = True
    render.use_placeholder = False
    render.pixel_aspect_x = 1.0
    render.pixel_aspect_y = 1.0
    render.resolution_percentage = 100
    render.threads_mode = "FIXED"
    render.threads = 1
    output = render.image_settings
    if hasattr(output, "media_type"):  # from Blender 5 on; file_format has no PNG in a video
        output.media_type = "IMAGE"
    output.file_format = "PNG"
    output.color_mode = "RGB"
    output.color_depth = "8"
    output.color_management = "FOLLOW_SCENE"

    active = context.view_layer
    for layer in scene.view_layers:
        layer.use = layer.name == active.name
    # Markers change the camera with the frame.
    scene.timeline_markers.clear()
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = _SAMPLES
    cycles.seed = 0
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.shading_system = False  # a script of its own could read files
    scene.view_settings.view_transform = "Standard"


def camera_image(
    path: Path, world_from_camera: list[list[float]], lens: list[float], width: int, height: int
) -> bytes:
    """PNG of what a camera sees, by Cycles, with the file's own materials and lights.

    world_from_camera: (4, 4) in units of the file.  lens: fx, fy, cx, cy in pixels.
    """
    opened = _opened(real_path(path))
    bpy = opened.bpy
    import mathutils  # comes with Blender

    scene = bpy.context.scene
    if opened.camera is None:
        opened.camera = _add_camera(bpy, scene)
    camera = opened.camera
    fx, fy, cx, cy = lens
    camera.data.sensor_fit = "HORIZONTAL"
    camera.data.lens = fx * camera.data.sensor_width / width
    camera.data.clip_start = 1e-3
    camera.data.clip_end = 1e6
    camera.data.shift_x = (width / 2 - (cx + 0.5)) / width
    camera.data.shift_y = ((cy + 0.5) - height / 2) / width * fx / fy
    camera.matrix_world = mathutils.Matrix((np.array(world_from_camera) * (1, -1, -1, 1)).tolist())
    scene.camera = camera
    render = scene.render
    render.resolution_x = width
    render.resolution_y = height
    with tempfile.TemporaryDirectory() as folder:
        render.filepath = f"{folder}/seen.png"
        bpy.ops.render.render(write_still=True)
        return Path(render.filepath).read_bytes()


def _add_camera(bpy: Any, scene: Any) -> Any:
    """A camera in the scene; in one without lights, with a lamp on it, as a vehicle has one."""
    camera = bpy.data.objects.new("simnfnd camera", bpy.data.cameras.new("simnfnd camera"))
    scene.collection.objects.link(camera)
    if not any(scene_object.type == "LIGHT" for scene_object in scene.objects):
        lamp = bpy.data.objects.new("simnfnd lamp", bpy.data.lights.new("lamp", "SUN"))
        lamp.data.energy = 3.0
        lamp.parent = camera
        scene.collection.objects.link(lamp)
    return camera
