"""Named keys that do nothing are refused, with what makes them act."""

from __future__ import annotations

import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.named_keys import named_keys


@pytest.mark.parametrize(
    ("words", "key", "remedy"),
    [
        (("noise=none", "noise.background.strength=0.4"), "noise.background.strength", "enabled"),
        (("sonar.range.max_m=10",), "sonar.range.max_m", "sonar.range.auto=false"),
        (("water=fresh",), "water", "acoustics=coherent"),
        (("sonar=didson_hf", "sonar.array.beamwidth_deg=1"), "sonar.array.beamwidth_deg", "set"),
        (("experiment=physical", "sonar.point_spread.beams=1"), "sonar.point_spread.beams", "set"),
        (("experiment=any_sonar", "sonar.beams=64"), "sonar.beams", "devices.beams"),
        (("split.test=[seabed-0000]", "split.test_fraction=0.5"), "split.test_fraction", "[]"),
    ],
)
def test_a_key_without_effect_is_refused_by_name(
    words: tuple[str, ...], key: str, remedy: str
) -> None:
    with pytest.raises(FactoryError) as caught:
        compose_config(words)
    assert str(caught.value).startswith(key)
    assert remedy in str(caught.value)


@pytest.mark.parametrize(
    "words",
    [
        ("sonar.range.auto=true", "sonar.range.max_m=2"),
        ("sonar.range={auto: false, max_m: 10}",),
        ("sonar=didson_hf",),
        ("noise.background.density={uniform: [0, 0.1]}", "noise.background.strength=0.2"),
    ],
)
def test_keys_that_act_are_taken(words: tuple[str, ...]) -> None:
    compose_config(words)


def test_a_mapping_names_each_of_its_keys_and_a_distribution_none() -> None:
    words = ["sonar.range={auto:false,max_m:9}", "-m", "resample.rate={uniform:[0.1,0.2]}"]
    words += ["~frames.total", "water=sea", "+scenes/objects=example"]
    assert named_keys(words) == ["sonar.range.auto", "sonar.range.max_m", "resample.rate", "water"]
