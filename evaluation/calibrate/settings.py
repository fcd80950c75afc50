"""Keys of `simnfnd evaluate fit`; the comments in conf/fit.yaml explain them."""

from __future__ import annotations

import math
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, field_validator, model_validator
from pydantic.dataclasses import dataclass

from ...factory.settings import STRICT
from ..settings import Grid

# What decides the renders, the frames or where things lie: not for a search over noise.
_FIXED = (
    "scenes", "render", "sonar.mount", "frames", "split", "seed", "dataset", "scheduler", "cache",
    "shard", "debug",
)  # fmt: skip


@dataclass(frozen=True, config=STRICT)
class Parameter:
    """What is searched for one key of the factory's configuration.

    low, high: limits of its value.  log: search the logarithm.  choices: instead of limits, the
    values to choose from.  spread: a number, or [low, high] to search it as well; above 0 the
    value is drawn for each sample, uniform from v - spread * (high - low) to v + spread * (high -
    low) within the limits, or from v / (1 + spread) to v * (1 + spread) with log.
    """

    low: float | None = None
    high: float | None = None
    log: bool = False
    choices: tuple[float | int | str | bool, ...] | None = None
    spread: float | tuple[float, float] = 0.0

    @model_validator(mode="after")
    def _whole(self) -> Self:
        (low, high), (least, most) = self.limits, self.spreads
        if self.choices is not None:
            if not self.choices or not math.isnan(low + high) or most:
                raise ValueError("choices: at least one, and neither low, high nor spread beside")
        elif not low < high or (self.log and low <= 0):
            raise ValueError("give choices, or low < high; log needs low > 0")
        elif not 0 <= least <= most:
            raise ValueError("spread must be a number from 0, or [low, high] with 0 <= low <= high")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """Of the value; NaN where there are none."""
        low, high = (math.nan if end is None else end for end in (self.low, self.high))
        return low, high

    @property
    def spreads(self) -> tuple[float, float]:
        """Limits of the spread; equal ones when it is not searched."""
        return self.spread if isinstance(self.spread, tuple) else (self.spread, self.spread)


@dataclass(frozen=True, config=STRICT)
class FitSettings:
    """Keys of `simnfnd evaluate fit`, as conf/fit.yaml explains them."""

    real: Annotated[str, Field(min_length=1)]
    parameters: dict[str, Parameter]
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")] = "fitted"
    recipe: tuple[str, ...] = ("experiment=physical",)
    frames: Annotated[int, Field(ge=8)] = 24
    grid: Grid = field(default_factory=Grid)
    trials: Annotated[int, Field(ge=1)] = 200
    startup: Annotated[int, Field(ge=1)] = 40
    seed: Annotated[int, Field(ge=0)] = 0
    out: str | None = None
    debug: bool = False

    @field_validator("parameters", mode="before")
    @classmethod
    def _flat(cls, tree: dict[str, Any]) -> dict[str, Any]:
        """Without the keys that are set to null."""
        return {key: value for key, value in flattened(tree).items() if value is not None}

    @model_validator(mode="after")
    def _searchable(self) -> Self:
        if not self.parameters:
            raise ValueError("parameters: name at least one key to search")
        for key in self.parameters:
            if f"{key}.".startswith(tuple(f"{fixed}." for fixed in _FIXED)):
                raise ValueError(
                    f"parameters.{key}: it decides what is rendered or where it goes, and cannot "
                    "be searched; set it in recipe"
                )
        return self

    @property
    def folder(self) -> Path:
        """Where the search and its result go."""
        return Path(self.out or Path("outputs", "fit", self.name))


_WORDS = {"low", "high", "log", "choices", "spread"}


def flattened(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested keys as dotted ones, as YAML and the command line may give either."""
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and not _WORDS & set(value):
            flat |= flattened(value, f"{name}.")
        else:
            flat[name] = value
    return flat
