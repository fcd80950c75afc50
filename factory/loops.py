"""Every module with compiled loops, so that a run can compile them before its workers start."""

from __future__ import annotations

import importlib

from simnfnd.factory.progress import stage_if_slow

LOOPS = (
    "simnfnd.factory.dataset.describe.window_loops",
    "simnfnd.factory.dataset.write.checksum_loops",
    "simnfnd.factory.formation.field.cells.cell_loops",
    "simnfnd.factory.formation.field.display_loops",
    "simnfnd.factory.formation.field.kernels",
    "simnfnd.factory.formation.field.cells.path_loops",
    "simnfnd.factory.formation.field.pixel_rows",
    "simnfnd.factory.formation.field.placing",
    "simnfnd.factory.formation.field.cells.world_loops",
    "simnfnd.factory.render.albedo",
    "simnfnd.factory.render.cloud.joints",
    "simnfnd.factory.render.cloud.planes",
    "simnfnd.factory.render.shading",
    "simnfnd.factory.render.traced",
    "simnfnd.factory.scenes.seabed.loops.colour_loops",
    "simnfnd.factory.scenes.seabed.loops.field_loops",
    "simnfnd.factory.scenes.seabed.loops.ground_loops",
    "simnfnd.factory.scenes.seabed.loops.light_loops",
    "simnfnd.factory.scenes.seabed.objects.mesh_loops",
    "simnfnd.factory.scenes.seabed.loops.picture_loops",
    "simnfnd.factory.scenes.seabed.loops.raster_loops",
    "simnfnd.factory.scenes.seabed.loops.surface_loops",
    "simnfnd.factory.scenes.seabed.loops.texture_loops",
    "simnfnd.factory.scenes.seabed.loops.viewpoint_loops",
    "simnfnd.factory.sonar.echo_loops",
    "simnfnd.factory.recordings.fan.loops",
    "simnfnd.factory.sonar.number_loops",
    "simnfnd.factory.sonar.picture_loops",
)


def compile_all() -> None:
    """Compile what is not on disk yet: once, before many workers would do it at once."""
    with stage_if_slow(
        "loading the loops; the first time compiles them, about a minute", after_s=3.0
    ):
        for name in LOOPS:
            importlib.import_module(name)
