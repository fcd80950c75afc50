"""All effects of noise, and the `noise` group of the configuration.

An effect is a settings class, a pure function and an `Effect` that joins them: in `points` (paper
section 3.3), or in `speckle`, `receiver` and `paths` (on the complex field).  To add one: these
three, a line in `NoiseSettings`, a block in conf/noise/*.yaml and a test of its statistics.
"""

from __future__ import annotations

from typing import Annotated, Any, get_type_hints

from pydantic import SerializerFunctionWrapHandler, model_serializer
from pydantic.dataclasses import dataclass

from ..imaging.effect import Effect, EffectSettings
from ..settings import STRICT
from . import drift, paths, points
from . import receiver as device
from . import speckle as grain


@dataclass(frozen=True, config=STRICT)
class NoiseSettings:
    """Keys of the `noise` group, one block an effect, in the order in which they are applied.

    A configuration that names none of the field's effects does not have them.
    """

    range_spreading: Annotated[points.RangeSpreadingSettings, points.RANGE_SPREADING] = (
        points.RangeSpreadingSettings()
    )
    multipath: Annotated[points.MultipathSettings, points.MULTIPATH] = points.MultipathSettings()
    azimuth: Annotated[points.AzimuthSettings, points.AZIMUTH] = points.AzimuthSettings()
    range_arc: Annotated[points.RangeArcSettings, points.RANGE_ARC] = points.RangeArcSettings()
    background: Annotated[points.BackgroundSettings, points.BACKGROUND] = (
        points.BackgroundSettings()
    )
    speckle: Annotated[grain.SpeckleSettings | None, grain.SPECKLE] = None
    path_speckle: Annotated[grain.PathSpeckleSettings | None, grain.PATH_SPECKLE] = None
    volume: Annotated[grain.VolumeSettings | None, grain.VOLUME] = None
    drifting_volume: Annotated[drift.DriftingVolumeSettings | None, drift.DRIFTING_VOLUME] = None
    surface_multipath: Annotated[paths.SurfaceMultipathSettings | None, paths.SURFACE_MULTIPATH] = (
        None
    )
    bottom_multipath: Annotated[paths.BottomMultipathSettings | None, paths.BOTTOM_MULTIPATH] = None
    texture: Annotated[grain.TextureSettings | None, grain.TEXTURE] = None
    sidelobe_arcs: Annotated[paths.SidelobeArcsSettings | None, paths.SIDELOBE_ARCS] = None
    crosstalk: Annotated[paths.CrosstalkSettings | None, paths.CROSSTALK] = None
    receiver: Annotated[device.ReceiverSettings | None, device.RECEIVER] = None
    tvg_error: Annotated[device.TvgErrorSettings | None, device.TVG_ERROR] = None
    scintillation: Annotated[grain.ScintillationSettings | None, grain.SCINTILLATION] = None
    beam_gain: Annotated[device.BeamGainSettings | None, device.BEAM_GAIN] = None
    sector_edges: Annotated[device.SectorEdgesSettings | None, device.SECTOR_EDGES] = None
    spokes: Annotated[paths.SpokesSettings | None, paths.SPOKES] = None
    ring_down: Annotated[device.RingDownSettings | None, device.RING_DOWN] = None
    comb_lines: Annotated[device.CombLinesSettings | None, device.COMB_LINES] = None
    saturation: Annotated[device.SaturationSettings | None, device.SATURATION] = None

    @model_serializer(mode="wrap")
    def _present(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: block for name, block in serialise(self).items() if block is not None}


_HINTS = get_type_hints(NoiseSettings, include_extras=True)
EFFECTS: dict[str, Effect] = {name: hint.__metadata__[0] for name, hint in _HINTS.items()}
"""Those that the annotations of `NoiseSettings` name, by the names of their blocks."""


def blocks(settings: NoiseSettings) -> dict[str, EffectSettings]:
    """The effects that a configuration has, switched on or not, by name and in order."""
    found = {name: getattr(settings, name) for name in EFFECTS}
    return {name: block for name, block in found.items() if block is not None}
