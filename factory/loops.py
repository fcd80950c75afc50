"""Every module with compiled loops, so that a run can compile them before its workers start."""

from __future__ import annotations

import importlib

from .progress import stage_if_slow

LOOPS = (
    "simnfnd.factory.elementary",
    "simnfnd.factory.imaging.coherent.cells.cell_loops",
    "simnfnd.factory.imaging.coherent.display_loops",
    "simnfnd.factory.imaging.coherent.kernels",
    "simnfnd.factory.imaging.coherent.cells.path_loops",
    "simnfnd.factory.imaging.coherent.pixel_rows",
    "simnfnd.factory.imaging.coherent.placing",
    "simnfnd.factory.imaging.coherent.cells.world_loops",
    "simnfnd.factory.render.albedo",
    "simnfnd.factory.render.cloud.joints",
    "simnfnd.factory.render.cloud.planes",
    "simnfnd.factory.render.shading",
    "simnfnd.factory.render.traced",
    "simnfnd.factory.scenes.seabed.kernels",
    "simnfnd.factory.sonar.echo_loops",
    "simnfnd.models.recordings.fan.loops",
    "simnfnd.factory.sonar.picture_loops",
)


def compile_all() -> None:
    """Compile what is not on disk yet: once, before many workers would do it at once."""
    with stage_if_slow(
        "loading the loops; the first time compiles them, about a minute", after_s=3.0
    ):
        for name in LOOPS:
            importlib.import_module(name)
