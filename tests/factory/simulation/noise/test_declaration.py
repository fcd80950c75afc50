"""The declarations of effects of other packages are checked when they are registered."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic.dataclasses import dataclass

from simnfnd.factory.common.distribution import NonNegative
from simnfnd.factory.common.settings import STRICT
from simnfnd.factory.simulation.imaging.effect import Effect, EffectSettings, parameter
from simnfnd.factory.simulation.noise.declaration import check_effect
from simnfnd.factory.simulation.noise.registry import EFFECTS, register_effect


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


@plain_dataclass
class PlainSettings:
    """No settings of an effect."""

    gain: float = 0.5


def scaled(field: Any, ping: Any, rng: Any, *, gain: float) -> Any:
    return field * np.float32(gain)


GAIN = Effect(GainSettings, scaled, stage="beam", artefact="gains", name="own_gain")


def doing(function: Callable[..., Any], stage: Any = "beam") -> Effect:
    return replace(GAIN, function=function, stage=stage)


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


def test_the_effects_that_ship_pass() -> None:
    for name in ("background", "receiver", "beam_gain"):
        check_effect(EFFECTS[name])


def test_a_checked_effect_can_be_sent_to_workers() -> None:
    check_effect(GAIN)
    assert pickle.loads(pickle.dumps(GAIN)) == GAIN
