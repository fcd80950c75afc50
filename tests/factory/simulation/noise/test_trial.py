"""Effects of other packages are checked, and run once, before they make a dataset."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic.dataclasses import dataclass

from simnfnd.factory.common.distribution import Fraction, NonNegative
from simnfnd.factory.common.settings import STRICT
from simnfnd.factory.simulation.imaging.effect import Effect, EffectSettings, parameter
from simnfnd.factory.simulation.imaging.signal import Signal
from simnfnd.factory.simulation.noise.registry import EFFECTS, register_effect
from simnfnd.factory.simulation.noise.trial import BEAMS, RANGE_BINS, check_effect
from simnfnd.factory.simulation.sonar.polar import Echoes


@dataclass(frozen=True, config=STRICT)
class GainSettings(EffectSettings):
    """gain: in amplitude."""

    gain: NonNegative = parameter({"uniform": [0.5, 0.8]})


@dataclass(frozen=True, config=STRICT)
class FloatSettings(EffectSettings):
    """gain: of a type that cannot be drawn."""

    gain: float = parameter(0.5)


@dataclass(frozen=True, config=STRICT)
class BareSettings(EffectSettings):
    """gain: not recorded."""

    gain: float = 0.5


@dataclass(frozen=True, config=STRICT)
class ShareSettings(EffectSettings):
    """share: 0 unless a user asks for more."""

    share: Fraction = parameter(0.0)


@plain_dataclass
class PlainSettings:
    """No settings of an effect."""

    gain: float = 0.5


def scaled(field: Any, ping: Any, rng: Any, *, gain: float) -> Any:
    return field * np.float32(gain)


GAIN = Effect(GainSettings, scaled, stage="beam", artefact="gains", name="own_gain")


def doing(function: Callable[..., Any], stage: Any = "beam") -> Effect:
    return replace(GAIN, function=function, stage=stage)


def with_nan(field: Any, ping: Any, rng: Any, *, gain: float) -> Any:
    field[..., 0] = np.nan
    return field


def failing(field: Any, ping: Any, rng: Any, *, gain: float) -> Any:
    raise KeyError("no such thing")


WRONG: dict[str, tuple[Any, str]] = {
    "no effect": (scaled, "Effect"),
    "artefact": (replace(GAIN, artefact="fog"), "artefact='fog'"),  # type: ignore[arg-type]
    "stage": (replace(GAIN, stage="picture"), "stage='picture'"),  # type: ignore[arg-type]
    "scope": (replace(GAIN, scope="ping"), "scope='ping'"),  # type: ignore[arg-type]
    "moves": (replace(GAIN, moves=True), "moves"),
    "plain settings": (replace(GAIN, settings=PlainSettings), "settings"),  # type: ignore[arg-type]
    "type of a parameter": (replace(GAIN, settings=FloatSettings), "settings.gain"),
    "no parameter": (replace(GAIN, settings=BareSettings), "settings.gain"),
    "signature": (doing(lambda field, ping, rng: field), "gain"),
    "nothing": (doing(lambda field, ping, rng, gain: field), "changes nothing"),
    "NaN": (doing(with_nan), "NaN"),
    "None": (doing(lambda field, ping, rng, gain: None), "NoneType"),
    "shape": (doing(lambda field, ping, rng, gain: field[0] * 2), "shape"),
    "complex": (doing(lambda field, ping, rng, gain: field * 2j), "complex"),
    "error": (doing(failing), "KeyError"),
    "echoes": (doing(scaled, "points"), "float"),
    "signal": (doing(lambda signal, ping, rng, gain: signal.field, "echo"), "Signal"),
    "expected": (
        replace(GAIN, expected=lambda expected, ping, rng: None),
        "expected: must take",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_at_registration(name: str) -> None:
    effect, said = WRONG[name]
    with pytest.raises(ValueError, match="effect") as caught:
        register_effect(effect)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "own_gain" not in EFFECTS


def test_sound_effects_of_each_stage_pass() -> None:
    check_effect(GAIN)
    check_effect(
        doing(lambda signal, ping, rng, gain: Signal(signal.power * 2, signal.field), "echo")
    )
    added = Echoes(*np.full((4, 3), 0.5, np.float32))
    check_effect(doing(lambda scene, window, rng, gain: added, "points"))


def test_an_effect_that_is_off_by_default_is_tried_at_its_limits() -> None:
    def dimmed(field: Any, ping: Any, rng: Any, *, share: float) -> Any:
        assert field.shape == (1, 2, RANGE_BINS, BEAMS)
        return field * np.float32(1 - share)

    check_effect(Effect(ShareSettings, dimmed, stage="image", name="dimmed"))


def test_the_effects_that_ship_pass() -> None:
    for name in ("background", "receiver", "beam_gain"):
        check_effect(EFFECTS[name])


def test_a_checked_effect_can_be_sent_to_workers() -> None:
    check_effect(GAIN)
    assert pickle.loads(pickle.dumps(GAIN)) == GAIN
