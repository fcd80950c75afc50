"""What files say of their numbers is true: grey values become levels, and pixels metres."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.dataset.card import source_terms, stated_licence
from simnfnd.factory.dataset.meaning import grey_meaning, pixel_meaning
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.labels.image_axes import image_axes
from simnfnd.factory.simulation.sonar import transfer

PROFILES = {"pointwise": "experiment=demo", "coherent": "experiment=demo_physical"}


def level_by_text(text: str, grey: float, full_scale: float) -> float:
    """The level that the stated formula gives for a grey value."""
    formula = re.search(r": (10 log10\(L\)|L) = (.*?);", text)
    assert formula is not None
    right = formula[2].replace("10 log10", "10 * log10").replace(" dB", "").replace("^", "**")
    right, _, definition = right.partition(" with R = ")
    names: dict[str, Any] = {"g": grey, "full_scale": full_scale, "log10": math.log10}
    if definition:
        names["R"] = eval(definition, {}, names)
    value = float(eval(right, {}, names))
    return 10 ** (value / 10) if formula[1] != "L" else value


@pytest.mark.parametrize("formation", PROFILES)
@pytest.mark.parametrize("kind", ["linear", "power", "log", "soft_log"])
def test_the_stated_formula_inverts_the_transfer_curve(formation: str, kind: str) -> None:
    config = compose_config((PROFILES[formation], f"sonar.transfer.kind={kind}"))
    text = grey_meaning(identity(config), "float32")
    full_scale = 0.37
    level = full_scale * np.array([0.2, 0.5, 0.9])
    if formation == "pointwise":
        shown = transfer.grey(level, full_scale, config.sonar.transfer, "intensity")
    else:
        shown = transfer.grey(np.sqrt(level), math.sqrt(full_scale), config.sonar.transfer)
    actual = [level_by_text(text, float(grey), full_scale) for grey in shown]
    np.testing.assert_allclose(actual, level, rtol=1e-4)
    assert ("clean_full_scale" in text) == (formation == "coherent")
    assert "g = v / 255" in grey_meaning(identity(config), "uint8")


def test_curves_that_are_drawn_are_left_to_the_table() -> None:
    drawn = identity(compose_config(["experiment=any_sonar", "scenes=seabed"]))
    curves: list[Any] = [None, "x", {"kind": []}, {"kind": "power"}]
    odd = [{"sonar": {"transfer": curve}, "noise": {}} for curve in curves]
    for config in (drawn, {}, *odd):
        assert "full_scale" not in grey_meaning(config, "uint8")


def test_the_stated_pixels_are_those_of_the_axes() -> None:
    fixed = "sonar.range={auto: false, min_m: 1, max_m: 6}"
    sonar = compose_config(["sonar=oculus_m750d_hf", fixed]).sonar
    ahead, right = image_axes(sonar)
    text = pixel_meaning("fan", len(right.values))
    names: dict[str, Any] = {
        "range_max_m": 6.0,
        "metres_per_pixel": ahead.values[0] - ahead.values[1],
        "row": np.arange(len(ahead.values)),
        "column": np.arange(len(right.values)),
    }
    for axis, name in ((ahead, "ahead_m"), (right, "right_m")):
        formula = re.search(rf"{name} = (.*?);", text)
        assert formula is not None
        np.testing.assert_allclose(eval(formula[1], {}, names), axis.values, atol=1e-9)


def test_procedural_scenes_bring_their_own_licence() -> None:
    procedural = identity(compose_config(["experiment=demo"]))
    assert stated_licence(None, procedural) == "apache-2.0"
    assert stated_licence("CC-BY-4.0", procedural) == "CC-BY-4.0"
    assert "procedural" in source_terms(procedural)
    for config in ({}, {"scenes": {"kind": "flsea"}}, {"scenes": "x"}):
        assert stated_licence(None, config) is None
        assert "terms of the source images" in source_terms(config)
