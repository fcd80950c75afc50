"""Parameters that are a number, or are drawn anew for every sample.

In a config a parameter is written as `0.3`, `{uniform: [0.1, 0.5]}`, `{choice: [1, 2, 4]}` or
`{normal: [mean, std]}`.  Draws are clipped to the parameter's own limits, which matters only for
the tails of `normal`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, PlainSerializer

from .limits import Limits

FORMS = ("uniform", "choice", "normal")
_WRITTEN_FORMS = "a number, {uniform: [low, high]}, {choice: [a, b, ...]} or {normal: [mean, std]}"


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
        """Draw one value."""
        if self.kind == "number":
            value = self.values[0]
        elif self.kind == "uniform":
            value = float(rng.uniform(self.values[0], self.values[1]))
        elif self.kind == "choice":
            value = self.values[int(rng.integers(len(self.values)))]
        else:
            value = float(rng.normal(self.values[0], self.values[1]))
        return min(max(value, self.low), self.high)

    def draws_only(self, value: float) -> bool:
        """Whether all draws give this value."""
        return self.kind in ("number", "choice", "uniform") and set(self.values) == {value}

    @property
    def largest(self) -> float:
        """The largest value that it draws; of a normal distribution, five deviations above."""
        if self.kind == "normal":
            mean, deviation = self.values
            return min(mean + 5 * deviation, self.high)
        return max(self.values)

    def mapped(self, change: Callable[[float], float]) -> Distribution:
        """The distribution whose numbers are changed; exact where `change` is a shift or scale."""
        spread = self.values[1:] if self.kind == "normal" else ()
        values = self.values[:1] if self.kind == "normal" else self.values
        return replace(self, values=(*map(change, values), *spread))

    def plain(self) -> float | dict[str, list[float]]:
        """The parameter as a config writes it."""
        return self.values[0] if self.kind == "number" else {self.kind: list(self.values)}


def parse(
    value: Any,
    low: float = -math.inf,
    high: float = math.inf,
    unit: str = "",
    *,
    or_zero: bool = False,
) -> Distribution:
    """Read a parameter as written in a config.

    unit, or_zero: see `limits.Limits`.

    Raises ValueError when the form is unknown or a number lies outside [low, high].
    """
    if isinstance(value, Distribution):
        kind = value.kind
        numbers = value.values
    elif isinstance(value, Mapping):
        kind, numbers = _parse_mapping(value)
    else:
        kind = "number"
        numbers = (_number(value),)
    _check_form(kind, numbers)
    # The deviation of a normal distribution is no value of the parameter.
    limited = numbers[:1] if kind == "normal" else numbers
    limits = Limits(low, high, unit, or_zero)
    for limited_number in limited:
        limits.check(limited_number)
    return Distribution(kind, numbers, 0.0 if or_zero else low, high)


def _parse_mapping(mapping: Mapping[Any, Any]) -> tuple[str, tuple[float, ...]]:
    """Return kind and numbers of `{kind: [...]}`; kinds set to null count as absent."""
    present = {str(kind): numbers for kind, numbers in mapping.items() if numbers is not None}
    if len(present) > 1:
        raise ValueError(
            f"{' and '.join(present)} are both given; where one file overrides another, set "
            "the form that is not wanted to null"
        )
    kind, numbers = next(iter(present.items()), ("", 0))
    if kind not in FORMS:
        raise ValueError(f"must be {_WRITTEN_FORMS}")
    if isinstance(numbers, str) or not hasattr(numbers, "__iter__"):
        raise ValueError(f"{kind} takes a list; write {_WRITTEN_FORMS}")
    return kind, tuple(_number(item) for item in numbers)


def _check_form(kind: str, numbers: tuple[float, ...]) -> None:
    """Raise ValueError unless the numbers suit the kind."""
    if kind in ("uniform", "normal") and len(numbers) != 2:
        raise ValueError(f"{kind} takes two numbers, got {len(numbers)}")
    if kind == "choice" and not numbers:
        raise ValueError("choice takes at least one number")
    if kind == "uniform" and numbers[0] > numbers[1]:
        raise ValueError(f"uniform takes [low, high], got low {numbers[0]:g} > high {numbers[1]:g}")
    if kind == "normal" and numbers[1] < 0:
        raise ValueError(f"normal takes [mean, std] with std >= 0, got {numbers[1]:g}")


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"must be {_WRITTEN_FORMS}, got {value!r}")
    if not math.isfinite(value):
        raise ValueError(f"must be finite, got {value}")
    return float(value)


def within(low: float, high: float, unit: str = "", *, or_zero: bool = False) -> BeforeValidator:
    """Return a validator for a key that holds a distribution.

    As in `Annotated[Distribution, within(0, 90, "deg"), as_written]`.
    unit, or_zero: see `limits.Limits`.
    """
    return BeforeValidator(lambda value: parse(value, low, high, unit, or_zero=or_zero))


as_written = PlainSerializer(lambda distribution: distribution.plain())

# Far beyond any use: a number without a limit can make a loop or an array without an end.
_FAR = 1e6

AnyNumber = Annotated[Distribution, within(-_FAR, _FAR), as_written]
NonNegative = Annotated[Distribution, within(0.0, _FAR), as_written]
Fraction = Annotated[Distribution, within(0.0, 1.0), as_written]
Positive = Annotated[Distribution, within(1e-6, _FAR), as_written]
Angle = Annotated[Distribution, within(-90.0, 90.0, "deg"), as_written]
# A rate of 0 would keep no point at all; the limit is far below any use.
PositiveFraction = Annotated[Distribution, within(1e-6, 1.0), as_written]

Decibels = Annotated[Distribution, within(-300.0, 300.0, "dB"), as_written]
NonNegativeDecibels = Annotated[Distribution, within(0.0, 300.0, "dB"), as_written]
DecibelsPerMetre = Annotated[Distribution, within(-100.0, 100.0, "dB/m"), as_written]
Share = Annotated[Distribution, within(0.0, 1.0), as_written]
Looks = Annotated[Distribution, within(1e-6, 64.0), as_written]
"""Number of looks; each takes a field of its own in memory."""
Altitude = Annotated[Distribution, within(0.01, 1000.0, "m"), as_written]
Strength = Annotated[Distribution, within(0.0, 1000.0), as_written]
"""Strength of points as a fraction of full scale."""
Density = Annotated[Distribution, within(0.0, 10.0), as_written]
"""Number of points as a fraction of the scene's points."""
Count = Annotated[Distribution, within(0.0, 1000.0), as_written]
"""How many of a thing an image shows; each costs time."""


def number(value: float) -> Distribution:
    """The distribution that always gives `value`; for defaults."""
    return Distribution("number", (float(value),))


def as_override(word: str) -> str:
    """Return a command-line override whose distribution replaces the configured one.

    Hydra merges mappings: `density={normal: [1, 2]}` on a configured `{uniform: ...}` would be
    refused, or would leave both.  Sets the other forms to null, which `parse` takes as absent.
    """
    key, _, value = word.partition("=")
    kind_in_mapping = rf"\{{\s*({'|'.join(FORMS)})\s*:"
    replaced = re.sub(kind_in_mapping, _with_other_kinds_null, value)
    if replaced == value:
        return word
    return f"++{key.lstrip('+')}={replaced}"


def _with_other_kinds_null(match: re.Match[str]) -> str:
    """Return `{other:null,...kind:` for a match of `{kind:`."""
    nulls = "".join(f"{kind}:null," for kind in FORMS if kind != match[1])
    return f"{{{nulls}{match[1]}:"
