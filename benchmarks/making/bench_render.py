"""CPU seconds to render one 968x608 frame, by every renderer that is installed.

The frame is procedural, so anyone can repeat it.  Each renderer has a process of its own, whose
first render pays for imports and for Blender's start; the others are what a worker pays.  CPU
seconds are those of all threads of the process.
"""

from __future__ import annotations

import statistics
import time

import numpy as np

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import in_own_process, quiet
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import Frame
from simnfnd.factory.render import RenderSettings, open_renderer
from simnfnd.factory.render.mount import Mount
from simnfnd.factory.scenes.seabed import SeabedReader, SeabedSettings

REPEATS = 5
SETTINGS = (
    RenderSettings(kind="cycles"),
    RenderSettings(kind="cycles", stride=1),
    RenderSettings(kind="cycles", stride=1, geometry="mesh"),
    RenderSettings(kind="embree"),
    RenderSettings(kind="analytic"),
)
AT_CAMERA = Mount()
ABOVE = Mount(translation_m=(0.0, 0.0, 1.0))


def seabed_frame() -> Frame:
    """The first frame of the first procedural place."""
    reader = SeabedReader(SeabedSettings(locations=1, frames_per_location=1))
    return reader.load(reader.discover().frames[0])


def cpu_seconds(settings: RenderSettings, frame: Frame, mount: Mount, repeats: int) -> list[float]:
    """CPU time of the first render of this process, opening included, and of `repeats` more."""
    spent = []
    start = time.process_time()
    renderer = open_renderer(settings)
    for _ in range(1 + repeats):
        with quiet():
            rendered = renderer.render(frame, mount)
        now = time.process_time()
        spent.append(now - start)
        start = now
        if not np.any(rendered.radiance > 0):
            raise RuntimeError("the render is black; its time means nothing")
    return spent


def measure(options: Options) -> Section:
    """A row for each renderer."""
    frame = seabed_frame()
    height, width = frame.depth_m.shape
    note = (
        f"One {width}x{height} frame, {int(frame.valid.sum())} measured pixels; median of the "
        "renders after the first."
    )
    rows = tuple(_row(settings, frame, options.amount(REPEATS)) for settings in SETTINGS)
    columns = (
        "renderer",
        "CPU s, first render",
        "CPU s, sonar at the camera",
        "CPU s, 1 m above it",
    )
    return Section((Table(columns, rows, bars="CPU s, sonar at the camera"),), note)


def _row(settings: RenderSettings, frame: Frame, repeats: int) -> tuple[Cell, ...]:
    name = f"{settings.kind}, {settings.geometry}, stride {settings.stride}"
    try:
        first, *others = in_own_process(cpu_seconds, settings, frame, AT_CAMERA, repeats)
        # Without occlusion, or with that of points, a sonar off the camera means nothing.
        shadows = settings.geometry != "points" and settings.kind != "analytic"
        above = in_own_process(cpu_seconds, settings, frame, ABOVE, repeats)[1:] if shadows else []
    except FactoryError as error:
        return (name, str(error), "", "")
    off_camera = statistics.median(above) if above else "no shadows"
    return (name, first, statistics.median(others), off_camera)
