"""Blender as a library: import, the stage that frames are put on, and pixels back out.

bpy is one Blender for the whole process.  All that is made here lives in a scene of its own, so
nothing else in that Blender is touched.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..frame import Intrinsics
from .base import RenderSettings, missing

_SENSOR_WIDTH_MM = 36.0

# Pixel centres are vertices of the mesh, and a ray through the very meeting point of six triangles
# can miss them all.  So the camera looks past them by a little more than the rounding of 32-bit
# coordinates (1e-4 of a pixel), in a direction along none of the mesh's edges.
_OFF_VERTEX_PX = (2e-3, 1e-3)

# A point light of P watts has the intensity P / (4 pi), and a Lambert surface returns albedo / pi
# of it, so this power makes a pixel albedo * cos / range^2.
_LIGHT_POWER_W = 4 * np.pi**2


def import_bpy() -> Any:
    """Blender's module: a second and 260 MB, so only render workers may call this.

    Raises FactoryError when it cannot be imported.
    """
    try:
        # It may greet the world (a warning where /etc/mtab is missing): stdout is the user's.
        with _one_core(), _silent_stdout():
            import bpy
    except (ImportError, OSError) as error:
        raise missing("cycles", error) from error
    return bpy


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


@dataclass(frozen=True)
class Stage:
    """A scene with a camera at the origin, looking along +z with y down, and the sonar's light.

    World axes are therefore the camera axes of `simnfnd.factory.frame`.
    """

    bpy: Any
    scene: Any
    camera: Any
    light: Any


def make_stage(bpy: Any, settings: RenderSettings) -> Stage:
    """A new scene that renders direct light exactly at pixel centres, the same bytes every time."""
    scene = bpy.data.scenes.new("sonar")
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_percentage = 100
    render.film_transparent = True  # alpha becomes the mask of what the camera's rays hit
    render.threads_mode, render.threads = "FIXED", 1
    render.use_compositing = render.use_sequencer = False

    cycles.device = "CPU"
    cycles.samples = settings.samples
    cycles.max_bounces = cycles.diffuse_bounces = settings.bounces
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
    camera.data.sensor_fit, camera.data.sensor_width = "HORIZONTAL", _SENSOR_WIDTH_MM
    camera.data.clip_start, camera.data.clip_end = 1e-4, 1e6
    scene.collection.objects.link(camera)
    scene.camera = camera

    light = bpy.data.objects.new("sonar", bpy.data.lights.new("sonar", "POINT"))
    light.data.energy = _LIGHT_POWER_W
    light.data.shadow_soft_size = 0
    light.data.use_soft_falloff = False
    scene.collection.objects.link(light)
    return Stage(bpy, scene, camera, light)


def aim(stage: Stage, intrinsics: Intrinsics, height: int, width: int) -> None:
    """Give the stage's camera these intrinsics and image size, pixel for pixel."""
    render, lens = stage.scene.render, stage.camera.data
    render.resolution_x, render.resolution_y = width, height
    # Blender has one focal length; unequal ones are pixels that are not square.
    render.pixel_aspect_x = max(1.0, intrinsics.fy / intrinsics.fx)
    render.pixel_aspect_y = max(1.0, intrinsics.fx / intrinsics.fy)
    lens.lens = intrinsics.fx * _SENSOR_WIDTH_MM / width
    across, down = _OFF_VERTEX_PX
    lens.shift_x = (width / 2 - (intrinsics.cx + 0.5) + across) / width
    rise = (intrinsics.cy + 0.5) - height / 2 + down
    lens.shift_y = rise / width * intrinsics.fx / intrinsics.fy


def render_pixels(stage: Stage) -> npt.NDArray[np.float32]:
    """(H, W, 4) float32 linear RGBA of the stage, premultiplied, top row first.

    Taken as soon as Cycles has it: later on, without a window, it cannot be read.
    """
    from cycles import CyclesRender

    taken: list[npt.NDArray[np.float32]] = []
    original: Callable[..., None] = CyclesRender.render

    def render_and_take(self: Any, depsgraph: Any) -> None:
        original(self, depsgraph)
        result = self.get_result()
        pixels = np.empty((result.resolution_y, result.resolution_x, 4), np.float32)
        result.layers[0].passes["Combined"].rect.foreach_get(pixels.ravel())
        taken.append(pixels[::-1])

    CyclesRender.render = render_and_take
    try:
        stage.bpy.ops.render.render(scene=stage.scene.name)
    finally:
        CyclesRender.render = original
    return taken[0]


@contextmanager
def _silent_stdout() -> Iterator[None]:
    """Blender greets the world on the C level, past sys.stdout."""
    keep = os.dup(1)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 1)
        yield
    finally:
        os.dup2(keep, 1)
        os.close(keep)
