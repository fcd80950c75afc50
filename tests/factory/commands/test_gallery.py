"""The gallery draws every figure, and what it draws is what it says."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.factory.commands.gallery import alone, compose, gallery
from simnfnd.factory.distribution import Distribution, parse
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.gallery import figures
from simnfnd.factory.sonar.echoes import from_xyz
from tests.project_files import ROOT

SMALL = (
    "render=analytic",
    "scenes.locations=2",
    "scenes.width=200",
    "scenes.height=126",
    "sonar.image.width_px=64",
    "sonar.image.height_px=64",
)
FILES = [
    "figure-03", "figure-04", "figure-05", "figure-06", "figure-07", "figure-08",
    "noise-effects", "resampling", "figure-12",
]  # fmt: skip


def test_every_figure_is_drawn_and_the_same_twice(tmp_path: Path) -> None:
    paths = gallery(tmp_path / "one", SMALL)
    assert [path.stem for path in paths] == FILES
    again = gallery(tmp_path / "two", SMALL)
    for path, twin in zip(paths, again, strict=True):
        assert path.read_bytes() == twin.read_bytes()
        picture = cv2.imread(str(path))
        assert picture is not None
        assert picture.std() > 15, f"{path.name} shows next to nothing"


@pytest.mark.parametrize("effect", ["range_spreading", "multipath", "azimuth", "background"])
def test_an_effect_alone_is_alone_and_at_the_end_of_its_range(effect: str) -> None:
    config = compose(())
    for quantile, pick in ((0, min), (1, max)):
        one = alone(config, effect, quantile)
        blocks = {item.name: getattr(one.noise, item.name) for item in fields(one.noise)}
        on = [name for name, block in blocks.items() if block is not None and block.enabled]
        assert on == [effect]
        before, after = getattr(config.noise, effect), getattr(one.noise, effect)
        for item in fields(before):
            given = getattr(before, item.name)
            if isinstance(given, Distribution):
                assert getattr(after, item.name).kind == "number"
                assert getattr(after, item.name).values == (pick(given.values),)


def test_the_ends_of_a_normal_are_two_deviations_away_and_within_limits() -> None:
    from simnfnd.factory.commands.gallery import _end

    assert _end(parse({"normal": [5, 1]}), 0) == 3
    assert _end(parse({"normal": [5, 1]}), 1) == 7
    assert _end(parse({"normal": [0.5, 1]}, low=0, high=1), 0) == 0


def test_settings_reach_the_configuration() -> None:
    assert compose(()).scenes.kind == "seabed"
    other = compose(("scenes=flsea", "scenes.root=somewhere", "noise.azimuth.count=7"))
    assert other.scenes.kind == "flsea"
    assert other.noise.azimuth.count.values == (7,)


@pytest.mark.parametrize("word", ["noise.azimut.count=3", "sonar=nothing", "sonar.beams=-3"])
def test_a_bad_setting_is_one_line(word: str) -> None:
    with pytest.raises(FactoryError) as told:
        compose((word,))
    assert "\n" not in str(told.value)


def test_the_view_from_above_puts_echoes_where_they_are() -> None:
    # Two walls 4 m and 8 m ahead, the near one to the left and twice as loud.
    left_m = np.linspace(0, 2, 200)
    near = np.stack([np.full(200, 4.0), left_m, np.full(200, -1.0)], axis=1)
    far = np.stack([np.full(200, 8.0), -left_m, np.full(200, -1.0)], axis=1)
    echoes = from_xyz(np.concatenate([near, far]), np.repeat([2.0, 1.0], 200))
    panel = figures.from_above("above", echoes)
    assert panel.extent is not None
    left, right, bottom, top = panel.extent
    assert (left, right, bottom, top) == pytest.approx((-2, 2, 4, 8), abs=1e-3)
    rows, columns = panel.image.shape
    half = columns // 2
    # Far is on top and to the right, near at the bottom and to the left.
    assert panel.image[0, half + 2 :].max() == pytest.approx(1)
    assert panel.image[0, : half - 2].max() == 0
    assert panel.image[-1, : half - 2].max() == pytest.approx(2)
    assert panel.image[-1, half + 2 :].max() == 0
    assert panel.image[rows // 4 : -rows // 4].max() == 0


def test_sonar_panels_have_one_scale() -> None:
    grey = np.array([[0, 51], [255, 102]], np.uint8)
    np.testing.assert_allclose(
        figures.sonar("a", grey).image, figures.sonar("b", grey / np.float32(255)).image
    )


def test_the_page_shows_every_figure() -> None:
    docs = ROOT / "docs"
    shown = re.findall(r"\]\(images/([\w-]+)\.png\)", (docs / "gallery.md").read_text())
    assert set(shown) >= set(FILES)
    for name in FILES:
        assert 10_000 < (docs / "images" / f"{name}.png").stat().st_size < 400_000, name
