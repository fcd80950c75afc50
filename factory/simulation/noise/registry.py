"""All effects of noise, and the `noise` group of the configuration.

An effect is a settings class, a pure function and an `Effect` that joins them.  Those of `points`
are the paper's (section 3.3); the other modules act on the complex field.  To add an effect, write
these three, a line in `NoiseSettings`, a block in conf/noise/*.yaml and a test of its statistics.
Effects of other packages (`common.extensions`) come after them, in blocks of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, get_type_hints

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    model_serializer,
    model_validator,
)
from pydantic.dataclasses import dataclass
from pydantic_core import ArgsKwargs

from ...common import extensions
from ...common.errors import FactoryError
from ...common.settings import STRICT, build
from ..imaging.effect import Effect, EffectSettings
from . import points
from .crosstalk import CROSSTALK, CrosstalkSettings
from .declaration import check_effect
from .drift import DRIFTING_VOLUME, DriftingVolumeSettings
from .gains import (
    BEAM_GAIN,
    SECTOR_EDGES,
    TVG_ERROR,
    BeamGainSettings,
    SectorEdgesSettings,
    TvgErrorSettings,
)
from .multipath import (
    BOTTOM_MULTIPATH,
    SURFACE_MULTIPATH,
    BottomMultipathSettings,
    SurfaceMultipathSettings,
)
from .path_speckle import PATH_SPECKLE, PathSpeckleSettings
from .receiver import RECEIVER, ReceiverSettings
from .ringing import COMB_LINES, RING_DOWN, CombLinesSettings, RingDownSettings
from .saturation import SATURATION, SaturationSettings
from .scintillation import SCINTILLATION, ScintillationSettings
from .sidelobe_arcs import SIDELOBE_ARCS, SidelobeArcsSettings
from .speckle import SPECKLE, SpeckleSettings
from .spokes import SPOKES, SpokesSettings
from .texture import TEXTURE, TextureSettings
from .volume import VOLUME, VolumeSettings


@plain_dataclass(frozen=True)
class OwnEffect:
    """An effect of another package with the settings of its block.

    It takes its effect along to worker processes, which then know it, too.
    """

    effect: Effect
    settings: EffectSettings

    def __reduce__(self) -> tuple[Any, ...]:
        return _arrived, (self.effect, self.settings)


@dataclass(frozen=True, config=STRICT)
class NoiseSettings:
    """Keys of the `noise` group, one block an effect, in the order in which they are applied.

    A configuration that names none of the field's effects does not have them.
    own: blocks of effects of other packages, each given under the name of its effect.
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
    speckle: Annotated[SpeckleSettings | None, SPECKLE] = None
    path_speckle: Annotated[PathSpeckleSettings | None, PATH_SPECKLE] = None
    volume: Annotated[VolumeSettings | None, VOLUME] = None
    drifting_volume: Annotated[DriftingVolumeSettings | None, DRIFTING_VOLUME] = None
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

    own: Annotated[tuple[Any, ...], Field(exclude=True)] = ()

    @model_validator(mode="before")
    @classmethod
    def _take_own_blocks(cls, input_: Any) -> Any:
        values = input_.kwargs if isinstance(input_, ArgsKwargs) else input_
        if not isinstance(values, Mapping):
            return input_
        values = dict(values)
        own = values.pop("own", ())
        if not all(isinstance(block, OwnEffect) for block in own):
            raise ValueError("own: unknown key; name the effect itself")
        for name in [key for key in values if key not in BUILT_IN]:
            effect = own_effect(name)
            if effect is not None:
                settings: EffectSettings = build(effect.settings, values.pop(name), f"noise.{name}")
                own = (*own, OwnEffect(effect, settings))
        return {**values, "own": own}

    @model_serializer(mode="wrap")
    def _present(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values = {name: block for name, block in serialise(self).items() if block is not None}
        for block in self.own:
            kind: TypeAdapter[Any] = TypeAdapter(type(block.settings))
            values[block.effect.name] = kind.dump_python(block.settings, mode="json")
        return values


_HINTS = get_type_hints(NoiseSettings, include_extras=True)
EFFECTS: dict[str, Effect] = {
    name: hint.__metadata__[0] for name, hint in _HINTS.items() if name != "own"
}
"""Effects by the names of their blocks: built-in ones, then those of other packages in use."""
BUILT_IN = tuple(EFFECTS)
"""Names of the effects that `NoiseSettings` has fields for."""


def register_effect(effect: Effect) -> None:
    """Make an effect known in this process, as `noise.<effect.name>`.

    Raises ValueError for a name that is taken or no name, and for an effect that declares
    something wrong (see `declaration`).
    """
    if not isinstance(effect, Effect):
        raise ValueError(f"effect: is a {type(effect).__name__}; give an Effect")
    name = effect.name
    if name in BUILT_IN:
        raise ValueError(f"effect {name!r}: there is one of that name")
    problem = _problem_of(effect)
    if problem:
        raise ValueError(f"effect {name!r}: {problem}")
    _adopt(effect)


def _adopt(effect: Effect) -> None:
    extensions.register("effect", effect.name, effect)
    EFFECTS[effect.name] = effect


@lru_cache(maxsize=64)
def _problem_of(effect: Effect) -> str:
    """What is wrong with an effect; "" for a sound one."""
    try:
        check_effect(effect)
    except ValueError as error:
        return " ".join(str(error).split())
    return ""


def own_effect(name: str) -> Effect | None:
    """The effect of another package that has this name; None where there is none.

    Raises FactoryError for one that cannot be loaded, or is no effect.
    """
    extension = extensions.find("effect", name)
    if extension is None:
        return None
    effect = extension.value
    if not isinstance(effect, Effect) or effect.name != name or name in BUILT_IN:
        raise FactoryError(
            f"noise.{name}: {extension.source} gives no `Effect` of that name for it; report it "
            "to the package's author"
        )
    problem = _problem_of(effect)
    if problem:
        raise FactoryError(
            f"noise.{name}: {extension.source}: {problem}; report it to the package's author"
        )
    EFFECTS[name] = effect
    return effect


def own_effects() -> list[Effect]:
    """The effects of other packages that can be loaded."""
    effects = []
    for name in extensions.names("effect"):
        with suppress(FactoryError):
            effect = own_effect(name)
            effects += [effect] if effect else []
    return effects


def _arrived(effect: Effect, settings: EffectSettings) -> OwnEffect:
    """Rebuild an unpickled effect of the user, and register it in this process."""
    if effect.name not in EFFECTS:
        _adopt(effect)  # it was checked where it comes from
    return OwnEffect(effect, settings)


def blocks(settings: NoiseSettings) -> dict[str, EffectSettings]:
    """The effects that a configuration has, switched on or not, by name and in order."""
    built_in = {name: getattr(settings, name) for name in BUILT_IN}
    present = {name: block for name, block in built_in.items() if block is not None}
    return present | {block.effect.name: block.settings for block in settings.own}


def with_blocks(settings: NoiseSettings, changed: Mapping[str, EffectSettings]) -> NoiseSettings:
    """The settings with other blocks in the place of those of the same names."""
    own = tuple(
        replace(block, settings=changed.get(block.effect.name, block.settings))
        for block in settings.own
    )
    built_in: dict[str, Any] = {n: block for n, block in changed.items() if n in BUILT_IN}
    return replace(settings, **built_in, own=own)
