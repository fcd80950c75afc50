"""The configuration: YAML and dataclasses agree, recipes compose, mistakes are one line."""

import re

import numpy as np
import pytest
import yaml
from hydra import compose, initialize_config_module
from hypothesis import given
from hypothesis import strategies as st
from omegaconf import OmegaConf
from pydantic import TypeAdapter

from simnfnd.factory.common.distribution import as_override, parse
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.workers.settings import SchedulerSettings
from simnfnd.factory.dataset.schema import config_hash as digest
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.config.root import from_mapping, plain
from simnfnd.factory.simulation.noise.registry import NoiseSettings
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from tests import remembered_configurations, sonar_presets
from tests.project_files import ROOT

CONF = ROOT / "conf"


def composed(*overrides: str):
    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        return OmegaConf.to_container(compose("factory", list(overrides)), resolve=True)


def config(*overrides: str):
    values = composed(*overrides)
    values.pop("experiment", None)
    return from_mapping(values)


@pytest.mark.parametrize("words", [(), ("experiment=any_sonar", "sonar=didson_hf", "seed=3")])
def test_what_tests_remember_is_what_hydra_composes(words, monkeypatch):
    remembered = [composed(*words) for _ in range(2)]
    remembered_configurations.forget(monkeypatch)
    assert remembered == [composed(*words)] * 2


def names(group: str) -> list[str]:
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


@pytest.mark.parametrize("sonar", sonar_presets.NAMES)
def test_every_sonar_composes(sonar):
    device = sonar_presets.sonar_preset(sonar)
    assert device.name == sonar
    assert len(device.beam_centres_rad()) == device.beams


def test_a_sonar_alone_is_that_of_the_whole_configuration():
    assert config("sonar=didson_hf").sonar == sonar_presets.sonar_preset("didson_hf")


@pytest.mark.slow
@pytest.mark.parametrize("group", ["render", "noise", "resample", "scenes", "acoustics", "devices"])
def test_every_choice_of_a_group_composes(group):
    for name in names(group):
        missing = ["scenes.root=somewhere"] if group == "scenes" and name != "seabed" else []
        if (group, name) == ("scenes", "mesh"):
            missing = ["scenes.file=world.glb"]
        if (group, name) == ("scenes", "csv_list"):
            continue  # has no defaults for the intrinsics; tests of the reader cover it
        # Effects of the complex field need it; those of points do not.
        text = (CONF / group / f"{name}.yaml").read_text()
        field = ["acoustics=coherent"] if group == "noise" and "speckle:" in text else []
        # Effects of both formations are for drawn devices, each of which has one of them.
        drawn = ["devices=any_sonar"] if (group, name) == ("noise", "any_sonar") else []
        if (group, name) in (("devices", "any_sonar"), ("devices", "varied")):
            drawn = ["acoustics=coherent", "noise=physical"]
        if group == "acoustics" and name in ("coherent", "field"):
            field = ["noise=physical"]
        config(f"{group}={name}", *missing, *field, *drawn)


@pytest.mark.parametrize("experiment", names("experiment"))
def test_every_experiment_composes(experiment):
    first = (CONF / "experiment" / f"{experiment}.yaml").read_text().splitlines()[1]
    if first.startswith("# simnfnd train "):
        return  # tests/models/data composes it
    values = composed(f"experiment={experiment}")
    if values["scenes"]["kind"] == "flsea":
        values["scenes"]["root"] = "somewhere"
    values.pop("experiment", None)
    assert from_mapping(values).dataset.name.startswith(
        re.sub("^(benchmark|demo)_", r"\1-", experiment)
    )


def test_defaults_in_python_and_in_yaml_are_the_same(monkeypatch):
    """Every value: a configuration that names nothing is the one that the files make."""
    monkeypatch.delenv("SIMNFND_CACHE", raising=False)
    assert plain(config()) == plain(from_mapping({"scenes": {"kind": "seabed"}}))


@pytest.mark.parametrize(
    ("settings", "file"),
    [
        (SonarSettings, "sonar/camera_matched.yaml"),
        (NoiseSettings, "noise/simnfnd.yaml"),
        (DatasetSettings, "dataset/default.yaml"),
        (SchedulerSettings, "scheduler/local.yaml"),
    ],
)
def test_the_default_files_list_every_key(settings, file):
    def keys(values, prefix=""):
        for key, value in values.items():
            if isinstance(value, dict) and not set(value) & {"uniform", "choice", "normal"}:
                yield from keys(value, f"{prefix}{key}.")
            else:
                yield prefix + key

    written = set(keys(yaml.safe_load((CONF / file).read_text())))
    declared = set(keys(TypeAdapter(settings).dump_python(settings(), mode="json")))
    assert written == declared


@pytest.mark.slow
def test_equal_settings_have_one_digest_and_others_another():
    base = digest(identity(config()))
    assert digest(identity(config("resample.rate={uniform:[0.35,0.9]}"))) == base
    assert digest(identity(config("scheduler.workers=3", "dataset.dir=/elsewhere"))) == base
    assert digest(identity(config("seed=1"))) != base
    assert digest(identity(config("noise.background.density=0.1"))) != base
    first, second = (digest(identity(config("scenes=flsea", f"scenes.root={r}"))) for r in "ab")
    assert first == second
    fixed = config("sonar.range.auto=false")
    assert "windows_m" not in identity(fixed)["sonar"]["range"]
    several = config("sonar.range.auto=false", "sonar.range.windows_m=[[1,4],[2,5]]")
    assert digest(identity(several)) != digest(identity(fixed))


def test_plain_form_makes_the_same_configuration():
    first = config()
    assert from_mapping(plain(first)) == first


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"noise": {"background": {"density": -1}}}, "noise.background.density: must lie in [0"),
        ({"resample": {"rate": 0}}, "resample.rate: must lie in"),
        ({"frames": {"variants": 0}}, "frames.variants"),
        ({"seed": -1}, "seed: "),
        ({"scenes": {"kind": "mars"}}, "scenes: "),
        ({"scheduler": {"workers": -1}}, "scheduler.workers: "),
        ({"scenes": {"kind": "seabed", "locations": 0}}, "scenes.locations: "),
        ({"scenes": {"kind": "flsea"}}, "scenes.root: "),
        ({"dataset": {"compression": "bzip2"}}, "dataset.compression: "),
        ({"dataset": {"name": "../evil"}}, "dataset"),
        ({"dataset": {"dirr": "x"}}, "dataset.dirr: unknown key"),
        ({"noise": {"speckle": {"looks": 0}}}, "noise.speckle.looks: "),
    ],
)
def test_mistakes_are_one_line_that_names_the_key(values, said):
    with pytest.raises(FactoryError) as caught:
        from_mapping({"scenes": {"kind": "seabed"}, **values})
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@given(low=st.floats(0, 5), width=st.floats(0, 5), seed=st.integers(0, 99))
def test_uniform_and_choice_stay_in_what_is_given(low, width, seed):
    rng = np.random.default_rng(seed)
    assert low <= parse({"uniform": [low, low + width]}).draw(rng) <= low + width
    assert {parse({"choice": [1, 2, 4]}).draw(rng) for _ in range(100)} == {1, 2, 4}


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
        ("much", "must be a number"),
        (True, "must be a number"),
        ({"uniform": [0.5, 0.1]}, "low 0.5 > high 0.1"),
        ({"uniform": [0.5, 1.5]}, "must lie in"),
        ({"uniform": 3}, "takes a list"),
        ({"choice": []}, "at least one"),
        ({"normal": [0.5, -1]}, "std >= 0"),
        ({"uniform": [0, 1], "normal": [0, 1]}, "both given"),
    ],
)
def test_bad_values_are_refused_with_a_reason(value, said):
    with pytest.raises(ValueError, match=said.replace("[", r"\[").replace("]", r"\]")):
        parse(value, 0, 1)


def test_an_override_replaces_the_form_that_was_configured():
    word = as_override("noise.background.density={normal: [0.1, 0.02]}")
    assert word == "++noise.background.density={uniform:null,choice:null,normal: [0.1, 0.02]}"
    swept = as_override("resample.rate={uniform:[0.1,0.2]},{choice:[1]}")
    assert swept.count("null") == 4
    for override in ("seed=3", "noise.background.density=0.1,0.5", "-m", "scenes.root=/a{b}"):
        assert as_override(override) == override


@pytest.mark.parametrize(
    ("word", "keys"),
    [
        ("sonar.range=10", ("sonar.range:", "sonar.range.auto", "sonar.range.max_m")),
        ("noise.azimuth=1", ("noise.azimuth:", "noise.azimuth.count")),
        ("frames=3", ("frames:", "frames.limit")),
    ],
)
def test_a_value_for_a_group_of_keys_names_the_keys(word: str, keys: tuple[str, ...]) -> None:
    with pytest.raises(FactoryError) as caught:
        config(word)
    assert all(key in str(caught.value) for key in keys)
