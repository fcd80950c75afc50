"""Parameters that are a number, or are drawn anew for every sample.

In a config a parameter is written as `0.3`, `{uniform: [0.1, 0.5]}`, `{choice: [1, 2, 4]}` or
`{normal: [mean, std]}`.  Draws are clipped to the parameter's own limits, which matters only for
the tails of `normal`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, PlainSerializer

_KINDS = ("uniform", "choice", "normal")
_FORMS = "a number, {uniform: [low, high]}, {choice: [a, b, ...]} or {normal: [mean, std]}"


@dataclass(frozen=True)
class Distribution:
    """What a parameter's value is drawn from.

    kind: "number", "uniform", "choice" or "normal"; values: its numbers, in the parameter's unit.
    low, high: limits that no draw leaves.
    """

    kind: str
    values: tuple[float, ...]
    low: float = -math.inf
    high: float = math.inf

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        if self.kind == "number":
            value = self.values[0]
        elif self.kind == "uniform":
            value = float(rng.uniform(self.values[0], self.values[1]))
        elif self.kind == "choice":
            value = self.values[int(rng.integers(len(self.values)))]
        else:
            value = float(rng.normal(self.values[0], self.values[1]))
        return min(max(value, self.low), self.high)

    def plain(self) -> float | dict[str, list[float]]:
        """As it is written in a config."""
        return self.values[0] if self.kind == "number" else {self.kind: list(self.values)}


def parse(value: Any, low: float = -math.inf, high: float = math.inf) -> Distribution:
    """Read a parameter as written in a config.

    Raises ValueError when the form is unknown or a number lies outside [low, high].
    """
    if isinstance(value, Distribution):
        kind = value.kind
        numbers = value.values
    elif isinstance(value, Mapping):
        present = {str(kind): given for kind, given in value.items() if given is not None}
        if len(present) > 1:
            raise ValueError(
                f"{' and '.join(present)} are both given; where one file overrides another, set "
                "the form that goes to null"
            )
        kind, given = next(iter(present.items()), ("", 0))
        if kind not in _KINDS:
            raise ValueError(f"must be {_FORMS}")
        if isinstance(given, str) or not hasattr(given, "__iter__"):
            raise ValueError(f"{kind} takes a list; write {_FORMS}")
        numbers = tuple(_number(item) for item in given)
    else:
        kind = "number"
        numbers = (_number(value),)
    if kind in ("uniform", "normal") and len(numbers) != 2:
        raise ValueError(f"{kind} takes two numbers, got {len(numbers)}")
    if kind == "choice" and not numbers:
        raise ValueError("choice takes at least one number")
    if kind == "uniform" and numbers[0] > numbers[1]:
        raise ValueError(f"uniform takes [low, high], got low {numbers[0]:g} > high {numbers[1]:g}")
    if kind == "normal" and numbers[1] < 0:
        raise ValueError(f"normal takes [mean, std] with std >= 0, got {numbers[1]:g}")
    for number in numbers[:1] if kind == "normal" else numbers:
        if not low <= number <= high:
            left = "(-inf" if math.isinf(low) else f"[{low:g}"
            right = "inf)" if math.isinf(high) else f"{high:g}]"
            raise ValueError(f"must lie in {left}, {right}, got {number:g}")
    return Distribution(kind, numbers, low, high)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"must be {_FORMS}, got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"must be finite, got {value}")
    return float(value)


def _within(low: float, high: float) -> BeforeValidator:
    return BeforeValidator(lambda value: parse(value, low, high))


_plain = PlainSerializer(lambda distribution: distribution.plain())

AnyNumber = Annotated[Distribution, _within(-math.inf, math.inf), _plain]
NonNegative = Annotated[Distribution, _within(0.0, math.inf), _plain]
Fraction = Annotated[Distribution, _within(0.0, 1.0), _plain]
Positive = Annotated[Distribution, _within(1e-6, math.inf), _plain]
# A rate of 0 would keep no point at all; the limit is far below any use.
PositiveFraction = Annotated[Distribution, _within(1e-6, 1.0), _plain]


def number(value: float) -> Distribution:
    """The distribution that always gives `value`; for defaults."""
    return Distribution("number", (float(value),))


def as_override(word: str) -> str:
    """A command-line override whose distribution replaces the configured one.

    Hydra merges mappings: `density={normal: [1, 2]}` on a configured `{uniform: ...}` would be
    refused, or leave both.  The other forms are set to null, which `parse` takes as absent.
    """

    def alone(found: re.Match[str]) -> str:
        return "{" + "".join(f"{one}:null," for one in _KINDS if one != found[1]) + f"{found[1]}:"

    key, _, value = word.partition("=")
    replaced = re.sub(rf"\{{\s*({'|'.join(_KINDS)})\s*:", alone, value)
    return word if replaced == value else f"++{key.lstrip('+')}={replaced}"
