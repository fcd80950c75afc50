"""The noise of a real receiver, on the polar field; for acoustics.formation=field.

One file an effect.  Those of stage "echo" take and give a `Signal` before the device has blurred
it, those of "beam" and "picture" the complex field after beamforming, before and after time-varying
gain.  All depend on it, the ping, their drawn parameters and a random stream of their own, and on
nothing else.  The field is theirs: they change it where it lies and give it back.

What belongs to the ground or to the device (`of="recording"`) has one draw and one stream for all
frames of a recording; everything else is drawn anew for each sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass as plain_dataclass
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Literal

from simnfnd.factory import seeds
from simnfnd.factory.distribution import Distribution
from simnfnd.factory.noise.physical.beam_gain import BeamGainSettings, beam_gain
from simnfnd.factory.noise.physical.crosstalk import CrosstalkSettings, crosstalk
from simnfnd.factory.noise.physical.image_source import (
    BottomMultipathSettings,
    SurfaceMultipathSettings,
    bottom_multipath,
    surface_multipath,
)
from simnfnd.factory.noise.physical.near_range import (
    CombLinesSettings,
    RingDownSettings,
    comb_lines,
    ring_down,
)
from simnfnd.factory.noise.physical.receiver import ReceiverSettings, receiver
from simnfnd.factory.noise.physical.saturation import SaturationSettings, saturation
from simnfnd.factory.noise.physical.sidelobe_arcs import SidelobeArcsSettings, sidelobe_arcs
from simnfnd.factory.noise.physical.speckle import SpeckleSettings, speckle
from simnfnd.factory.noise.physical.spokes import SpokesSettings, spokes
from simnfnd.factory.noise.physical.texture import TextureSettings, texture
from simnfnd.factory.noise.physical.tvg_error import TvgErrorSettings, tvg_error
from simnfnd.factory.noise.physical.volume import VolumeSettings, volume

if TYPE_CHECKING:
    import numpy as np

    from simnfnd.factory.frame import FrameRef

Drawn = dict[str, float | str]
Stage = Literal["echo", "beam", "picture"]


@plain_dataclass(frozen=True)
class FieldEffect:
    """An effect as a function, and when it acts.

    of: sample, or recording when all frames of one share its parameters and its random stream.
    posed: that only when the frames have poses.
    """

    apply: Callable[..., Any]
    settings: type
    stage: Stage
    of: Literal["sample", "recording"] = "sample"
    posed: bool = False


# In the order in which they act.
FIELD_EFFECTS: dict[str, FieldEffect] = {
    "speckle": FieldEffect(speckle, SpeckleSettings, "echo", "recording", posed=True),
    "volume": FieldEffect(volume, VolumeSettings, "echo"),
    "surface_multipath": FieldEffect(surface_multipath, SurfaceMultipathSettings, "echo"),
    "bottom_multipath": FieldEffect(bottom_multipath, BottomMultipathSettings, "echo"),
    "texture": FieldEffect(texture, TextureSettings, "beam", "recording", posed=True),
    "sidelobe_arcs": FieldEffect(sidelobe_arcs, SidelobeArcsSettings, "beam"),
    "crosstalk": FieldEffect(crosstalk, CrosstalkSettings, "beam"),
    "receiver": FieldEffect(receiver, ReceiverSettings, "beam"),
    "tvg_error": FieldEffect(tvg_error, TvgErrorSettings, "picture"),
    "beam_gain": FieldEffect(beam_gain, BeamGainSettings, "picture", "recording"),
    "spokes": FieldEffect(spokes, SpokesSettings, "picture"),
    "ring_down": FieldEffect(ring_down, RingDownSettings, "picture"),
    "comb_lines": FieldEffect(comb_lines, CombLinesSettings, "picture"),
    "saturation": FieldEffect(saturation, SaturationSettings, "picture"),
}

_UNITS = {"db_per_m": "dB/m", "db_per_decade": "dB", "db": "dB", "m": "m", "deg": "deg"}


def blocks(noise: Any) -> dict[str, Any]:
    """The field effects that a configuration has, switched on or not, by name."""
    found = {name: getattr(noise, name) for name in FIELD_EFFECTS}
    return {name: block for name, block in found.items() if block is not None}


def parameters(noise: Any) -> list[tuple[str, str, type, str]]:
    """(effect, parameter, float or str, unit) of every parameter that a configuration has."""
    return [
        (
            name,
            item.name,
            float if isinstance(getattr(block, item.name), Distribution) else str,
            _unit(item.name),
        )
        for name, block in blocks(noise).items()
        for item in fields(block)
        if item.name != "enabled"
    ]


def _unit(name: str) -> str:
    for ending, unit in _UNITS.items():
        if name == ending or name.endswith(f"_{ending}"):
            return unit
    return "1"


def names_of(effect: str, ref: FrameRef, variant: int, posed: bool) -> tuple[str | int, ...]:
    """What the random streams of an effect are named by."""
    kind = FIELD_EFFECTS[effect]
    if kind.of == "recording" and (posed or not kind.posed):
        return ref.location, ref.scene, variant
    return ref.location, ref.scene, ref.frame, variant


def draw(noise: Any, seed: int, ref: FrameRef, variant: int, posed: bool) -> dict[str, Drawn]:
    """The parameters of every enabled field effect for one sample."""
    return {
        name: {
            item.name: _value(
                getattr(block, item.name),
                seed,
                name,
                item.name,
                *names_of(name, ref, variant, posed),
            )
            for item in fields(block)
            if item.name != "enabled"
        }
        for name, block in blocks(noise).items()
        if block.enabled
    }


def _value(given: Any, seed: int, *names: str | int) -> float | str:
    if not isinstance(given, Distribution):
        return str(given)
    if given.kind == "number":
        return given.values[0]
    return given.draw(seeds.stream(seed, "parameter", *names))


def stream(effect: str, seed: int, ref: FrameRef, variant: int, posed: bool) -> np.random.Generator:
    """The random stream of an effect for one sample."""
    return seeds.stream(seed, "noise", effect, *names_of(effect, ref, variant, posed))
