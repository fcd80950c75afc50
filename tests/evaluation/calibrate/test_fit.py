"""`simnfnd evaluate fit`: a search that finds what was put in, and goes on where it stopped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from PIL import Image

from simnfnd.command import main
from simnfnd.evaluation import calibrate as search
from simnfnd.evaluation.calibrate import Simulation
from simnfnd.evaluation.settings import FitSettings, Grid
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.cli.generate import run as generate
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.pairs import pair_maker
from simnfnd.factory.settings import build

RECIPE = (
    "noise=none", "noise.background.enabled=true", "noise.background.density=0.02",
    "noise.background.strength=0.3", "scenes.locations=1", "scenes.frames_per_location=10",
    "scenes.width=96", "scenes.height=64", "sonar.image.layout=polar", "sonar.beams=64",
    "sonar.range_bins=96", "render=analytic", "scheduler=serial",
)  # fmt: skip
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
    for number, ref in enumerate(Simulation(RECIPE, 10, Grid(**GRID)).refs):
        (pair,) = maker.pairs(ref, (0,))
        Image.fromarray(pair.noisy).save(folder / "real" / f"{number}.png")
    (folder / "real" / "geometry.csv").write_text("file,layout,hfov_deg\n*,polar,45\n")
    return folder / "real"


def settings_for(real: Path, out: Path, **changes: object) -> FitSettings:
    parameters = {"noise.background.density": {"low": 0.005, "high": 5, "log": True}}
    values = {"real": str(real), "recipe": RECIPE, "name": "found", "frames": 10, "grid": GRID,
              "trials": 16, "startup": 8, "parameters": parameters, "out": str(out)}  # fmt: skip
    return build(FitSettings, {**values, **changes})


def test_the_density_that_made_the_pictures_is_found_again(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = settings_for(real, tmp_path / "fit")
    density = search.fit(settings)["noise.background.density"]
    assert TRUE_DENSITY / 2 < density < TRUE_DENSITY * 2
    words = capsys.readouterr().out.split()
    before, after = (float(words[words.index(when) - 1]) for when in ("before,", "after"))
    assert after < 1.1 < before
    # The file is a configuration that the factory takes as it stands.
    text = (tmp_path / "fit" / "experiment" / "found.yaml").read_text()
    assert "16 trials" in text.splitlines()[3]
    content = yaml.safe_load(text)
    assert content["noise"]["background"]["density"] == density
    assert "scenes" not in content
    assert search.usage(settings) == (
        "scenes.locations=1 scenes.frames_per_location=10 scenes.width=96 scenes.height=64 "
        "render=analytic scheduler=serial experiment=found"
    )
    given = ["--config-dir", str(settings.folder), *search.usage(settings).split()]
    assert main(["make", *given, "--cfg", "job"]) == 0
    composed = yaml.safe_load(capsys.readouterr().out)
    assert composed["noise"]["background"]["density"] == density
    assert composed["sonar"]["beams"] == 64


def test_an_interrupted_search_goes_on_as_if_nothing_had_happened(
    real: Path, tmp_path: Path
) -> None:
    short: Any = {"startup": 2}
    whole = search.fit(settings_for(real, tmp_path / "whole", trials=4, **short))
    search.fit(settings_for(real, tmp_path / "parts", trials=2, **short))
    # A trial that was asked for and never told is what a kill leaves behind.
    search._study(settings_for(real, tmp_path / "parts", **short)).ask()
    assert search.fit(settings_for(real, tmp_path / "parts", trials=4, **short)) == whole
    with pytest.raises(FactoryError, match="holds a search with other settings"):
        search.fit(settings_for(real, tmp_path / "parts", frames=8))


def test_what_cannot_be_searched_is_refused(real: Path, tmp_path: Path) -> None:
    number = {"low": 0.1, "high": 1}
    for parameters, said in (
        ({"noise.background.colour": number}, "no such key"),
        ({"scenes.locations": number}, "cannot be searched"),
        ({"noise.background.density": {"low": 1, "high": 0.1}}, "low < high"),
    ):
        with pytest.raises(FactoryError, match=said):
            search.fit(settings_for(real, tmp_path / "bad", parameters=parameters))
    with pytest.raises(FactoryError, match="0 of its 10 frames are rendered"):
        search.fit(settings_for(real, tmp_path / "bad", recipe=(*RECIPE, "scenes.width=80")))


def test_spreads_are_written_as_distributions_within_the_limits() -> None:
    level = {"low": -10, "high": 10, "spread": (0, 0.5)}
    factor = {"low": 0.1, "high": 10, "log": True, "spread": 1.0}
    settings: FitSettings = build(
        FitSettings, {"real": "x", "parameters": {"a": level, "b": factor}}
    )
    a, b = settings.parameters.values()
    assert search.written(a, 8.0, 0.25) == {"uniform": [3.0, 10.0]}
    assert search.written(a, 1.23456) == 1.235
    assert search.written(b, 2.0, 1.0) == {"uniform": [1.0, 4.0]}


def test_the_command_takes_the_recipe_behind_two_dashes(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ["search=simnfnd", "name=shown", "trials=1", "frames=8",
           "grid.range_bins=96", "grid.beams=64", f"out={tmp_path / 'fit'}"]  # fmt: skip
    assert main(["evaluate", "fit", str(real), *own, "--", *RECIPE]) == 0
    assert "experiment=shown" in capsys.readouterr().out
    assert main(["evaluate", "fit", *own, "--", *RECIPE]) == 2
    assert "real: give a folder of real pictures" in capsys.readouterr().err
