"""CPU seconds to render one 968x608 frame, by every renderer that is installed.

The frame is procedural, so anyone can repeat it.  Each renderer has a process of its own, whose
first render pays for imports and for Blender's start; the others are what a worker pays.  CPU
seconds are those of all threads of the process.
"""

from __future__ import annotations

import multiprocessing
import statistics
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from factory.errors import FactoryError
from factory.frame import Frame
from factory.render import RenderSettings, open_renderer
from factory.scenes.seabed import SeabedReader, SeabedSettings
from factory.sonar.mount import Mount

REPEATS = 5
SETTINGS = (
    RenderSettings(kind="cycles"),
    RenderSettings(kind="cycles", geometry="points"),
    RenderSettings(kind="embree"),
    RenderSettings(kind="analytic"),
)
AT_CAMERA = Mount()
ABOVE = Mount(translation_m=(0.0, 0.0, 1.0))


def seabed_frame() -> Frame:
    """The first frame of the first procedural place."""
    reader = SeabedReader(SeabedSettings(locations=1, frames_per_location=1))
    return reader.load(reader.discover().frames[0])


def cpu_seconds(settings: RenderSettings, frame: Frame, mount: Mount) -> list[float]:
    """CPU time of the first render of this process, opening included, and of REPEATS more."""
    spent = []
    start = time.process_time()
    renderer = open_renderer(settings)
    for _ in range(1 + REPEATS):
        rendered = renderer.render(frame, mount)
        now = time.process_time()
        spent.append(now - start)
        start = now
        if not np.any(rendered.radiance > 0):
            raise RuntimeError("the render is black; its time means nothing")
    return spent


def measured(settings: RenderSettings, frame: Frame, mount: Mount) -> list[float]:
    """`cpu_seconds` in a fresh process."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        return pool.submit(cpu_seconds, settings, frame, mount).result()


def row(settings: RenderSettings, frame: Frame) -> str:
    """One line of the table."""
    name = f"{settings.kind}, {settings.geometry}"
    try:
        first, *others = measured(settings, frame, AT_CAMERA)
        # Without occlusion, or with that of points, a sonar off the camera means nothing.
        shadows = settings.geometry == "mesh" and settings.kind != "analytic"
        above = measured(settings, frame, ABOVE)[1:] if shadows else []
    except FactoryError as error:
        return f"| {name} | {error} | | |"
    off_camera = f"{statistics.median(above):.3f}" if above else "no shadows"
    return f"| {name} | {first:.2f} | {statistics.median(others):.3f} | {off_camera} |"


def main() -> None:
    """Print the table."""
    frame = seabed_frame()
    height, width = frame.depth_m.shape
    print(f"One {width}x{height} frame, {int(frame.valid.sum())} measured pixels; CPU seconds,")
    print(f"median of {REPEATS} renders after the first.\n")
    print("| renderer | first render | sonar at the camera | sonar 1 m above it |")
    print("|---|---|---|---|")
    for settings in SETTINGS:
        print(row(settings, frame), flush=True)


if __name__ == "__main__":
    main()
