"""`simnfnd evaluate realism` and `fit`: what is read, features, the report, and a search."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image
from scipy import ndimage

from simnfnd.command import main
from simnfnd.evaluation.judging import recorded
from simnfnd.evaluation.judging.settings import FitSettings, Grid
from simnfnd.evaluation.metrics import features as statistics
from simnfnd.evaluation.metrics.features import FEATURES, features_of
from simnfnd.evaluation.realism import calibrate as search
from simnfnd.evaluation.realism.calibrate import Simulation
from simnfnd.evaluation.realism.report import distances, to_polar
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.factory.production.cli.generate import run as generate
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.pairs.pair_maker import pair_maker
from simnfnd.factory.simulation.sonar.settings import ImageSettings, SonarSettings
from tests.evaluation.evaluation_settings import polar_folder, sonar_image, speckle
from tests.project_files import ROOT

SHARED = ROOT.parent / "shared" / "data"
ARIS = SHARED / "aris-sdk" / "sample.aris"
LAMPREY = ROOT / "examples" / "didson" / "lamprey.avi"


def smooth(rows: int, columns: int) -> np.ndarray:
    r, c = np.mgrid[0:rows, 0:columns]
    waves = 0.2 * np.sin(r / rows * 9) + 0.2 * np.cos(c / columns * 7)
    return np.asarray(0.5 + waves, dtype=np.float32)


def test_bearings_without_data_are_left_out_and_squeezed_images_stretched() -> None:
    image = ImageSettings(layout="polar")
    sonar = SonarSettings(hfov_deg=40, beams=64, range_bins=64, image=image)
    geometry = FanGeometry.from_sonar(sonar, 1, 5, math.radians(-10), math.radians(20))
    assert geometry.data_fraction == (0.25, 1.0)
    assert to_polar(smooth(64, 64), geometry, Grid(64, 64)).shape == (64, 48)
    wide = FanGeometry.fan(
        math.radians(30), apex_x_px=100.0, apex_y_px=300.0, near_px=50.0, far_px=280.0
    )
    squeezed = replace(wide, x_scale=0.5, apex_x_px=50.0)
    rows, columns = np.mgrid[0:300, 0:200]
    for own, x in ((wide, columns - 100.0), (squeezed, (columns - 50.0) / 0.5)):
        polar = to_polar(np.hypot(300.0 - rows, x).astype(np.float32), own, Grid(64, 32))
        # Rows are ranges, near first.
        assert polar[0].mean() == pytest.approx(50 + 230 / 128, abs=0.05)
        assert polar.std(axis=1).max() < 0.05


def test_geometry_files_and_recordings_are_checked(tmp_path: Path) -> None:
    folder = polar_folder(tmp_path / "real", 1, 4)
    table = folder / "geometry.csv"
    good = table.read_text()
    assert len(recorded.open_real(folder)[0]) == 4
    for text, said in (
        ("file,layout,hfov_deg,widht\n*,polar,30,2\n", "line 2: .*widht"),
        ("file,layout,hfov_deg\n*,fan,30\n", "missing .*apex_x_px"),
        ("file,layout,hfov_deg\n000.png,polar,30\n", "no line for 001.png"),
        (good + "999.png,polar,30,,\n", "999.png is listed"),
        ("file,layout,hfov_deg,range_min_m,range_max_m\n*,polar,30,5,1\n", "range_max_m"),
    ):
        table.write_text(text)
        with pytest.raises(FactoryError, match=said):
            recorded.open_real(folder)
    table.unlink()
    with pytest.raises(FactoryError, match=r"geometry\.csv"):
        recorded.open_real(folder)
    for name, said in (("absent.aris", "no such folder or recording"), ("dive.aris", "dive.aris")):
        (tmp_path / "dive.aris").write_bytes(b"no recording")
        with pytest.raises(FactoryError, match=said):
            recorded.open_real(tmp_path / name)


@pytest.mark.skipif(not ARIS.is_file(), reason="no shared data")
def test_a_recording_says_where_range_and_bearing_are() -> None:
    actual, _ = recorded.open_real(ARIS)
    assert len(actual) == 6
    assert actual[0].known is not None
    assert actual[0].known.range_max_m == pytest.approx(23.3, abs=0.5)
    assert not np.array_equal(actual[0].read()[0], actual[5].read()[0])


def test_rayleigh_speckle_has_the_textbook_numbers() -> None:
    rng = np.random.default_rng(0)
    amplitude = 0.2 * speckle(rng, (1024, 256))
    enl, index = statistics.speckle(amplitude)
    assert enl == pytest.approx(3.66, rel=0.05)
    assert index == pytest.approx(1.0, rel=0.08)


@pytest.mark.parametrize("grain", [(2.0, 1.0), (1.0, 2.5)])
def test_half_widths_are_those_of_the_point_spread(grain: tuple[float, float]) -> None:
    # Filtered white noise of standard deviation s has the autocorrelation exp(-d^2 / 4 s^2).
    rng = np.random.default_rng(3)
    noise = ndimage.gaussian_filter(rng.standard_normal((512, 512)), grain, mode="wrap")
    image = (0.5 + 0.1 * noise / noise.std()).astype(np.float32)
    expected = [2 * s * np.sqrt(np.log(2)) for s in grain]
    assert statistics.half_widths(image) == pytest.approx(expected, rel=0.08)


def test_spokes_arcs_slope_and_contrasts_of_made_up_images() -> None:
    rng = np.random.default_rng(6)
    spokes = np.broadcast_to(rng.random(64), (200, 64)).astype(np.float32)
    assert statistics.spread_of_means(spokes, 0) == pytest.approx(1)
    assert statistics.spread_of_means(spokes, 1) == pytest.approx(0, abs=1e-6)
    position = (np.arange(200) + 0.5) / 200
    ramp = np.broadcast_to((0.5 * 10 ** (-12 * position / 20))[:, None], (200, 64))
    assert statistics.range_slope_db(ramp.astype(np.float32)) == pytest.approx(-12, abs=0.05)
    image = np.full((200, 64), 0.2, np.float32)
    image[20:40, 10:30] = 0.8
    image[100:140, 10:30] = 0.05
    highlight, shadow = statistics.contrasts_db(image)
    assert highlight == pytest.approx(20 * np.log10(4), abs=0.3)
    assert shadow == pytest.approx(20 * np.log10(4), abs=0.3)


@pytest.fixture(scope="module")
def many() -> dict[str, pd.DataFrame]:
    rng = np.random.default_rng(3)

    def of(count: int, **changes: float) -> pd.DataFrame:
        return pd.DataFrame(
            [features_of(sonar_image(rng, **changes), 4.0) for _ in range(count)]  # type: ignore[arg-type]
        )

    return {"real": of(24), "same": of(24), "bright": of(16, level=0.42)}


@pytest.mark.slow
def test_a_perfect_simulation_reaches_the_halves_and_another_does_not(
    many: dict[str, pd.DataFrame],
) -> None:
    simulated = {"same": many["same"], "bright": many["bright"]}
    table, overall = distances(many["real"], simulated, seed=1)
    assert list(table.index) == list(FEATURES)
    assert table["same"].mean() == pytest.approx(table["real"].mean(), abs=0.08)
    assert table["bright"]["middle"] == 1
    assert 1 <= overall["same"] < 1.3
    assert overall["bright"] > 1.5 * overall["same"]
    without = many["real"].assign(slope_per_m=np.nan)
    assert "slope_per_m" not in distances(without, simulated, seed=1)[0].index


def test_the_command_writes_a_report_that_needs_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    real_folder = polar_folder(tmp_path / "real images", 1, 9)
    simulated_folder = polar_folder(tmp_path / "made, up", 2, 8, level=0.4)
    out = tmp_path / "report"
    words = [str(real_folder), str(simulated_folder), "grid.range_bins=96", "grid.beams=48"]
    assert main(["evaluate", "realism", *words, f"out={out}"]) == 0
    assert "| real against | real | made, up |" in capsys.readouterr().out
    message = json.loads((out / "realism.json").read_text())
    assert message["images"] == {"real": 9, "made, up": 8}
    assert 0 < message["distances"]["real"]["slope_per_m"] <= 1
    assert message["overall"]["made, up"] > 1
    page = (out / "realism.html").read_text()
    assert page.count("data:image/png;base64,") == 2 * 8, "examples of both"
    assert "http" not in page.replace('<html lang="en">', ""), "works without a network"
    assert "| overall | 1 |" in (out / "realism.md").read_text()


def test_bad_input_is_one_line_and_exit_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    polar_folder(tmp_path / "REAL", 1, 8)
    for words, said in (
        (["nowhere", "REAL"], "real=nowhere: no such folder"),
        (["REAL", "nowhere"], "dataset=nowhere: no such folder"),
        (["REAL", "REAL", "limit=6"], "6 images; at least 8"),
    ):
        assert main(["evaluate", "realism", *words]) == 2
        (error,) = [line for line in capsys.readouterr().err.splitlines() if line[:6] == "error:"]
        assert said in error


# --- the search -----------------------------------------------------------------------------------

RECIPE = (
    "noise=none", "noise.background.enabled=true", "noise.background.density=0.02",
    "noise.background.strength=0.3", "scenes.locations=1", "scenes.frames_per_location=8",
    "scenes.width=96", "scenes.height=64", "sonar.image.layout=polar", "sonar.beams=64",
    "sonar.range_bins=96", "render=analytic", "scheduler=serial",
)  # fmt: skip
TRUE_DENSITY = 0.5
GRID = {"range_bins": 96, "beams": 64}


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of "real" images: the recipe's frames with another density; and its renders."""
    folder = tmp_path_factory.mktemp("fit")
    generate(compose_config([*RECIPE, f"dataset.dir={folder / 'data'}"]), [])
    (folder / "real").mkdir()
    config = compose_config([*RECIPE, f"noise.background.density={TRUE_DENSITY}", "seed=5"])
    maker = pair_maker(config)
    for number, ref in enumerate(Simulation(RECIPE, 8, Grid(**GRID)).refs):
        (pair,) = maker.pairs(ref, (0,))
        Image.fromarray(pair.noisy).save(folder / "real" / f"{number}.png")
    (folder / "real" / "geometry.csv").write_text("file,layout,hfov_deg\n*,polar,45\n")
    return folder / "real"


def settings_for(real: Path, out: Path, **changes: object) -> FitSettings:
    parameters = {"noise.background.density": {"low": 0.005, "high": 5, "log": True}}
    values = {"real": str(real), "recipe": RECIPE, "name": "found", "frames": 8, "grid": GRID,
              "trials": 12, "startup": 6, "parameters": parameters, "out": str(out)}  # fmt: skip
    return build(FitSettings, {**values, **changes})


@pytest.mark.slow
def test_the_density_that_made_the_images_is_found_again(
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
    assert "12 trials" in text.splitlines()[3]
    content = yaml.safe_load(text)
    assert content["noise"]["background"]["density"] == density
    assert "scenes" not in content
    assert search.usage(settings) == (
        "scenes.locations=1 scenes.frames_per_location=8 scenes.width=96 scenes.height=64 "
        "render=analytic scheduler=serial experiment=found"
    )
    search_words = ["--config-dir", str(settings.folder), *search.usage(settings).split()]
    assert main(["make", *search_words, "--cfg", "job"]) == 0
    composed = yaml.safe_load(capsys.readouterr().out)
    assert composed["noise"]["background"]["density"] == density
    assert composed["sonar"]["beams"] == 64


@pytest.mark.slow
def test_an_interrupted_search_goes_on_as_if_nothing_had_happened(
    real: Path, tmp_path: Path
) -> None:
    short: Any = {"startup": 2}
    whole = search.fit(settings_for(real, tmp_path / "whole", trials=3, **short))
    search.fit(settings_for(real, tmp_path / "parts", trials=2, **short))
    # A trial that was asked for and never told is what a kill leaves behind.
    search._study(settings_for(real, tmp_path / "parts", **short)).ask()
    assert search.fit(settings_for(real, tmp_path / "parts", trials=3, **short)) == whole
    with pytest.raises(FactoryError, match="other settings"):
        search.fit(settings_for(real, tmp_path / "parts", frames=10))


def test_what_cannot_be_searched_is_refused(real: Path, tmp_path: Path) -> None:
    number = {"low": 0.1, "high": 1}
    for parameters, said in (
        ({"noise.background.colour": number}, "no such key"),
        ({"scenes.locations": number}, "cannot be searched"),
        ({"noise.background.density": {"low": 1, "high": 0.1}}, "low < high"),
    ):
        with pytest.raises(FactoryError, match=said):
            search.fit(settings_for(real, tmp_path / "bad", parameters=parameters))
    with pytest.raises(FactoryError, match="0 of its 8 frames"):
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


@pytest.mark.slow
def test_the_command_takes_the_recipe_behind_two_dashes(
    real: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = ["search=simnfnd", "name=shown", "trials=1", "frames=8",
           "grid.range_bins=96", "grid.beams=64", f"out={tmp_path / 'fit'}"]  # fmt: skip
    assert main(["evaluate", "fit", str(real), *own, "--", *RECIPE]) == 0
    assert "experiment=shown" in capsys.readouterr().out
    assert main(["evaluate", "fit", *own, "--", *RECIPE]) == 2
    assert "real: give a folder of real images" in capsys.readouterr().err
