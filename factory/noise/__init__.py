"""The noise of a real sonar, one file an effect (paper section 3.3).

Every effect is a pure function `(scene, window, rng, **parameters) -> Echoes`.  Its parameters are
drawn in one place (`draw`), recorded with the sample, and can be given again: any sample can be
made anew from its record.  Every effect and every parameter has a random stream of its own, so
changing or switching off one leaves the others' draws untouched.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass as plain_dataclass
from dataclasses import field, fields
from typing import Any

from pydantic import SerializerFunctionWrapHandler, model_serializer
from pydantic.dataclasses import dataclass

from simnfnd.factory import seeds
from simnfnd.factory.distribution import Distribution
from simnfnd.factory.noise.azimuth import AzimuthSettings, azimuth
from simnfnd.factory.noise.background import BackgroundSettings, background
from simnfnd.factory.noise.multipath import MultipathSettings, multipath
from simnfnd.factory.noise.physical.beam_gain import BeamGainSettings
from simnfnd.factory.noise.physical.crosstalk import CrosstalkSettings
from simnfnd.factory.noise.physical.image_source import (
    BottomMultipathSettings,
    SurfaceMultipathSettings,
)
from simnfnd.factory.noise.physical.near_range import CombLinesSettings, RingDownSettings
from simnfnd.factory.noise.physical.receiver import ReceiverSettings
from simnfnd.factory.noise.physical.saturation import SaturationSettings
from simnfnd.factory.noise.physical.sidelobe_arcs import SidelobeArcsSettings
from simnfnd.factory.noise.physical.speckle import SpeckleSettings
from simnfnd.factory.noise.physical.spokes import SpokesSettings
from simnfnd.factory.noise.physical.texture import TextureSettings
from simnfnd.factory.noise.physical.tvg_error import TvgErrorSettings
from simnfnd.factory.noise.physical.volume import VolumeSettings
from simnfnd.factory.noise.range_arc import RangeArcSettings, range_arc
from simnfnd.factory.noise.range_spreading import RangeSpreadingSettings, range_spreading
from simnfnd.factory.settings import STRICT
from simnfnd.factory.sonar.echoes import Echoes, join
from simnfnd.factory.sonar.window import Window

Drawn = dict[str, float | str]


@dataclass(frozen=True, config=STRICT)
class NoiseSettings:
    """Keys of the `noise` group, one block an effect, in the order in which they are applied.

    The first five are the paper's and add or move points.  The others act on the polar field of
    acoustics.formation=field (`noise.physical`); a configuration that does not name one
    does not have it.
    """

    range_spreading: RangeSpreadingSettings = field(default_factory=RangeSpreadingSettings)
    multipath: MultipathSettings = field(default_factory=MultipathSettings)
    azimuth: AzimuthSettings = field(default_factory=AzimuthSettings)
    range_arc: RangeArcSettings = field(default_factory=RangeArcSettings)
    background: BackgroundSettings = field(default_factory=BackgroundSettings)
    speckle: SpeckleSettings | None = None
    volume: VolumeSettings | None = None
    surface_multipath: SurfaceMultipathSettings | None = None
    bottom_multipath: BottomMultipathSettings | None = None
    texture: TextureSettings | None = None
    sidelobe_arcs: SidelobeArcsSettings | None = None
    crosstalk: CrosstalkSettings | None = None
    receiver: ReceiverSettings | None = None
    tvg_error: TvgErrorSettings | None = None
    beam_gain: BeamGainSettings | None = None
    spokes: SpokesSettings | None = None
    ring_down: RingDownSettings | None = None
    comb_lines: CombLinesSettings | None = None
    saturation: SaturationSettings | None = None

    @model_serializer(mode="wrap")
    def _present(self, serialise: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: block for name, block in serialise(self).items() if block is not None}


@plain_dataclass(frozen=True)
class Effect:
    """An effect as a function.

    moves: True when it displaces the scene's own echoes; all others add echoes to them.
    """

    apply: Callable[..., Echoes]
    moves: bool = False


EFFECTS: dict[str, Effect] = {
    "range_spreading": Effect(range_spreading, moves=True),
    "multipath": Effect(multipath),
    "azimuth": Effect(azimuth),
    "range_arc": Effect(range_arc),
    "background": Effect(background),
}


def draw(settings: NoiseSettings, seed: int, *names: str | int) -> dict[str, Drawn]:
    """The parameters of every enabled effect for the sample called `names`."""
    drawn: dict[str, Drawn] = {}
    for effect in EFFECTS:
        block = getattr(settings, effect)
        if block.enabled:
            drawn[effect] = {
                item.name: _value(getattr(block, item.name), seed, effect, item.name, *names)
                for item in fields(block)
                if item.name != "enabled"
            }
    return drawn


def _value(given: Any, seed: int, *names: str | int) -> float | str:
    if not isinstance(given, Distribution):
        return str(given)
    if given.kind == "number":
        return given.values[0]
    return given.draw(seeds.stream(seed, "parameter", *names))


def parameter_names(settings: NoiseSettings) -> list[tuple[str, str, type]]:
    """(effect, parameter, float or str) of every parameter, in the order of the table."""
    return [
        (effect, item.name, float if isinstance(getattr(block, item.name), Distribution) else str)
        for effect in EFFECTS
        for block in [getattr(settings, effect)]
        for item in fields(block)
        if item.name != "enabled"
    ]


def layers(
    scene: Echoes,
    movable: Echoes,
    window: Window,
    drawn: dict[str, Drawn],
    seed: int,
    *names: str | int,
) -> dict[str, Echoes]:
    """What each drawn effect makes: its own echoes, or `movable`, displaced.

    scene: the resampled scene; its number of points is what the densities are fractions of.
    """
    made = {}
    for effect, parameters in drawn.items():
        rng = seeds.stream(seed, "noise", effect, *names)
        source = movable if EFFECTS[effect].moves else scene
        made[effect] = EFFECTS[effect].apply(source, window, rng, **parameters)
    return made


def combine(scene: Echoes, made: dict[str, Echoes], full_scale: float) -> Echoes:
    """The noisy cloud as one: `parts`, joined."""
    return join(*parts(scene, made, full_scale))


def parts(scene: Echoes, made: dict[str, Echoes], full_scale: float) -> list[Echoes]:
    """The noisy cloud: the (displaced) scene, and the added echoes of each effect.

    full_scale: the echo level shown as grey value 1; strengths of added echoes are fractions of it.
    """
    added = []
    for effect, echoes in made.items():
        if EFFECTS[effect].moves:
            scene = echoes
        else:
            added.append(echoes.louder(full_scale))
    return [scene, *added]
