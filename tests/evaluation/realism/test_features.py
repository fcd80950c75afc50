"""The features of `evaluate realism` against what theory says of known pictures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from simnfnd.evaluation import features as statistics
from tests.evaluation.realism.realism_pictures import speckle


def test_rayleigh_speckle_has_the_textbook_numbers() -> None:
    rng = np.random.default_rng(0)
    amplitude = 0.2 * speckle(rng, (1024, 256))
    enl, index = statistics.speckle(amplitude)
    assert enl == pytest.approx(3.66, rel=0.05)
    assert index == pytest.approx(1.0, rel=0.08)


def test_even_windows_avoid_objects_and_black_but_not_strong_speckle() -> None:
    rng = np.random.default_rng(1)
    picture = np.zeros((64, 64))
    picture[:32] = 0.4 + 0.02 * rng.standard_normal((32, 64))
    picture[:32, :32] += np.linspace(0, 0.5, 32)  # a slope across, with weak speckle
    picture[:16, 32:48] = 0.4 * speckle(rng, (16, 16))  # even, with the strongest speckle
    found = statistics.even_windows(picture)
    assert len(found) == 2  # a fifth of the eight windows that are not black
    assert found.min() > 0
    assert all(window.max() - np.median(window) < 1 for window in found)
    spread = {round(float(window.std()), 3) for window in found}
    assert all(value < 0.3 for value in spread)
    assert np.ptp(found.mean(axis=1)) < 0.1  # none from the slope


@pytest.mark.parametrize("grain", [(1.0, 1.0), (2.0, 1.0), (1.0, 2.5)])
def test_half_widths_are_those_of_the_point_spread(grain: tuple[float, float]) -> None:
    # Filtered white noise of standard deviation s has the autocorrelation exp(-d^2 / 4 s^2).
    rng = np.random.default_rng(3)
    noise = ndimage.gaussian_filter(rng.standard_normal((512, 512)), grain, mode="wrap")
    picture = (0.5 + 0.1 * noise / noise.std()).astype(np.float32)
    expected = [2 * s * np.sqrt(np.log(2)) for s in grain]
    assert statistics.half_widths(picture) == pytest.approx(expected, rel=0.08)


def test_spokes_arcs_slope_and_contrasts_of_made_up_pictures() -> None:
    rng = np.random.default_rng(6)
    spokes = np.broadcast_to(rng.random(64), (200, 64)).astype(np.float32)
    assert statistics.spread_of_means(spokes, 0) == pytest.approx(1)
    assert statistics.spread_of_means(spokes, 1) == pytest.approx(0, abs=1e-6)
    assert statistics.spread_of_means(spokes.T.copy(), 1) == pytest.approx(1)
    assert np.isnan(statistics.spread_of_means(np.ones((8, 8), np.float32), 0))
    position = (np.arange(200) + 0.5) / 200
    ramp = np.broadcast_to((0.5 * 10 ** (-12 * position / 20))[:, None], (200, 64))
    assert statistics.range_slope_db(ramp.astype(np.float32)) == pytest.approx(-12, abs=0.05)
    picture = np.full((200, 64), 0.2, np.float32)
    picture[20:40, 10:30] = 0.8
    picture[100:140, 10:30] = 0.05
    highlight, shadow = statistics.contrasts_db(picture)
    assert highlight == pytest.approx(20 * np.log10(4), abs=0.3)
    assert shadow == pytest.approx(20 * np.log10(4), abs=0.3)
