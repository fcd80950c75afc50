"""Statistics of the speckle against theory, its grain, and its hold on the world."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from simnfnd.factory.imaging.coherent import kernels
from simnfnd.factory.imaging.coherent.scatterers import Scatterers, shares
from simnfnd.factory.imaging.coherent.scene import received
from simnfnd.factory.imaging.coherent.signal import beamform_power, gaussian_table, white_noise
from simnfnd.factory.noise.draws import StreamNames, draw
from simnfnd.factory.noise.field.texture import gamma_of_normal
from simnfnd.factory.pairs import ObservedFrame, make_pair, observe
from tests.constant_field import config, observed, ping_of, slope

SPECKLE = {"speckle": {"scatterer_m": 0.004}}
SHARP = {"bandwidth_khz": 800.0, "beamwidth_deg": 0.06}  # a point-spread within one bin
EDGE = (slice(20, -20), slice(20, -20))


def amplitude(made: ObservedFrame, variant: int, settings: Any) -> np.ndarray:
    """(range_bins, beams) amplitude over the root of its expectation, without the edges."""
    ping, names = ping_of(made), StreamNames.of(made.ref, variant, made.has_pose)
    effects = draw(settings.noise, settings.seed, names).effects
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
    ("shape", "golden_si", "golden_enl"),
    [(0.5, 5, 1.00), (2, 2, 2.26), (10, 1.2, 3.27)],
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


@pytest.mark.parametrize("shape", [0.5, 4, 20])
def test_the_table_of_gamma_values_is_fine_enough(shape):
    """Against scipy's quantiles, as far out as one in a million lies."""
    normal = np.linspace(-4.75, 4.75, 20_001, dtype=np.float32)
    exact = special.gammaincinv(shape, special.ndtr(normal.astype(np.float64))) / shape
    np.testing.assert_allclose(gamma_of_normal(normal, shape), exact, rtol=5e-4, atol=1e-5)


def test_points_of_a_cell_share_its_power() -> None:
    """Counted with numpy; cells come back, and some names fall on the same slot of the table."""
    rng = np.random.default_rng(1)
    names = rng.integers(0, 400, 3000).astype(np.uint32) * np.uint32(2654435761)
    found = shares(names, names & np.uint32(0xFFFF0011))
    _, cell = np.unique(names, return_inverse=True)
    expected = 1 / np.sqrt(np.bincount(cell)[cell])
    np.testing.assert_allclose(found, expected, rtol=2e-7)


@pytest.mark.parametrize("away_m", [0.0, 4_321_987.6])
def test_scatterers_of_a_name_lie_in_one_cell_of_the_world(away_m):
    """Cells from the scatterers' places in double precision; also far from the world's origin."""
    settings, edge_m = config(), 0.01
    frame, rendered = slope((away_m, -away_m, 0.3))
    made: Scatterers = ping_of(observe(frame, rendered, settings)).scatterers
    assert frame.world_from_camera is not None
    (height, width), camera = frame.depth_m.shape, frame.intrinsics
    row, column = np.divmod(made.pixels, width)
    depth_m = frame.depth_m.astype(np.float64)
    y_of = ((np.arange(height) - camera.cy) / camera.fy)[:, None] * depth_m
    below = np.minimum(row + 1, height - 1)
    z, y = (one[row, column] + made.parts * (one[below, column] - one[row, column])
            for one in (depth_m, y_of))  # fmt: skip
    x = (column - camera.cx) / camera.fx * z
    world = np.stack([x, y, z, np.ones_like(z)], axis=1) @ frame.world_from_camera[:3].T
    place = world / edge_m
    # What lies on the border of two cells may be rounded into either.
    clear = (np.abs(place - np.rint(place)) > 2e-3).all(axis=1)
    assert clear.mean() > 0.9
    _, cell = np.unique(np.floor(place[clear]), axis=0, return_inverse=True)
    cells = made.world_cells(edge_m)
    _, name = np.unique(cells.names[clear], return_inverse=True)
    assert len(np.unique(cell)) == len(np.unique(name)) == len(np.unique(cell + 1j * name)) > 1000
    counted = cells.shares.astype(np.float64) ** -2
    assert np.rint(counted).min() >= 1
    # Each cell's points have shares that sum to 1 in intensity.
    assert (1 / counted).sum() == pytest.approx(len(np.unique(cells.names)), rel=1e-5)


def test_texture_in_a_picture() -> None:
    """Through all stages, with patches smaller than a bin so that one picture holds many."""
    noise = {**SPECKLE, "texture": {"shape": 5, "patch_m": 0.005}}
    found = many(config(noise=noise, sonar={"array": SHARP}), 4) ** 2
    assert found.var() / found.mean() ** 2 == pytest.approx(1.4, rel=0.06)


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


def test_variants_have_speckle_of_their_own() -> None:
    found = many(config(noise=SPECKLE), 2)
    assert abs(_alike(found[0], found[1])) < 0.1


def test_the_table_of_gaussian_values_has_the_moments_of_the_distribution() -> None:
    table = gaussian_table().astype(np.float64)
    intensity = (table**2).sum(axis=1)
    assert table.mean() == pytest.approx(0, abs=1e-4)
    assert intensity.mean() == pytest.approx(1, abs=1e-5)
    assert (intensity**2).mean() == pytest.approx(2, rel=2e-3)
    assert (table[:, 0] ** 4).mean() == pytest.approx(0.75, rel=5e-3)
    assert (table[:, 0] * table[:, 1]).mean() == pytest.approx(0, abs=1e-4)


def test_pairs_are_the_same_whenever_they_are_made() -> None:
    settings = config(noise={**SPECKLE, "receiver": {}, "texture": {}, "volume": {}})
    first, again = observed(settings), observed(settings)
    for variant in (1, 0):
        one, two = (make_pair(made, variant, settings) for made in (first, again))
        np.testing.assert_array_equal(one.noisy, two.noisy)
        np.testing.assert_array_equal(one.clean, two.clean)
        assert str(one.record) == str(two.record)  # text, because NaN is not equal to itself
