"""An effect of noise: what it declares in its own file, and what is drawn of it for a sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, fields
from functools import cached_property
from typing import Any, Literal

import numpy as np
from pydantic.dataclasses import dataclass as validated

from ...common import seeds
from ...common.distribution import parse
from ...common.settings import STRICT
from .artefacts import Artefact

Names = tuple[str | int, ...]
Rng = np.random.Generator
Value = float | int | str

# When an effect acts: on the echoes as points; on the complex field before the device blurs it;
# after beamforming; after time-varying gain.
Stage = Literal["points", "echo", "beam", "image"]

Scope = Literal["sample", "recording", "world"]


@validated(frozen=True, config=STRICT)
class EffectSettings:
    """Keys that the block of every effect has; its parameters follow.

    enabled: whether the effect acts.
    """

    enabled: bool = True


def parameter(default: float | str | dict[str, list[float]], unit: str = "1") -> Any:
    """A field of an effect's settings; its draws are recorded.

    default: a number, a distribution, or one of several words.  unit: of the record's column.
    """
    is_word = isinstance(default, str)
    metadata = {"unit": unit, "type": str if is_word else float}
    return field(default=default if is_word else parse(default), metadata=metadata)


@dataclass(frozen=True)
class Effect:
    """An effect of noise.

    settings: its block of the configuration; every field but `enabled` is made by `parameter`.
    function: pure, `(subject, context, rng, **parameters) -> subject`.  Stage points: subject and
        result are Echoes, the context is the Window.  Stage echo: a Signal and the Ping; stages
        beam and image: the complex field and the Ping.  These may change the field in place.
    artefact: what it shows in an image and what a denoiser may be asked to remove; None: it is a
        property of the scene, which a denoiser keeps.
    scope: what shares one draw and one random stream: a sample; all frames of a recording (the
        device's own effects); or "world", a recording whose frames have poses, else a sample.
    moves: of stage points, displaces the scene's own echoes; the others add echoes to them.
    systematic: of the field's effects that are there in every image of a scene and device, which
        target mean_log keeps, what they do on average: changes an `expected.Expected` in place,
        `(expected, ping, rng, **parameters)`, with the random stream of `function`.
    expected: the same of random ones, which average out.  None: nothing.
    realised: of random effects, the same for what they do in this one sample, where an image
        without speckle still shows it.  None: as `expected`.
    name: of an effect of another package, what its block in `noise` is called; those of
        `NoiseSettings` have the names of its fields.
    """

    settings: type[EffectSettings]
    function: Callable[..., Any]
    stage: Stage
    artefact: Artefact | None = None
    scope: Scope = "sample"
    moves: bool = False
    systematic: Callable[..., None] | None = None
    expected: Callable[..., None] | None = None
    realised: Callable[..., None] | None = None
    name: str = ""

    def __getstate__(self) -> dict[str, Any]:
        """The state for workers, without `parameters`, whose annotations cannot be pickled."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @cached_property
    def parameters(self) -> tuple[Field[Any], ...]:
        """The fields that `parameter` made, in the order of the settings."""
        return tuple(item for item in fields(self.settings) if item.metadata)


@dataclass(frozen=True)
class DrawnEffect:
    """An effect with the parameters and the random stream of one sample.

    stream_names: what its stream is named by; `seed` is the configuration's.
    """

    name: str
    effect: Effect
    parameters: Mapping[str, Value]
    seed: int
    stream_names: Names

    @property
    def stage(self) -> Stage:
        """When it acts."""
        return self.effect.stage

    def apply(self, subject: Any, context: Any) -> Any:
        """What the effect makes of `subject`; equal calls give equal results.  See `Effect`."""
        return self.effect.function(subject, context, self.stream(), **self.parameters)

    def expect(self, expected: Any, context: Any, *, realised: bool = False) -> None:
        """Change expected intensities as it does on average or, realised, in this sample."""
        effect = self.effect
        change = (realised and effect.realised) or effect.expected or effect.systematic
        if change is not None:
            change(expected, context, self.stream(), **self.parameters)

    def stream(self) -> Rng:
        """The random stream of the effect, from its beginning."""
        return seeds.stream(self.seed, "noise", self.name, *self.stream_names)
