"""Statistics of the speckle against theory, its grain, and its hold on the world."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from simnfnd.factory.imaging import kernels
from simnfnd.factory.imaging.coherent import received
from simnfnd.factory.imaging.signal import beamform_power, gaussian_table, white_noise
from simnfnd.factory.noise.speckle import gamma_of_normal
from simnfnd.factory.pairs import ObservedFrame, observe
from tests.constant_field import config, effects_of, observed, ping_of, slope

SPECKLE = {"speckle": {"scatterer_m": 0.004}}
SHARP = {"bandwidth_khz": 800.0, "beamwidth_deg": 0.06}  # a point-spread within one bin
EDGE = (slice(20, -20), slice(20, -20))


def amplitude(made: ObservedFrame, variant: int, settings: Any) -> np.ndarray:
    """(range_bins, beams) amplitude over the root of its expectation, without the edges."""
    ping, effects = ping_of(made), effects_of(settings, made, variant)
    expected = beamform_power(ping.scatterers.power, ping) * ping.gain[:, None]
    return np.asarray((received(ping, effects) / np.sqrt(expected))[EDGE])


def many(settings: Any, count: int) -> np.ndarray:
    made = observed(settings)
    return np.stack([amplitude(made, variant, settings) for variant in range(count)])


def test_speckle_is_fully_developed() -> None:
    found = many(config(noise=SPECKLE), 8)
    assert stats.kstest(found.ravel(), stats.rayleigh(scale=np.sqrt(0.5)).cdf).statistic <= 0.01
    assert (found.mean() / found.std()) ** 2 == pytest.approx(3.66, rel=0.02)
    intensity = found**2
    assert intensity.mean() == pytest.approx(1, rel=0.02)
    assert intensity.var() / intensity.mean() ** 2 == pytest.approx(1, rel=0.03)
    decibels = 10 * np.log10(intensity)
    assert decibels.std() == pytest.approx(5.57, rel=0.02)


@pytest.mark.parametrize("looks", [2, 4])
def test_looks_make_it_gamma(looks):
    found = many(config(noise={"speckle": {"looks": looks, "scatterer_m": 0.004}}), 6) ** 2
    assert found.mean() == pytest.approx(1, rel=0.03)
    assert found.mean() ** 2 / found.var() == pytest.approx(looks, rel=0.04)
    theory = stats.gamma(looks, scale=found.mean() / looks)
    assert stats.kstest(found.ravel(), theory.cdf).statistic <= 0.01


@pytest.mark.parametrize(
    ("shape", "golden_si", "golden_enl"), [(0.5, 5, 1.00), (2, 2, 2.26), (10, 1.2, 3.27)]
)
def test_texture_makes_it_k_distributed(shape, golden_si, golden_enl):
    size = 2_000_000
    rng = np.random.default_rng(3)
    normal = np.empty(size, np.float32)
    points = rng.random((3, size), dtype=np.float32)
    kernels.lattice(points, 1000 * np.eye(3, 4), 7, gaussian_table(), normal)
    field = white_noise(rng, 1, (1, size))[0, :, 0]
    intensity = (field.astype(np.float64) ** 2).sum(axis=0) * gamma_of_normal(normal, shape)
    assert intensity.mean() == pytest.approx(1, rel=0.01)
    scintillation = (intensity**2).mean() / intensity.mean() ** 2 - 1
    assert scintillation == pytest.approx(golden_si, rel=0.02)
    root = np.sqrt(intensity)
    assert (root.mean() / root.std()) ** 2 == pytest.approx(golden_enl, rel=0.02)


def half_width(correlation: np.ndarray) -> float:
    """Lag at which a falling correlation is a half."""
    below = int(np.argmax(correlation < 0.5))
    high, low = correlation[below - 1], correlation[below]
    return float(below - 1 + (high - 0.5) / (high - low))


@pytest.mark.parametrize(("bins", "beams"), [(4, 3), (6, 5)])
def test_the_grain_is_the_point_spread(bins, beams):
    """An untapered aperture's field correlates as its own response does: sinc."""
    uniform = {"window": "uniform"}
    bin_m = 4 / 192
    speed = config().water.sound_speed_m_s()
    device = {
        "bandwidth_khz": speed / 2 / (bins * bin_m) / 1000, "pulse": uniform, "horizontal": uniform,
        "beamwidth_deg": 2 * 0.443 * beams * 24 / 128,
    }  # fmt: skip
    settings = config(noise=SPECKLE, sonar={"array": device})
    intensity = many(settings, 8) ** 2 - 1
    for axis, nulls in ((1, bins), (2, beams)):
        lags = range(nulls + 2)
        size = intensity.shape[axis]
        correlation = [
            (
                intensity.take(range(size - lag), axis) * intensity.take(range(lag, size), axis)
            ).mean()
            for lag in lags
        ]
        # The beam width at half power is 0.886 of the way to the first null; so is the pulse's.
        found = half_width(np.array(correlation) / correlation[0])
        assert found == pytest.approx(0.443 * nulls, rel=0.1)


def _frame_speckle(pose_m: tuple[float, float, float], name: str, posed: bool = True) -> np.ndarray:
    settings = config(noise={"speckle": {"scatterer_m": 0.01}})
    frame, rendered = slope(pose_m, name)
    if not posed:
        frame = replace(frame, world_from_camera=None)
    made = observe(frame, rendered, settings)
    return amplitude(made, 0, settings) ** 2


def _alike(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def test_a_static_scene_keeps_its_speckle_from_frame_to_frame() -> None:
    first, second = _frame_speckle((0, 0, 0), "0"), _frame_speckle((0, 0, 0), "1")
    np.testing.assert_array_equal(first, second)


def test_a_moving_sonar_loses_it_with_the_way_it_goes() -> None:
    """A beam is 35 to 70 mm wide; the plane looks the same wherever the camera is along it."""
    still = _frame_speckle((0, 0, 0), "0")
    alike = [
        _alike(still, _frame_speckle((way_m, 0, 0), str(way_m)))
        for way_m in (0.002, 0.005, 0.01, 0.02, 0.3)
    ]
    assert alike[0] > 0.85
    assert all(after < before for before, after in itertools.pairwise(alike[:-1]))
    assert abs(alike[-1]) < 0.1


def test_speckle_goes_with_the_ground() -> None:
    """A camera that moves by some of its own pixels sees the same speckle, moved."""
    still, moved = _frame_speckle((0, 0, 0), "0"), _frame_speckle((0.06, 0, 0), "1")
    shifts = [_alike(still[:, 8:-8], np.roll(moved, by, axis=1)[:, 8:-8]) for by in range(-6, 7)]
    # 6 cm are 2.3 to 4.6 beams: the ground goes by to the left.
    assert max(shifts) > 3 * abs(shifts[6])
    assert 1 <= int(np.argmax(shifts)) - 6 <= 5


def test_without_a_pose_every_frame_has_its_own() -> None:
    frames = [_frame_speckle((0, 0, 0), name, posed=False) for name in "001"]
    np.testing.assert_array_equal(frames[0], frames[1])
    assert abs(_alike(frames[0], frames[2])) < 0.1
