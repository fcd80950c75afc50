"""All effects of noise, and the `noise` group of the configuration.

An effect is a settings class, a pure function and an `Effect` that joins them: in `points` (it
makes or moves echoes, paper section 3.3), or in `speckle`, `receiver` and `paths` (it acts on the
complex field of acoustics.formation=field).  To add one: these three, one line in `NoiseSettings`
below, a block in conf/noise/*.yaml and a test against the formula's statistics.
"""

from __future__ import annotations

from typing import Annotated, Any, get_type_hints

from pydantic import SerializerFunctionWrapHandler, model_serializer
from pydantic.dataclasses import dataclass

from ..imaging.effect import Effect, EffectSettings
from ..settings import STRICT
from .paths import (
    BOTTOM_MULTIPATH,
    CROSSTALK,
    SIDELOBE_ARCS,
    SPOKES,
    SURFACE_MULTIPATH,
    BottomMultipathSettings,
    CrosstalkSettings,
    SidelobeArcsSettings,
    SpokesSettings,
    SurfaceMultipathSettings,
)
from .points import (
    AZIMUTH,
    BACKGROUND,
    MULTIPATH,
    RANGE_ARC,
    RANGE_SPREADING,
    AzimuthSettings,
    BackgroundSettings,
    MultipathSettings,
    RangeArcSettings,
    RangeSpreadingSettings,
)
from .receiver import (
    BEAM_GAIN,
    COMB_LINES,
    RECEIVER,
    RING_DOWN,
    SATURATION,
    SECTOR_EDGES,
    TVG_ERROR,
    BeamGainSettings,
    CombLinesSettings,
    ReceiverSettings,
    RingDownSettings,
    SaturationSettings,
    SectorEdgesSettings,
    TvgErrorSettings,
)
from .speckle import (
    PATH_SPECKLE,
    SCINTILLATION,
    SPECKLE,
    TEXTURE,
    VOLUME,
    PathSpeckleSettings,
    ScintillationSettings,
    SpeckleSettings,
    TextureSettings,
    VolumeSettings,
)


@dataclass(frozen=True, config=STRICT)
class NoiseSettings:
    """Keys of the `noise` group, one block an effect, in the order in which they are applied.

    A configuration that names none of the field's effects does not have them.
    """

    range_spreading: Annotated[RangeSpreadingSettings, RANGE_SPREADING] = RangeSpreadingSettings()
    multipath: Annotated[MultipathSettings, MULTIPATH] = MultipathSettings()
    azimuth: Annotated[AzimuthSettings, AZIMUTH] = AzimuthSettings()
    range_arc: Annotated[RangeArcSettings, RANGE_ARC] = RangeArcSettings()
    background: Annotated[BackgroundSettings, BACKGROUND] = BackgroundSettings()
    speckle: Annotated[SpeckleSettings | None, SPECKLE] = None
    path_speckle: Annotated[PathSpeckleSettings | None, PATH_SPECKLE] = None
    volume: Annotated[VolumeSettings | None, VOLUME] = None
    surface_multipath: Annotated[SurfaceMultipathSettings | None, SURFACE_MULTIPATH] = None
    bottom_multipath: Annotated[BottomMultipathSettings | None, BOTTOM_MULTIPATH] = None
    texture: Annotated[TextureSettings | None, TEXTURE] = None
    sidelobe_arcs: Annotated[SidelobeArcsSettings | None, SIDELOBE_ARCS] = None
    crosstalk: Annotated[CrosstalkSettings | None, CROSSTALK] = None
    receiver: Annotated[ReceiverSettings | None, RECEIVER] = None
    tvg_error: Annotated[TvgErrorSettings | None, TVG_ERROR] = None
    scintillation: Annotated[ScintillationSettings | None, SCINTILLATION] = None
    beam_gain: Annotated[BeamGainSettings | None, BEAM_GAIN] = None
    sector_edges: Annotated[SectorEdgesSettings | None, SECTOR_EDGES] = None
    spokes: Annotated[SpokesSettings | None, SPOKES] = None
    ring_down: Annotated[RingDownSettings | None, RING_DOWN] = None
    comb_lines: Annotated[CombLinesSettings | None, COMB_LINES] = None
    saturation: Annotated[SaturationSettings | None, SATURATION] = None

    @model_serializer(mode="wrap")
    def _present(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: block for name, block in serialise(self).items() if block is not None}


def _registered() -> dict[str, Effect]:
    """The effects that the annotations of `NoiseSettings` name, by the names of their blocks."""
    hints = get_type_hints(NoiseSettings, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items()}


EFFECTS: dict[str, Effect] = _registered()
POINT_EFFECTS = tuple(name for name, effect in EFFECTS.items() if effect.stage == "points")
FIELD_EFFECTS = tuple(name for name in EFFECTS if name not in POINT_EFFECTS)


def blocks(settings: NoiseSettings) -> dict[str, EffectSettings]:
    """The effects that a configuration has, switched on or not, by name and in order."""
    found = {name: getattr(settings, name) for name in EFFECTS}
    return {name: block for name, block in found.items() if block is not None}
