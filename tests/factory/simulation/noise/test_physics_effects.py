"""Each effect of the complex field: what it does to an image, alone and recorded."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.imaging.signal import Ping, Signal
from simnfnd.factory.simulation.noise.crosstalk import crosstalk
from simnfnd.factory.simulation.noise.draws import Draws, StreamNames, draw
from simnfnd.factory.simulation.noise.gains import BEAM_GAIN, SECTOR_EDGES, TVG_ERROR
from simnfnd.factory.simulation.noise.multipath import BOTTOM_MULTIPATH, SURFACE_MULTIPATH
from simnfnd.factory.simulation.noise.receiver import receiver
from simnfnd.factory.simulation.noise.registry import BUILT_IN, EFFECTS, NoiseSettings, blocks
from simnfnd.factory.simulation.noise.ringing import comb_lines, ring_down
from simnfnd.factory.simulation.noise.saturation import saturation
from simnfnd.factory.simulation.noise.scintillation import scintillation
from simnfnd.factory.simulation.noise.sidelobe_arcs import sidelobe_arcs
from simnfnd.factory.simulation.noise.spokes import spokes
from simnfnd.factory.simulation.pairs.pair_maker import ObservedFrame, make_pair
from simnfnd.factory.simulation.sonar.surface import vertical_table
from tests.constant_field import config, observed, ping_of

FIELD_EFFECTS = [name for name, effect in EFFECTS.items() if effect.stage != "points"]
EVERY: dict[str, dict[str, Any]] = {name: {} for name in FIELD_EFFECTS}


def ping(**keys: Any) -> Ping:
    return ping_of(observed(config(**keys)))


@pytest.fixture(scope="module")
def of() -> Ping:
    return ping()


def drawn(settings: FactoryConfig, observed_frame: ObservedFrame, variant: int = 0) -> Draws:
    return draw(
        settings.noise, 0, StreamNames.of(observed_frame.ref, variant, observed_frame.has_pose)
    )


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def silence(of: Ping, looks: int = 1) -> np.ndarray:
    return np.zeros((looks, 2, *of.shape), np.float32)


def decibels(intensity: np.ndarray | float) -> Any:
    return 10 * np.log10(intensity)


def intensity(field: np.ndarray) -> np.ndarray:
    return np.asarray((field.astype(np.float64) ** 2).sum(axis=1).mean(axis=0))


def test_the_registry_and_the_settings_name_the_same_effects() -> None:
    assert [item.name for item in fields(NoiseSettings)] == [*BUILT_IN, "own"]
    noise = compose_config(["experiment=physical"]).noise
    # Four are asked for by name (noise=moving, recording, any_sonar, aris_mdd).
    others = ("path_speckle", "drifting_volume", "scintillation", "sector_edges")
    assert list(blocks(noise)) == [name for name in EFFECTS if name not in others]
    for name, block in blocks(noise).items():
        assert type(block) is EFFECTS[name].settings
        names = [item.name for item in fields(block)]
        assert names == ["enabled", *(parameter.name for parameter in EFFECTS[name].parameters)]
    stages = [EFFECTS[name].stage for name in FIELD_EFFECTS]
    assert stages == sorted(stages, key=["echo", "beam", "image"].index)


def test_receiver_noise_is_rayleigh_and_flat_before_the_gain(of: Ping) -> None:
    """Its level is Mellen's for every device: imaging/test_physics.py."""
    noise = intensity(receiver(silence(of), of, rng(), level_db=7, grain="sample"))
    assert noise[:60].mean() == pytest.approx(noise[-60:].mean(), rel=0.05)
    amplitude = np.sqrt(noise)
    assert (amplitude.mean() / amplitude.std()) ** 2 == pytest.approx(3.66, rel=0.02)


@pytest.mark.parametrize("way", ["surface", "bottom"])
def test_multipath_comes_when_the_geometry_says(way):
    """A target straight ahead; the plane at 1 m: by way of it, and by way of it twice."""
    sonar = {"vfov_deg": 60, "array": {"vertical": {"window": "uniform"}}}
    of = ping(sonar=sonar, water={"depth_m": 1})
    power = np.zeros(of.shape, np.float32)
    row = 20
    beam = 64
    power[row, beam] = 1
    signal = Signal(power, silence(of))
    if way == "surface":
        mirrored = SURFACE_MULTIPATH.function(signal, of, rng(), loss_db=6, tilt_deg=0)
    else:
        mirrored = BOTTOM_MULTIPATH.function(signal, of, rng(), altitude_m=1, loss_db=6, tilt_deg=0)
    r = float(of.range_m[row])
    by_plane = np.hypot(r, 2.0)
    expected = [
        row,
        row + round((by_plane - r) / 2 / of.bin_m),
        row + round((by_plane - r) / of.bin_m),
    ]
    actual = np.flatnonzero(mirrored.power[:, beam] > 0)
    assert np.abs(actual - expected).max() <= 1
    assert np.flatnonzero(mirrored.power.sum(axis=0) > 0).tolist() == [beam]
    table = vertical_table(of.sonar)
    pattern = np.sqrt(table[np.rint((2.0 / by_plane + 1) * (len(table) // 2)).astype(int)])
    absorbed = 10 ** (-of.absorption_db_per_m * (by_plane - r) / 10)
    once = 10**-0.6 * (r / by_plane) ** 2 * pattern * absorbed
    assert mirrored.power[actual[1], beam] == pytest.approx(4 * once, rel=0.1)
    assert mirrored.power[actual[2], beam] == pytest.approx(once**2, rel=0.1)


def test_speckled_echoes_are_mirrored_with_the_same_strength() -> None:
    of = ping(sonar={"vfov_deg": 60}, water={"depth_m": 1})
    power = np.full(of.shape, 1, np.float32)
    field = rng().standard_normal((1, 2, *of.shape)).astype(np.float32) / np.sqrt(2).astype("f4")
    plain = SURFACE_MULTIPATH.function(Signal(power, silence(of)), of, rng(), loss_db=3, tilt_deg=5)
    zero = np.zeros(of.shape, np.float32)
    speckled = SURFACE_MULTIPATH.function(Signal(zero, field), of, rng(), loss_db=3, tilt_deg=5)
    rows = slice(60, None)
    # Field ghosts add to the field with random phases, so the means agree.
    assert intensity(speckled.field)[rows].mean() == pytest.approx(
        plain.power[rows].mean(), rel=0.1
    )


def test_arcs_leak_along_their_row_and_crosstalk_to_both_sides(of: Ping) -> None:
    field = silence(of)
    field[0, 0, 50, 64] = 2.0
    arcs = intensity(sidelobe_arcs(field.copy(), of, rng(), level_db=-30))
    np.testing.assert_allclose(decibels(np.delete(arcs[50], 64) / 4), -30, atol=0.01)
    assert arcs[:50].sum() == arcs[51:].sum() == 0
    leaked = intensity(crosstalk(field, of, rng(), level_db=-20, spacing_beams=8))
    assert np.flatnonzero(leaked[50]).tolist() == [56, 64, 72]
    assert leaked[50, 56] == pytest.approx(0.04, rel=1e-3)


def test_a_wrong_gain_tilts_the_image_about_its_middle(of: Ping) -> None:
    ones = np.ones((1, 2, *of.shape), np.float32)
    rows = decibels(
        intensity(TVG_ERROR.function(ones, of, rng(), db_per_decade=10, db_per_m=0.5))[:, 0] / 2
    )
    expected = 10 * np.log10(of.range_m / 6) + 0.5 * (of.range_m - 6)
    np.testing.assert_allclose(rows, expected, atol=1e-3)


def test_samples_tremble_alike_at_every_level_and_each_for_itself(of: Ping) -> None:
    field = np.ones_like(silence(of, looks=2))
    field[..., of.shape[1] // 2 :] *= 100
    level_db = decibels(intensity(scintillation(field.copy(), of, rng(), sigma_db=3) / field))
    for half in np.array_split(level_db, 2, axis=1):
        assert np.median(half) == pytest.approx(decibels(2), abs=0.1)
        assert half.std() == pytest.approx(3, rel=0.03)
    level_db -= level_db.mean()
    for near, far in ((level_db[1:], level_db[:-1]), (level_db[:, 1:], level_db[:, :-1])):
        assert abs((near * far).mean()) < 0.03 * level_db.var()
    still = scintillation(field.copy(), of, rng(), sigma_db=0)
    np.testing.assert_array_equal(still, field)


def test_beams_differ_some_are_dead_and_the_sides_of_the_sector_are_weak(of: Ping) -> None:
    ones = np.ones((1, 2, *of.shape), np.float32)
    gain = BEAM_GAIN.function(ones.copy(), of, rng(), sigma_db=1.0, dead=3, dead_db=-40)
    column = decibels(intensity(gain)[0] / 2)
    assert (np.isclose(column, -40, atol=1e-3)).sum() == 3
    assert column[column > -20].std() == pytest.approx(1, rel=0.2)
    assert np.ptp(intensity(gain), axis=0).max() == 0
    column = decibels(intensity(SECTOR_EDGES.function(ones, of, rng(), level_db=6))[0] / 2)
    bearing = of.sonar.beam_centres_rad() / (np.deg2rad(of.sonar.hfov_deg) / 2)
    np.testing.assert_allclose(column, -6 * bearing**2, atol=1e-4)


def test_the_device_is_the_same_in_all_frames_of_a_recording() -> None:
    noise = {"beam_gain": {"sigma_db": {"uniform": [0.5, 2]}, "dead": 1}}
    settings = config(noise=noise)
    draws_and_images = []
    for name in ("0", "1"):
        frame = observed(settings, name=name)
        draws = drawn(settings, frame)
        draws_and_images.append((draws, make_pair(frame, 0, settings).noisy))
    assert draws_and_images[0][0] == draws_and_images[1][0]
    np.testing.assert_array_equal(draws_and_images[0][1], draws_and_images[1][1])


@pytest.mark.parametrize("spacing", ["random", "regular"])
def test_spokes_are_bearings(of: Ping, spacing: str) -> None:
    count, width = (2, 1) if spacing == "random" else (4, 0.3)
    loud = intensity(
        spokes(
            silence(of), of, rng(), count=count, level_db=-20, width_beams=width, spacing=spacing
        )
    ).mean(axis=0)
    if spacing == "random":
        assert decibels(loud.max() / of.full_scale) == pytest.approx(-20, abs=1.5)
        assert 4 <= (loud > 0).sum() <= 20
        return
    centres = np.sort(np.flatnonzero(loud > loud.max() / 4) + 0.5)
    groups = np.split(centres, np.flatnonzero(np.diff(centres) > 4) + 1)
    steps = np.diff([group.mean() for group in groups])
    np.testing.assert_allclose(steps, of.sonar.beams / 4, atol=1)


def test_ring_down_dies_with_range(of: Ping) -> None:
    ringing = intensity(ring_down(silence(of), of, rng(), level_db=0, decay_db_per_m=10))
    rows = decibels(ringing.mean(axis=1) / of.full_scale)
    np.testing.assert_allclose(rows[:100], -10 * of.range_m[:100], atol=1.5)


def test_comb_lines_are_equally_far_apart(of: Ping) -> None:
    lines = intensity(
        comb_lines(silence(of), of, rng(), level_db=0, spacing_m=0.5, decay_db=2, uneven_db=0)
    )
    rows = np.flatnonzero(lines.sum(axis=1))
    np.testing.assert_allclose(of.range_m[rows], 4 + 0.5 * np.arange(len(rows)), atol=of.bin_m)
    steps = np.diff(decibels(lines[rows, 0]))
    np.testing.assert_allclose(steps, -2, atol=1e-3)


def test_saturation_limits_and_leaves_the_rest(of: Ping) -> None:
    limit = of.strongest * 10**0.3 * of.gain[:, None]
    field = silence(of)
    field[0, 0] = np.sqrt(np.linspace(0.1, 10, of.shape[1]) * limit)
    clipped = saturation(field.copy(), of, rng(), level_db=3)
    assert (intensity(clipped) <= limit * 1.0001).all()
    under = intensity(field) < limit * 0.999
    np.testing.assert_array_equal(clipped[0, 0][under], field[0, 0][under])


def test_each_layer_is_its_effect_alone():
    """Every effect, each as strong as to show."""
    noise = {
        **EVERY,
        "receiver": {"level_db": 40}, "volume": {"strength_db": -30},
        "drifting_volume": {"strength_db": -30},
        "surface_multipath": {"loss_db": 0}, "bottom_multipath": {"loss_db": 0, "altitude_m": 0.5},
        "tvg_error": {"db_per_decade": 6}, "crosstalk": {"level_db": -10},
        "sidelobe_arcs": {"level_db": -10}, "beam_gain": {"sigma_db": 2},
        "spokes": {"level_db": -3}, "ring_down": {"level_db": 60, "decay_db_per_m": 12},
        "comb_lines": {"level_db": 10, "spacing_m": 0.4, "decay_db": 1},
        "saturation": {"level_db": -3}, "background": {"enabled": True, "density": 0.1},
    }  # fmt: skip
    settings = config(
        noise=noise, water={"depth_m": 0.6}, dataset={"layers": ["effects"], "dtype": "float32"},
        sonar={"vfov_deg": 60, "transfer": {"kind": "log", "reference": 0.7}},
    )  # fmt: skip
    observed_frame = observed(settings, size=(320, 240))
    pair = make_pair(observed_frame, 0, settings)
    names = {*EVERY, "background"}
    assert set(pair.layers) == {f"layers/{name}" for name in names}
    for name in names:
        layer = pair.layers[f"layers/{name}"]
        others = {
            silent: replace(getattr(settings.noise, silent), enabled=False)
            for silent in names - {name}
        }
        alone = replace(settings, noise=replace(settings.noise, **others))
        np.testing.assert_array_equal(make_pair(observed_frame, 0, alone).noisy, layer)
        assert (layer != pair.clean).mean() > 0.005, name
        assert 0 <= layer.min() <= layer.max() <= 1
