"""Limits of numeric keys: absurd numbers are refused by name, and no number runs for ever."""

from __future__ import annotations

import copy
import time
from collections.abc import Iterator
from functools import cache, reduce
from operator import getitem
from typing import Annotated, Any

import pytest
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from pydantic import TypeAdapter, ValidationError

from simnfnd.factory.common.distribution import parse
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.limits import limited
from simnfnd.factory.simulation.config.root import from_mapping
from simnfnd.factory.simulation.noise.registry import EFFECTS
from simnfnd.factory.simulation.pairs.pair_maker import make_pair, observe
from tests.constant_field import config, constant_field

Path = tuple[str | int, ...]
FORMS = {"uniform", "choice", "normal"}
# Configurations that together have every key of `simnfnd make`.
BASES = {
    "pointwise": ("noise.range_arc.count=1",),
    "coherent": ("experiment=physical",),
    "path speckle": ("experiment=physical", "noise=moving"),
    "recording": ("experiment=physical", "noise=recording", "scenes.frame_rate_hz=2"),
    "objects": (
        "scenes.frame_rate_hz=2",
        "scenes.moving_objects=[{length_m: 0.3, moving: {speed_m_s: 1}}]",
        "scenes.own_objects=[{file: a.glb, class: crate, scale: 1, tilt_deg: [0, 9]}]",
    ),
    "drawn devices": ("experiment=any_sonar",),
    "mesh": ("scenes=mesh", "scenes.file=a.obj", "scenes.frame_rate_hz=2"),
    "list": ("scenes=csv_list", "scenes.file=a.csv", "scenes.intrinsics=[9,9,9,9]"),
}
# Any number is right: of random streams, and bytes on a disk.
ANY_NUMBER = {"seed", "cache.max_bytes"}


@cache
def composed(words: tuple[str, ...]) -> Any:
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values = OmegaConf.to_container(compose("factory", list(words)), resolve=True)
    assert isinstance(values, dict)
    values.pop("experiment", None)
    return values


def numeric_keys(values: Any, path: Path = ()) -> Iterator[Path]:
    """The places of all numbers, and of all distributions of numbers."""
    if isinstance(values, dict):
        if len(values) == 1 and FORMS.intersection(values):
            yield path
            return
        for key, value in values.items():
            yield from numeric_keys(value, (*path, key))
    elif isinstance(values, list):
        for index, value in enumerate(values):
            yield from numeric_keys(value, (*path, index))
    elif isinstance(values, int | float) and not isinstance(values, bool):
        yield path


def changed(values: Any, path: Path, number: float) -> Any:
    result = copy.deepcopy(values)
    place = result
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = number
    return result


@pytest.mark.slow
def test_every_number_has_limits() -> None:
    tested = set(ANY_NUMBER)
    for words in BASES.values():
        values = composed(words)
        from_mapping(values)
        for path in numeric_keys(values):
            name = ".".join(map(str, path))
            if name in tested:
                continue
            tested.add(name)
            is_whole = isinstance(reduce(getitem, path, values), int)
            largest = 10**18 if is_whole else 1e300
            for number in (largest, -largest):
                with pytest.raises(FactoryError) as refusal:
                    from_mapping(changed(values, path, number))
                text = str(refusal.value)
                assert "\n" not in text
                assert name in text or ".".join(map(str, path[:-1])) in text, name
    assert len(tested) > 150


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("scenes.moving_objects.0.length_m=250", "mm?"),
        ("scenes.moving_objects.0.moving.speed_m_s=300", "mm/s?"),
        ("scenes.own_objects.0.scale=1e300", "[1e-06, 1e+06] m"),
        ("scenes.own_objects.0.tilt_deg.1=1e300", "[-180, 180] deg"),
        ("sonar.frequency_khz=900000", "Hz?"),
        ("sonar.frequency_khz=0.9", "MHz?"),
        ("sonar.hfov_deg=2.2", "radians?"),
        ("sonar.vfov_deg=0.35", "radians?"),
        ("sonar.array.beamwidth_deg=0.014", "radians?"),
        ("sonar.range.max_m=30000", "mm?"),
        ("water.salinity_psu=0.035", "kg of salt"),
        ("water.temperature_c=283", "K?"),
        ("noise.ring_down.decay_db_per_m=200000", "dB/km?"),
        ("devices.frequency_khz=900000", "Hz?"),
    ],
)
def test_a_number_in_another_unit_is_recognised(word: str, hint: str) -> None:
    key, _, number = word.partition("=")
    base = {"devices": "drawn devices", "scenes": "objects"}.get(key.split(".")[0], "coherent")
    path = tuple(int(step) if step.isdigit() else step for step in key.split("."))
    values = changed(composed(BASES[base]), path, float(number))
    with pytest.raises(FactoryError, match=key.replace(".", r"\.")) as refusal:
        from_mapping(values)
    assert hint in str(refusal.value)


@pytest.mark.parametrize(
    "sizes", [{"image": {"width_px": 8192, "height_px": 8192}}, {"beams": 8192, "range_bins": 8192}]
)
def test_images_that_no_shard_holds_are_refused(sizes: dict[str, Any]) -> None:
    with pytest.raises(FactoryError, match=r"sonar.*(pixels|raw samples)"):
        config(sonar=sizes)


def test_water_may_be_fresh() -> None:
    values = composed(BASES["coherent"])
    assert from_mapping(changed(values, ("water", "salinity_psu"), 0)).water.salinity_psu == 0


# Parameters that decide the length of a loop or the size of an array.
LOOPS = {
    "spokes": {"count": 1e6},
    "crosstalk": {"spacing_beams": 1e6},
    "comb_lines": {"spacing_m": 1e-6},
    "texture": {"patch_m": 1e-6},
    "speckle": {"looks": 1e6},
    "path_speckle": {"looks": 1e6},
    "beam_gain": {"dead": 1e6},
    "multipath": {"count": 1e6, "density": 1e6},
    "azimuth": {"count": 1e6, "density": 1e6},
    "range_arc": {"count": 1e6, "density": 1e6},
    "background": {"density": 1e6},
}


@pytest.mark.parametrize("effect", LOOPS)
def test_no_number_runs_for_ever(effect: str) -> None:
    """At the limit that a refusal names, an image takes seconds at most."""
    settings_class = EFFECTS[effect].settings
    parameters = {}
    for name, absurd in LOOPS[effect].items():
        with pytest.raises(FactoryError, match=f"noise.{effect}.{name}") as refusal:
            config(noise={effect: {name: absurd}})
        limits = str(refusal.value).split("[")[1].split("]")[0].split(", ")
        parameters[name] = float(limits[1] if absurd > 1 else limits[0])
    assert settings_class
    settings = config(noise={effect: parameters})
    observed = observe(*constant_field(size=(60, 40)), settings)
    began = time.process_time()
    make_pair(observed, 0, settings)
    assert time.process_time() - began < 20


def test_a_distribution_names_its_unit() -> None:
    with pytest.raises(ValueError, match=r"kHz.*did you give Hz\?"):
        parse({"uniform": [600, 900_000]}, 10, 10_000, "kHz")
    assert parse({"normal": [0, 1]}, 5, 9, or_zero=True).low == 0


def test_pages_with_sliders_see_the_limits() -> None:
    limits = limited(10, 10_000, "kHz")
    assert (limits.ge, limits.le) == (10, 10_000)
    checked = TypeAdapter(Annotated[float, limits])
    assert checked.validate_python(600) == 600
    with pytest.raises(ValidationError, match="kHz"):
        checked.validate_python(9.9)
