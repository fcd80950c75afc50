"""`simnfnd evaluate fit`: a search that finds what was put in, and goes on where it stopped."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from PIL import Image

from simnfnd.command import main
from simnfnd.evaluation.calibrate import files as fit_files
from simnfnd.evaluation.calibrate import search as fit_search
from simnfnd.evaluation.calibrate.settings import FitSettings, flattened
from simnfnd.evaluation.calibrate.simulate import Simulation
from simnfnd.evaluation.realism.compare import overall
from simnfnd.evaluation.settings import Grid
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.cli.generate import run as generate
from simnfnd.factory.config import from_mapping, plain
from simnfnd.factory.distribution import parse
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.pairs import pair_maker
from simnfnd.factory.settings import build
from tests.project_files import ROOT

RECIPE = (
    "noise=none",
    "noise.background.enabled=true",
    "noise.background.density=0.02",
    "noise.background.strength=0.3",
    "scenes.locations=1",
    "scenes.frames_per_location=10",
    "scenes.width=96",
    "scenes.height=64",
    "sonar.image.layout=polar",
    "sonar.beams=64",
    "sonar.range_bins=96",
    "render=analytic",
    "scheduler=serial",
)
TRUE_DENSITY = 0.5
GRID = {"range_bins": 96, "beams": 64}


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of "real" pictures: the recipe's frames with another density; and its renders."""
    folder = tmp_path_factory.mktemp("fit")
    generate(compose_config([*RECIPE, f"dataset.dir={folder / 'data'}"]), [])
    (folder / "real").mkdir()
    config = compose_config([*RECIPE, f"noise.background.density={TRUE_DENSITY}", "seed=5"])
    maker = pair_maker(config)
    simulation = Simulation(RECIPE, 10, Grid(**GRID))
    lines = ["file,layout,hfov_deg"]
    for number, ref in enumerate(simulation.refs):
        (pair,) = maker.pairs(ref, (0,))
        Image.fromarray(pair.noisy).save(folder / "real" / f"{number}.png")
        lines.append(f"{number}.png,polar,45")
    for number in range(10):  # the search keeps every other block for itself
        shutil.copy(folder / "real" / f"{number}.png", folder / "real" / f"{number}b.png")
        lines.append(f"{number}b.png,polar,45")
    (folder / "real" / "geometry.csv").write_text("\n".join(lines) + "\n")
    return folder / "real"


def settings_for(real: Path, out: Path, **changes: object) -> FitSettings:
    values: dict[str, object] = {
        "real": str(real),
        "recipe": RECIPE,
        "name": "found",
        "frames": 10,
        "grid": GRID,
        "trials": 10,
        "startup": 5,
        "resamples": 3,
        "parameters": {"noise.background.density": {"low": 0.005, "high": 5, "log": True}},
        "out": str(out),
    }
    return build(FitSettings, {**values, **changes})


def test_the_density_that_made_the_pictures_is_found_again(real: Path, tmp_path: Path) -> None:
    settings = settings_for(real, tmp_path / "fit")
    result = fit_search.search(settings)
    density = result.values["noise.background.density"]
    assert TRUE_DENSITY / 2 < density < TRUE_DENSITY * 2
    before, after = (
        overall(part, "sim")["geometric_mean_ratio"] for part in next(iter(result.parts.values()))
    )
    assert after < 0.8 * before
    (_, held_out) = result.parts["10 real pictures kept from it"]
    assert overall(held_out, "sim")["geometric_mean_ratio"] < 0.85 * before
    # The files are a configuration that the factory takes as it stands.
    noise, recipe = fit_files.write(settings, result)
    content = yaml.safe_load(noise.read_text())
    assert content["background"]["density"] == density
    assert "10 trials" in noise.read_text().splitlines()[0]
    composed = plain(compose_config([*RECIPE, f"noise.background.density={density}"]))
    assert content == composed["noise"]
    told = yaml.safe_load(recipe.read_text())
    assert told["defaults"] == [{"override /noise": "found"}]
    assert told["sonar"]["beams"] == 64
    assert "scenes" not in told
    assert fit_files.usage(settings) == (
        "scenes.locations=1 scenes.frames_per_location=10 scenes.width=96 scenes.height=64 "
        "render=analytic scheduler=serial experiment=found"
    )
    # ... and as `--config-dir` gives them.
    again = subprocess.run(
        [
            *(sys.executable, "-m", "simnfnd.factory", "--config-dir", str(settings.folder)),
            *fit_files.usage(settings).split(),
            *("--cfg", "job"),
        ],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    assert from_mapping(_without(yaml.safe_load(again.stdout))).noise == result.config.noise
    assert from_mapping(_without(yaml.safe_load(again.stdout))).sonar == result.config.sonar


def _without(composed: dict[str, object]) -> dict[str, object]:
    return {key: value for key, value in composed.items() if key not in ("experiment", "hydra")}


def test_an_interrupted_search_goes_on_as_if_nothing_had_happened(
    real: Path, tmp_path: Path
) -> None:
    whole = fit_search.search(settings_for(real, tmp_path / "whole", trials=7))
    fit_search.search(settings_for(real, tmp_path / "parts", trials=3))
    # A trial that was asked for and never told is what a kill leaves behind.
    study = fit_search._study(settings_for(real, tmp_path / "parts"))
    study.ask()
    resumed = fit_search.search(settings_for(real, tmp_path / "parts", trials=7))
    assert resumed.values == whole.values
    for name, (_, after) in whole.parts.items():
        assert resumed.parts[name][1].equals(after)
    with pytest.raises(FactoryError, match="holds a search with other settings"):
        fit_search.search(settings_for(real, tmp_path / "parts", frames=8))


def test_what_cannot_be_searched_is_refused(real: Path, tmp_path: Path) -> None:
    number = {"low": 0.1, "high": 1}
    for parameters, said in (
        ({"noise.background.colour": number}, "no such key"),
        ({"scenes.locations": number}, "cannot be searched"),
        ({"sonar.mount.pitch_deg": number}, "cannot be searched"),
        ({"noise.background.density": {"low": 1, "high": 0.1}}, "low < high"),
        ({"noise.background.density": {"low": 0, "high": 1, "log": True}}, "log needs low > 0"),
        ({"noise.background.density": {"low": -2, "high": -1}}, "noise.background.density"),
        ({}, "name at least one key"),
    ):
        with pytest.raises(FactoryError, match=said):
            fit_search.search(settings_for(real, tmp_path / "bad", parameters=parameters))
    with pytest.raises(FactoryError, match="0 of its 10 frames are rendered"):
        fit_search.search(settings_for(real, tmp_path / "bad", recipe=(*RECIPE, "scenes.width=80")))


def test_spreads_are_written_as_distributions_within_the_limits() -> None:
    level = {"low": -10, "high": 10, "spread": (0, 0.5)}
    factor = {"low": 0.1, "high": 10, "log": True, "spread": 1.0}
    settings: FitSettings = build(
        FitSettings,
        {"real": "x", "parameters": {"a": level, "b": factor, "c": {"choices": (1, "two")}}},
    )
    a, b, c = settings.parameters.values()
    assert fit_search.written(a, 8.0, 0.25) == {"uniform": [3.0, 10.0]}
    assert fit_search.written(a, 1.23456) == 1.235
    assert fit_search.written(b, 2.0, 1.0) == {"uniform": [1.0, 4.0]}
    assert fit_search.written(c, "two") == "two"
    nested = {"noise": {"x": {"low": 1, "high": 2}, "y": None}, "sonar.z": {"choices": [1]}}
    assert list(flattened(nested)) == ["noise.x", "noise.y", "sonar.z"]


def test_the_command_takes_the_recipe_behind_two_dashes(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = [
        "search=simnfnd",
        "name=shown",
        "trials=2",
        "startup=1",
        "frames=8",
        "resamples=2",
        "grid.range_bins=96",
        "grid.beams=64",
        f"out={tmp_path / 'fit'}",
    ]
    assert main(["evaluate", "fit", str(real), *own, "--", *RECIPE]) == 0
    said = capsys.readouterr().out
    assert "| amplitude, EMD |" in said
    assert "experiment=shown" in said
    made = yaml.safe_load((tmp_path / "fit" / "noise" / "shown.yaml").read_text())
    assert all(0.01 <= value <= 5 for value in parse(made["background"]["density"]).values)
    assert main(["evaluate", "fit", *own, "--", *RECIPE]) == 2
    assert "real: give a folder of real pictures" in capsys.readouterr().err
