"""What is wrong with the declaration of an effect of another package."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any, get_args

from pydantic import TypeAdapter

from ...common.distribution import Distribution
from ..imaging.artefacts import ARTEFACTS
from ..imaging.effect import Effect, EffectSettings, Scope, Stage


def check_effect(effect: Any) -> None:
    """Raise ValueError, one line, for an effect that declares something wrong."""
    if not isinstance(effect, Effect):
        raise ValueError(f"is a {type(effect).__name__}; give an Effect")
    for problem in _declared_wrong(effect):
        raise ValueError(problem)


def _declared_wrong(effect: Effect) -> Iterator[str]:
    """A line for each wrong declaration."""
    for name, value, allowed in (
        ("stage", effect.stage, get_args(Stage)),
        ("artefact", effect.artefact, (*ARTEFACTS, None)),
        ("scope", effect.scope, get_args(Scope)),
    ):
        if value not in allowed:
            yield f"{name}={value!r}: give one of {', '.join(map(str, allowed))}"
    if effect.moves and effect.stage != "points":
        yield f"moves=True: is for stage points, not {effect.stage}"
    settings = effect.settings
    is_settings = isinstance(settings, type) and issubclass(settings, EffectSettings)
    if not is_settings or not hasattr(settings, "__pydantic_fields__"):
        yield "settings: give a class of EffectSettings, decorated as @dataclass of pydantic"
        return
    yield from _parameters_wrong(settings)
    yield from _signature_wrong(effect)


def _parameters_wrong(settings: type[EffectSettings]) -> Iterator[str]:
    """What is wrong with the parameters that the settings of an effect declare."""
    for item in fields(settings):
        if item.name == "enabled":
            continue
        if not item.metadata:
            yield f"settings.{item.name}: give its default as parameter(...), which is recorded"
            return
    try:
        stated = _validated_defaults(settings)
    except Exception as error:
        yield f"settings: its own defaults are refused ({' '.join(str(error).split())[:160]})"
        return
    for item in fields(settings):
        kind = item.metadata.get("type")
        value = getattr(stated, item.name)
        if kind is float and not isinstance(value, Distribution):
            yield (
                f"settings.{item.name}: annotate it as AnyNumber, NonNegative, Positive or "
                f"Fraction, which may be drawn; {item.type} may not"
            )
        if kind is str and not isinstance(value, str):
            yield f"settings.{item.name}: its default is text, so annotate it as a Literal of words"


def _validated_defaults(settings: type[EffectSettings]) -> EffectSettings:
    """The defaults with the limits of their annotations, as if a configuration had given them."""
    values = {
        item.name: item.default.plain() if isinstance(item.default, Distribution) else item.default
        for item in fields(settings)
        if item.metadata
    }
    validated: EffectSettings = TypeAdapter(settings).validate_python(values)
    return validated


def _signature_wrong(effect: Effect) -> Iterator[str]:
    """Which functions of an effect do not take its parameters."""
    names = {item.name: None for item in effect.parameters}
    functions: dict[str, tuple[Callable[..., Any] | None, int]] = {
        "function": (effect.function, 3),
        "systematic": (effect.systematic, 3),
        "expected": (effect.expected, 3),
        "realised": (effect.realised, 3),
    }
    for name, (function, count) in functions.items():
        if function is None and name != "function":
            continue
        try:
            inspect.signature(function).bind(*[None] * count, **names)  # type: ignore[arg-type]
        except (TypeError, ValueError) as error:
            yield (f"{name}: must take (subject, context, rng, *, {', '.join(names)}) ({error})")
