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

    def draws_only(self, value: float) -> bool:
        """Whether all draws give this value."""
        return self.kind in ("number", "choice", "uniform") and set(self.values) == {value}

    def mapped(self, change: Callable[[float], float]) -> Distribution:
        """The distribution whose numbers are changed; exact where `change` is a shift or scale."""
        spread = self.values[1:] if self.kind == "normal" else ()
        values = self.values[:1] if self.kind == "normal" else self.values
        return replace(self, values=(*map(change, values), *spread))

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
        kind, numbers = _parse_mapping(value)
    else:
        kind = "number"
        numbers = (_number(value),)
    _check_form(kind, numbers)
    # The deviation of a normal distribution is no value of the parameter.
    limited = numbers[:1] if kind == "normal" else numbers
    _check_limits(limited, low, high)
    return Distribution(kind, numbers, low, high)


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


def _check_limits(numbers: tuple[float, ...], low: float, high: float) -> None:
    """Raise ValueError for a number outside [low, high]."""
    for number in numbers:
        if not low <= number <= high:
            left = "(-inf" if math.isinf(low) else f"[{low:g}"
            right = "inf)" if math.isinf(high) else f"{high:g}]"
            raise ValueError(f"must lie in {left}, {right}, got {number:g}")


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"must be {_WRITTEN_FORMS}, got {value!r}")
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
Angle = Annotated[Distribution, _within(-90.0, 90.0), _plain]
# A rate of 0 would keep no point at all; the limit is far below any use.
PositiveFraction = Annotated[Distribution, _within(1e-6, 1.0), _plain]


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
