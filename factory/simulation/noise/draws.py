"""The noise of one sample: drawn parameters, random streams, and what the record says of them.

Every effect and every parameter has a random stream of its own, so changing one leaves the draws of
the others as they are.  Drawn values, given again as numbers, make the same sample.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, dataclass
from functools import lru_cache
from typing import Any, NamedTuple

from ...common import seeds
from ...common.distribution import Distribution
from ...dataset.frame_ref import FrameRef
from ...dataset.schema import Column
from ..imaging.effect import DrawnEffect, Names, Value
from .registry import EFFECTS, NoiseSettings, blocks


class StreamNames(NamedTuple):
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


@dataclass(frozen=True)
class Draws:
    """All effects of one sample, in the order in which they act, and what they were drawn from."""

    settings: NoiseSettings
    effects: tuple[DrawnEffect, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the effects."""
        return tuple(effect.name for effect in self.effects)

    def row(self, added: Mapping[str, int]) -> dict[str, Value]:
        """The values of `columns`; NaN or "" where an effect is off.

        added: number of points by the name of the effect that added them.
        """
        drawn = {effect.name: effect.parameters for effect in self.effects}
        row: dict[str, Value] = {
            f"points.{name}": added.get(name, 0) for name in _point_effects(self.settings)
        }
        for effect, parameter in _all_parameters(self.settings):
            missing = "" if parameter.metadata["type"] is str else float("nan")
            value = drawn.get(effect, {}).get(parameter.name, missing)
            row[f"noise.{effect}.{parameter.name}"] = value
        return row


def draw(
    settings: NoiseSettings, seed: int, names: StreamNames, *, continuous: bool = False
) -> Draws:
    """The parameters of every enabled effect for one sample.

    continuous: whether the samples of a recording share their parameters.  Whether they share
        random streams depends on the scope of each effect alone.
    """
    drawn = []
    for name, block in blocks(settings).items():
        if block.enabled:
            effect = EFFECTS[name]
            own: Names = getattr(names, effect.scope)
            shared = names.recording if continuous else own
            values = {
                parameter.name: _value(
                    getattr(block, parameter.name), seed, name, parameter.name, *shared
                )
                for parameter in effect.parameters
            }
            drawn.append(DrawnEffect(name, effect, values, seed, own))
    return Draws(settings, tuple(drawn))


@lru_cache(maxsize=1024)  # the frames of a recording share many
def _value(configured: Distribution | str, seed: int, *names: str | int) -> Value:
    if isinstance(configured, str):
        return configured
    if configured.kind == "number":
        return configured.values[0]
    return configured.draw(seeds.stream(seed, "parameter", *names))


def columns(settings: NoiseSettings) -> tuple[Column, ...]:
    """Columns of the sample table: points of each effect that makes some, then all parameters."""
    counts = tuple(
        Column(f"points.{name}", "i8", "1", f"points that {name} added or moved")
        for name in _point_effects(settings)
    )
    return counts + tuple(
        Column(
            f"noise.{effect}.{parameter.name}",
            "S16" if parameter.metadata["type"] is str else "f8",
            parameter.metadata["unit"],
        )
        for effect, parameter in _all_parameters(settings)
    )


def _point_effects(settings: NoiseSettings) -> list[str]:
    """The names of the effects that add or move points."""
    return [name for name in blocks(settings) if EFFECTS[name].stage == "points"]


def _all_parameters(settings: NoiseSettings) -> list[tuple[str, Field[Any]]]:
    """(effect, parameter) of every parameter that a configuration has."""
    return [
        (name, parameter) for name in blocks(settings) for parameter in EFFECTS[name].parameters
    ]
