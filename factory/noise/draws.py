"""The noise of one sample: drawn parameters, random streams, and what the record says of them.

Every effect and every parameter has a random stream of its own, so changing or switching off one
leaves the draws of the others as they are.  Drawn values, given again as numbers, make the same
sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from .. import seeds
from ..dataset.schema import Column
from ..distribution import Distribution
from ..frame import FrameRef
from ..imaging.effect import DrawnEffect, Names, Parameter, Scope, Value
from .registry import EFFECTS, NoiseSettings, blocks


@dataclass(frozen=True)
class StreamNames:
    """What the random streams are named by, for each `Scope` of an effect."""

    sample: Names
    recording: Names
    world: Names

    @classmethod
    def of(cls, ref: FrameRef, variant: int, has_pose: bool) -> StreamNames:
        """Names for one variant of a frame; has_pose: whether the frame's pose is known."""
        sample = (ref.location, ref.scene, ref.frame, variant)
        recording = (ref.location, ref.scene, variant)
        return cls(sample, recording, recording if has_pose else sample)

    @classmethod
    def single(cls, *names: str | int) -> StreamNames:
        """One name for all scopes: a sample that belongs to no recording."""
        return cls(names, names, names)

    def of_scope(self, scope: Scope) -> Names:
        """The names for effects of this scope."""
        return {"sample": self.sample, "recording": self.recording, "world": self.world}[scope]


@dataclass(frozen=True)
class Draws:
    """All effects of one sample, in the order in which they act.

    settings: what they were drawn from.
    """

    settings: NoiseSettings
    effects: tuple[DrawnEffect, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the effects."""
        return tuple(effect.name for effect in self.effects)

    def __getitem__(self, name: str) -> DrawnEffect:
        """The effect of this name.  Raises KeyError when it is off."""
        return {effect.name: effect for effect in self.effects}[name]

    def row(self, added: Mapping[str, int]) -> dict[str, Value]:
        """The values of `columns`; NaN or "" for the parameters of an effect that is off.

        added: points that each effect of stage points has added or moved, by its name.
        """
        drawn = {effect.name: effect.parameters for effect in self.effects}
        row: dict[str, Value] = {
            _count(name): added.get(name, 0) for name in _making(self.settings)
        }
        for effect, parameter in _recorded(self.settings):
            missing = "" if parameter.type is str else float("nan")
            row[_column(effect, parameter)] = drawn.get(effect, {}).get(parameter.name, missing)
        return row


def draw(settings: NoiseSettings, seed: int, names: StreamNames) -> Draws:
    """The parameters of every enabled effect for one sample."""
    drawn = []
    for name, block in blocks(settings).items():
        if block.enabled:
            effect = EFFECTS[name]
            own = names.of_scope(effect.scope)
            values = {
                parameter.name: _value(
                    getattr(block, parameter.name), seed, name, parameter.name, *own
                )
                for parameter in effect.parameters
            }
            drawn.append(DrawnEffect(name, effect, values, seed, own))
    return Draws(settings, tuple(drawn))


def _value(configured: Distribution | str, seed: int, *names: str | int) -> Value:
    if isinstance(configured, str):
        return configured
    if configured.kind == "number":
        return configured.values[0]
    return configured.draw(seeds.stream(seed, "parameter", *names))


def columns(settings: NoiseSettings) -> tuple[Column, ...]:
    """Columns of the sample table: points of each effect that makes some, then all parameters."""
    counts = tuple(
        Column(_count(name), "i8", "1", f"points that {name} added or moved")
        for name in _making(settings)
    )
    parameters = tuple(
        Column(_column(effect, parameter), "S16" if parameter.type is str else "f8", parameter.unit)
        for effect, parameter in _recorded(settings)
    )
    return counts + parameters


def _making(settings: NoiseSettings) -> list[str]:
    """The effects that make points."""
    return [name for name in blocks(settings) if EFFECTS[name].stage == "points"]


def _recorded(settings: NoiseSettings) -> list[tuple[str, Parameter]]:
    """(effect, parameter) of every parameter that a configuration has."""
    return [(name, one) for name in blocks(settings) for one in EFFECTS[name].parameters]


def _count(effect: str) -> str:
    return f"points.{effect}"


def _column(effect: str, parameter: Parameter) -> str:
    return f"noise.{effect}.{parameter.name}"
