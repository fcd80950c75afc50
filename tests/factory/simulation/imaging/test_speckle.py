"""Speckle: statistics against theory, grain, hold on the world, and what targets keep of it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from simnfnd.factory.simulation.imaging import expected, kernels
from simnfnd.factory.simulation.imaging.coherent import CoherentSample, received
from simnfnd.factory.simulation.imaging.signal import (
    Signal,
    beamform,
    beamform_power,
    gaussian_table,
    mixing,
    white_noise,
)
from simnfnd.factory.simulation.noise.texture import gamma_of_normal
from simnfnd.factory.simulation.pairs.pair_maker import ObservedFrame, make_pair, observe
from tests.constant_field import (
    config,
    constant_field,
    effects_of,
    observed,
    ping_of,
    scene_of,
    slope,
)

SPECKLE: dict[str, Any] = {"speckle": {}}
EDGE = (slice(20, -20), slice(20, -20))


def amplitude(observed_frame: ObservedFrame, variant: int, settings: Any) -> np.ndarray:
    """(range_bins, beams) amplitude over the root of its expectation, without the edges."""
    ping = ping_of(observed_frame)
    effects = effects_of(settings, observed_frame, variant)
    expected = beamform_power(ping.scatterers.power, ping) * ping.gain[:, None]
    return np.asarray((received(ping, effects) / np.sqrt(expected))[EDGE])


def many(settings: Any, count: int) -> np.ndarray:
    observed_frame = observed(settings)
    return np.stack([amplitude(observed_frame, variant, settings) for variant in range(count)])


def test_speckle_is_fully_developed() -> None:
    actual = many(config(noise=SPECKLE), 8)
    assert stats.kstest(actual.ravel(), stats.rayleigh(scale=np.sqrt(0.5)).cdf).statistic <= 0.01
    assert (actual.mean() / actual.std()) ** 2 == pytest.approx(3.66, rel=0.02)
    intensity = actual**2
    assert intensity.mean() == pytest.approx(1, rel=0.02)
    assert intensity.var() / intensity.mean() ** 2 == pytest.approx(1, rel=0.03)
    decibels = 10 * np.log10(intensity)
    assert decibels.std() == pytest.approx(5.57, rel=0.02)


@pytest.mark.parametrize("looks", [2, 4])
def test_looks_make_it_gamma(looks):
    actual = many(config(noise={"speckle": {"looks": looks}}), 6) ** 2
    assert actual.mean() == pytest.approx(1, rel=0.03)
    assert actual.mean() ** 2 / actual.var() == pytest.approx(looks, rel=0.04)
    theory = stats.gamma(looks, scale=actual.mean() / looks)
    assert stats.kstest(actual.ravel(), theory.cdf).statistic <= 0.01


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
        actual = half_width(np.array(correlation) / correlation[0])
        assert actual == pytest.approx(0.443 * nulls, rel=0.1)


def _frame_speckle(pose_m: tuple[float, float, float], name: str, posed: bool = True) -> np.ndarray:
    settings = config(noise=SPECKLE)
    frame, rendered = slope(pose_m, name)
    if not posed:
        frame = replace(frame, world_from_camera=None)
    observed_frame = observe(frame, rendered, settings)
    return amplitude(observed_frame, 0, settings) ** 2


def _alike(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


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
    still = _frame_speckle((0, 0, 0), "0")
    moved = _frame_speckle((0.06, 0, 0), "1")
    shifts = [_alike(still[:, 8:-8], np.roll(moved, by, axis=1)[:, 8:-8]) for by in range(-6, 7)]
    # 6 cm are 2.3 to 4.6 beams: the ground goes by to the left.
    assert max(shifts) > 3 * abs(shifts[6])
    assert 1 <= int(np.argmax(shifts)) - 6 <= 5


def test_a_static_scene_keeps_its_speckle_and_without_a_pose_every_frame_has_its_own() -> None:
    first = _frame_speckle((0, 0, 0), "0")
    second = _frame_speckle((0, 0, 0), "1")
    np.testing.assert_array_equal(first, second)
    first, again, third = (_frame_speckle((0, 0, 0), name, posed=False) for name in "001")
    np.testing.assert_array_equal(first, again)
    assert abs(_alike(first, third)) < 0.1


# --- Raw samples averaged in a range bin: looks, targets, and nothing changed without ---

WIDE_EDGE = (slice(12, -12), slice(20, -20))


def grey_of(settings, variant):
    observed_frame = observed(settings)
    effects = effects_of(settings, observed_frame, variant)
    sample = scene_of(observed_frame).sample(variant, effects)
    return sample.noisy([effect.name for effect in effects]), sample.mean


@pytest.mark.parametrize(("window", "samples"), [("uniform", 2), ("hamming", 4)])
def test_averaged_samples_are_worth_their_looks(window, samples):
    display = {"kind": "log", "percentile": 50, "reference": 0.6, "dynamic_range_db": 80}
    array = {"bandwidth_khz": 60.0, "pulse": {"window": window}}
    settings = config(
        noise=SPECKLE,
        sonar={
            "range_bins": 96, "samples_per_bin": samples, "array": array, "transfer": display,
        },
    )  # fmt: skip
    actual = [grey_of(settings, variant) for variant in range(4)]
    scene = scene_of(observed(settings))
    assert scene.shape == (96 * samples, 128)
    looks = expected.looks(scene.kernel, samples)
    assert 1 < looks < samples
    noisy = np.stack([image for image, _ in actual])[(slice(None), *WIDE_EDGE)]
    assert noisy.shape[1:] == (72, 88)
    clean = actual[0][1][WIDE_EDGE]
    decibels = 80 * (noisy - clean).std()
    assert decibels == pytest.approx(4.343 * np.sqrt(special.polygamma(1, looks)), rel=0.06)
    # mean_log: the average of the noisy images.
    assert abs(float((noisy.mean(axis=0) - clean).mean())) < 0.006


# --- Speckle by the phase of the two-way path ---

DEVICE = {"array": {"beamwidth_deg": 1.0, "bandwidth_khz": 60.0}}
SETTINGS = config(noise={"path_speckle": {}}, sonar=DEVICE)
RANGE_M = 6.0
STEP_M = RANGE_M * np.deg2rad(24 / 128)  # one beam, at that range
INSIDE = (slice(20, -20), slice(20, -20))


def field_at(sway_m, settings=SETTINGS):
    """(ping, complex field) of the slope from a place along which it is the same."""
    frame, rendered = slope((sway_m, 0.0, 0.0))
    observed_frame = observe(frame, rendered, settings)
    ping = ping_of(observed_frame)
    (effect,) = effects_of(settings, observed_frame)
    empty = Signal(ping.scatterers.power, np.zeros((1, 2, *ping.shape), np.float32))
    real, imaginary = beamform(effect.apply(empty, ping).field, ping)[0]
    return ping, real + 1j * imaginary


@pytest.fixture(scope="module")
def at_rest():
    return field_at(0.0)


def test_power_and_distribution_are_those_of_speckle(at_rest):
    ping, field = at_rest
    intensity = (abs(field) ** 2 / beamform_power(ping.scatterers.power, ping))[INSIDE]
    assert 10 * np.log10(intensity.mean()) == pytest.approx(0, abs=0.25)
    assert intensity.var() / intensity.mean() ** 2 == pytest.approx(1, abs=0.12)


@pytest.mark.parametrize("beams", [1, 2, 3])
def test_movement_across_takes_it_as_the_aperture_says(at_rest, beams):
    ping, before = at_rest
    moved_m = beams * STEP_M
    _, after = field_at(moved_m)
    rows = np.abs(ping.range_m - RANGE_M) < 0.3
    waves = 2 * np.pi * 1000 * ping.sonar.frequency_khz / ping.water.sound_speed_m_s()
    sine = np.sin(ping.sonar.beam_centres_rad())
    # The beam's middle comes nearer as a whole; what is left over is lost.
    tilt = np.exp(-2j * waves * moved_m * sine)
    weights = mixing(ping.sonar)[64].astype(np.float64) ** 2
    expected = abs((weights * np.exp(2j * waves * moved_m * sine)).sum())
    actual = []
    for sign in (1, -1):
        for way in (1, -1):
            turned = np.roll(after, way * beams, axis=1) * (tilt if sign > 0 else tilt.conj())
            product = (before * turned.conj())[rows][:, 20:-20]
            powers = [(abs(x[rows][:, 20:-20]) ** 2).sum() for x in (before, turned)]
            # Phases differ from row to row by the bow of the wave.
            actual.append(abs(product.sum(axis=1)).sum() / np.sqrt(powers[0] * powers[1]))
    assert max(actual) == pytest.approx(expected, abs=0.08)


def test_a_sonar_at_rest_sees_the_same_to_the_byte():
    pairs = []
    for name in ("0", "1"):
        frame, rendered = slope((0.01, 0.0, 0.0), name)
        pairs.append(make_pair(observe(frame, rendered, SETTINGS), 0, SETTINGS))
    assert np.array_equal(pairs[0].noisy, pairs[1].noisy)


# --- Partly static speckle: what the clean image keeps of it ---


@cache
def images(standing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noisy, clean, and without speckle, inside of the image; the transfer curve is linear."""
    settings = config(
        noise={"speckle": {}},
        acoustics={"standing": standing},
        sonar={"transfer": {"kind": "linear", "reference": 0.1, "percentile": 50}},
    )
    observed_frame = observe(*constant_field(), settings)
    sample = observed_frame.scene.sample(0, effects_of(settings, observed_frame))
    noisy = sample.noisy({"speckle"})
    assert isinstance(sample, CoherentSample)
    clean = sample.mean
    bare = sample.without({"speckle"})
    return noisy[8:-8, 8:-8], clean[8:-8, 8:-8], bare[8:-8, 8:-8]


def intensity(image: np.ndarray) -> np.ndarray:
    """Over that of the mean image, so that range has no part in it."""
    return np.asarray((image.astype(np.float64) / images(0.0)[1]) ** 2)


def likeness(first: np.ndarray, second: np.ndarray) -> float:
    """Correlation of intensities."""
    return float(np.corrcoef(intensity(first).ravel(), intensity(second).ravel())[0, 1])


def test_fully_static_speckle_is_the_clean_image() -> None:
    noisy, clean, bare = images(1.0)
    np.testing.assert_allclose(clean, noisy, atol=2e-3)
    np.testing.assert_array_equal(bare, clean)


@pytest.mark.parametrize("part", [0.25, 0.5, 0.75])
def test_the_clean_image_is_as_like_the_noisy_one_as_fields_of_such_a_part(part: float) -> None:
    """|f|^2 of two circular fields whose coherence is sqrt(p) correlate by p (Goodman, 2007)."""
    noisy, clean, _ = images(part)
    assert likeness(noisy, clean) == pytest.approx(part, abs=0.08)
    # Averaging took the rest of an exponential intensity, whose contrast is 1.
    power = intensity(clean)
    assert part - 0.1 < power.std() / power.mean() < 1
