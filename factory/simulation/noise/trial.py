"""What is wrong with an effect of another package: what it declares, and what it does once.

It is run on one small ping before it makes a dataset, so that its author reads one line at once
and not a traceback after minutes of rendering.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any, get_args

import numpy as np
from pydantic import TypeAdapter

from ...common.array_types import Float32s
from ...common.distribution import Distribution
from ...dataset.frame_ref import FrameRef
from ..frames.frame import Frame, Intrinsics
from ..imaging.artefacts import ARTEFACTS
from ..imaging.effect import Effect, EffectSettings, Scope, Stage, Value
from ..imaging.expected import Expected
from ..imaging.settings import CoherentSettings
from ..imaging.signal import Ping, Signal
from ..render.base import Rendered
from ..sonar.array import WaterSettings
from ..sonar.polar import Echoes
from ..sonar.settings import SonarSettings
from ..sonar.surface import LitSurface
from ..sonar.window import Window

Rng = np.random.Generator

BEAMS = 32
RANGE_BINS = 48
_POINTS = 400
_TRIES = 6
_WINDOW = Window("slant_range", 1.0, 6.0, -0.35, 0.35)


def check_effect(effect: Any) -> None:
    """Raise ValueError, one line, for an effect that declares or does something wrong."""
    if not isinstance(effect, Effect):
        raise ValueError(f"is a {type(effect).__name__}; give an Effect")
    for problem in _declared_wrong(effect):
        raise ValueError(problem)
    try:
        _run(effect)
    except _Wrong as problem:
        raise ValueError(f"on a field of {RANGE_BINS} x {BEAMS} bins it {problem}") from problem
    except Exception as error:  # the code of another package
        raise ValueError(
            f"fails on a field of {RANGE_BINS} x {BEAMS} bins ({type(error).__name__}: {error})"
        ) from error


class _Wrong(Exception):
    """What an effect does that no effect may do."""


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


def _run(effect: Effect) -> None:
    """Run the effect until it changes something.  Raises _Wrong."""
    changed = False
    for number in range(_TRIES):
        rng = np.random.default_rng(number)
        parameters = _drawn(effect, rng, widest=number >= _TRIES // 2)
        changed = _changes(effect, rng, parameters)
        if changed:
            break
    if not changed:
        raise _Wrong("changes nothing, with its defaults and with the ends of their limits")
    if effect.stage != "points":
        for change in (effect.systematic, effect.expected, effect.realised):
            if change is not None:
                _check_expected(change, parameters)


def _drawn(effect: Effect, rng: Rng, *, widest: bool) -> dict[str, Value]:
    """Draw parameters by their defaults.

    widest: take the upper end of a parameter's limits instead, where it has one.
    """
    defaults = _validated_defaults(effect.settings)
    values: dict[str, Value] = {}
    for item in effect.parameters:
        stated = getattr(defaults, item.name)
        if not isinstance(stated, Distribution):
            values[item.name] = stated
        elif widest and np.isfinite(stated.high):
            values[item.name] = stated.high
        else:
            values[item.name] = stated.draw(rng)
    return values


def _changes(effect: Effect, rng: Rng, parameters: Mapping[str, Value]) -> bool:
    """Whether the effect changes its subject.  Raises _Wrong for what is no such subject."""
    if effect.stage == "points":
        scene = _echoes(rng)
        result = effect.function(_echoes_copy(scene), _WINDOW, rng, **parameters)
        _check_echoes(result)
        if not effect.moves:
            return len(result) > 0
        pairs = zip(vars(scene).values(), vars(result).values(), strict=True)
        return any(not np.array_equal(before, after) for before, after in pairs)
    ping = _ping()
    field = rng.normal(size=(1, 2, RANGE_BINS, BEAMS)).astype(np.float32)
    if effect.stage == "echo":
        signal = Signal(np.square(field[0, 0]), field)
        after = effect.function(Signal(signal.power.copy(), field.copy()), ping, rng, **parameters)
        if not isinstance(after, Signal):
            raise _Wrong(f"returns {type(after).__name__}; stage echo returns a Signal")
        _check_array("power", after.power, signal.power.shape)
        _check_array("field", after.field, field.shape, looks=True)
        return not (
            np.array_equal(after.power, signal.power) and np.array_equal(after.field, field)
        )
    changed = effect.function(field.copy(), ping, rng, **parameters)
    _check_array("field", changed, field.shape)
    return not np.array_equal(changed, field)


def _check_echoes(result: Any) -> None:
    if not isinstance(result, Echoes):
        raise _Wrong(f"returns {type(result).__name__}; stage points returns Echoes")
    for name, values in vars(result).items():
        _check_array(name, values, (len(result),))


def _check_array(name: str, values: Any, shape: tuple[int, ...], *, looks: bool = False) -> None:
    """Raise _Wrong unless `values` are finite floats of this shape.

    looks: whether the first size may differ, as that of independent looks.
    """
    if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
        kind = values.dtype if isinstance(values, np.ndarray) else type(values).__name__
        raise _Wrong(f"returns {name} as {kind}; give an array of float32")
    expected = (values.shape[0], *shape[1:]) if looks and values.ndim == len(shape) else shape
    if values.shape != expected:
        raise _Wrong(f"returns {name} of shape {values.shape}; expected {shape}")
    if not np.isfinite(values).all():
        raise _Wrong(f"returns {name} with NaN or infinite values")


def _check_expected(change: Callable[..., None], parameters: Mapping[str, Value]) -> None:
    plane = np.full((RANGE_BINS, BEAMS), 0.5, np.float32)
    expected = Expected(plane, plane.copy(), plane.copy(), plane.copy())
    change(expected, _ping(), np.random.default_rng(0), **parameters)
    for name in ("echo", "noise", "steady", "textured"):
        _check_array(f"expected {name}", getattr(expected, name), (RANGE_BINS, BEAMS))


def _echoes(rng: Rng) -> Echoes:
    """Points all over the window."""
    range_m = rng.uniform(_WINDOW.range_min_m, _WINDOW.range_max_m, _POINTS)
    azimuth_rad = rng.uniform(_WINDOW.azimuth_min_rad, _WINDOW.azimuth_max_rad, _POINTS)
    elevation_rad = rng.uniform(-0.2, 0.2, _POINTS)
    columns = (range_m, azimuth_rad, elevation_rad, rng.random(_POINTS))
    return Echoes(*(column.astype(np.float32) for column in columns))


def _echoes_copy(echoes: Echoes) -> Echoes:
    return Echoes(*(values.copy() for values in vars(echoes).values()))


def _ping() -> Ping:
    """A level ground that a small sonar looks at."""
    rows = np.arange(48)[:, None] / 48
    depth_m: Float32s = np.broadcast_to(np.float32(1.5) / (0.25 + 0.5 * rows), (48, 64)).astype(
        np.float32
    )
    frame = Frame(
        FrameRef("", "trial", "0"),
        np.full((48, 64, 3), 128, np.uint8),
        depth_m,
        Intrinsics(70.0, 70.0, 31.5, 23.5),
    )
    rendered = Rendered(np.full((48, 64), 0.05, np.float32), np.ones((48, 64), np.bool_))
    sonar = SonarSettings(beams=BEAMS, range_bins=RANGE_BINS)
    return Ping(
        LitSurface(frame, rendered, _WINDOW, sonar, conical=True),
        WaterSettings(),
        CoherentSettings(),
    )
