"""Speckle by the phase of the two-way path: theory of a moving aperture, power, a sonar at rest."""

import numpy as np
import pytest

from simnfnd.factory.errors import FrameError
from simnfnd.factory.imaging.signal import Signal, beamform, beamform_power
from simnfnd.factory.noise.speckle import PATH_SPECKLE, edge_m
from simnfnd.factory.pairs import make_pair, observe
from tests.constant_field import config, effects_of, ping_of, slope

DEVICE = {"array": {"beamwidth_deg": 1.0, "bandwidth_khz": 60.0}}
SETTINGS = config(noise={"path_speckle": {}}, sonar=DEVICE)
RANGE_M = 6.0
STEP_M = RANGE_M * np.deg2rad(24 / 128)  # one beam, at that range
INSIDE = (slice(20, -20), slice(20, -20))


def field_at(sway_m, settings=SETTINGS):
    """(ping, complex field) of the slope from a place along which it is the same."""
    frame, rendered = slope((sway_m, 0.0, 0.0))
    made = observe(frame, rendered, settings)
    ping = ping_of(made)
    (effect,) = effects_of(settings, made)
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
    weights = ping.mixing[64].astype(np.float64) ** 2
    expected = abs((weights * np.exp(2j * waves * moved_m * sine)).sum())
    found = []
    for sign in (1, -1):
        for way in (1, -1):
            other = np.roll(after, way * beams, axis=1) * (tilt if sign > 0 else tilt.conj())
            product = (before * other.conj())[rows][:, 20:-20]
            powers = [(abs(x[rows][:, 20:-20]) ** 2).sum() for x in (before, other)]
            # Phases differ from row to row by the bow of the wave.
            found.append(abs(product.sum(axis=1)).sum() / np.sqrt(powers[0] * powers[1]))
    assert max(found) == pytest.approx(expected, abs=0.08)


def test_a_sonar_at_rest_sees_the_same_to_the_byte():
    pairs = []
    for name in ("0", "1"):
        frame, rendered = slope((0.01, 0.0, 0.0), name)
        pairs.append(make_pair(observe(frame, rendered, SETTINGS), 0, SETTINGS))
    assert np.array_equal(pairs[0].noisy, pairs[1].noisy)


def test_cells_too_small_are_refused():
    frame, rendered = slope((0.0, 0.0, 0.0))
    ping = ping_of(observe(frame, rendered, SETTINGS))
    assert edge_m(ping) == 2.0 ** round(np.log2(edge_m(ping)))
    with pytest.raises(FrameError, match="scatterer_m"):
        PATH_SPECKLE.function(None, ping, None, looks=1, scatterer_m=1e-4)
