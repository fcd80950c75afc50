"""Parameters that are a number or a distribution."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.distribution import as_override, parse


@given(low=st.floats(0, 5), width=st.floats(0, 5), seed=st.integers(0, 99))
def test_uniform_stays_in_its_interval(low, width, seed):
    drawn = parse({"uniform": [low, low + width]}).draw(np.random.default_rng(seed))
    assert low <= drawn <= low + width


def test_choice_gives_only_and_all_of_its_values():
    rng = np.random.default_rng(0)
    chosen = {parse({"choice": [1, 2, 4]}).draw(rng) for _ in range(100)}
    assert chosen == {1, 2, 4}


def test_normal_is_clipped_to_the_parameters_limits():
    rng = np.random.default_rng(0)
    values = [parse({"normal": [0.1, 1.0]}, 0, 1).draw(rng) for _ in range(500)]
    assert min(values) == 0
    assert max(values) == 1
    unlimited = [parse({"normal": [3.0, 2.0]}).draw(rng) for _ in range(4000)]
    assert np.mean(unlimited) == pytest.approx(3, abs=0.15)
    assert np.std(unlimited) == pytest.approx(2, abs=0.15)


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (-0.1, "must lie in [0, 1]"),
        (float("nan"), "finite"),
        (float("inf"), "finite"),
        ("much", "must be a number"),
        (True, "must be a number"),
        ({"uniform": [0.5, 0.1]}, "low 0.5 > high 0.1"),
        ({"uniform": [0.5]}, "two numbers"),
        ({"uniform": [0.5, 1.5]}, "must lie in"),
        ({"uniform": 3}, "takes a list"),
        ({"choice": []}, "at least one"),
        ({"normal": [0.5, -1]}, "std >= 0"),
        ({"gamma": [1, 2]}, "must be a number"),
        ({"uniform": [0, 1], "normal": [0, 1]}, "both given"),
        ({"uniform": None}, "must be a number"),
    ],
)
def test_bad_values_are_refused_with_a_reason(value, said):
    with pytest.raises(ValueError, match=said.replace("[", r"\[").replace("]", r"\]")):
        parse(value, 0, 1)


def test_plain_form_reads_back():
    for value in (0.5, {"uniform": [0.1, 0.2]}, {"choice": [0.1, 1.0]}, {"normal": [0.5, 0.1]}):
        assert parse(value).plain() == value


def test_an_override_replaces_the_form_that_was_configured():
    word = as_override("noise.background.density={normal: [0.1, 0.02]}")
    assert word == "++noise.background.density={uniform:null,choice:null,normal: [0.1, 0.02]}"
    swept = as_override("resample.rate={uniform:[0.1,0.2]},{choice:[1]}")
    assert swept.count("null") == 4
    for other in ("seed=3", "noise.background.density=0.1,0.5", "-m", "scenes.root=/a{b}"):
        assert as_override(other) == other
