"""The sonar equation against golden values, and every device as it ships against closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.schema import config_hash as digest
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.frames.frame import Frame
from simnfnd.factory.simulation.imaging.coherent import received
from simnfnd.factory.simulation.imaging.effect import DrawnEffect
from simnfnd.factory.simulation.imaging.scatterers import scatterers
from simnfnd.factory.simulation.imaging.signal import Ping, Signal, beamform, beamform_power, mixing
from simnfnd.factory.simulation.noise.receiver import receiver
from simnfnd.factory.simulation.noise.speckle import SPECKLE
from simnfnd.factory.simulation.noise.volume import volume
from simnfnd.factory.simulation.pairs.pair_maker import make_pair, observe
from simnfnd.factory.simulation.render.base import Mount, Rendered
from simnfnd.factory.simulation.sonar import array
from simnfnd.factory.simulation.sonar.array import (
    ArraySettings,
    Taper,
    WaterSettings,
    thermal_noise_db,
)
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from simnfnd.factory.simulation.sonar.surface import LitSurface, mount_weight
from simnfnd.factory.simulation.sonar.window import Window
from tests.constant_field import coherent, config, constant_field, observed, ping_of
from tests.factory.simulation.moving import stage
from tests.sonar_presets import NAMES, sonar_preset

SEA = {100: 0.0336, 375: 0.0898, 720: 0.2086, 750: 0.2223, 900: 0.2994, 1200: 0.4953,
       1800: 1.0547, 2100: 1.4183, 3000: 2.8447}  # fmt: skip
FRESH = {750: 0.1460, 1200: 0.3737, 1800: 0.8408, 3000: 2.3355}


@pytest.mark.parametrize(
    ("water", "table"), [(WaterSettings(10, 35, 5, 8), SEA), (WaterSettings(15, 0, 5, 8), FRESH)]
)
def test_absorption(water, table):
    actual = [water.absorption_db_per_m(frequency_khz) for frequency_khz in table]
    assert actual == pytest.approx(list(table.values()), abs=1e-3)


def test_thermal_noise_is_mellens() -> None:
    assert array.thermal_noise_db(1000, 0.001) == pytest.approx(45)
    assert array.thermal_noise_db(1000, 10) == pytest.approx(85)


@pytest.mark.parametrize(
    ("taper", "golden_db", "within_db"),
    [
        (Taper(window="uniform"), -13.26, 0.02),
        (Taper(window="hann"), -31.47, 0.05),
        (Taper(window="hamming"), -42.7, 0.1),
        (Taper(window="taylor", sidelobe_db=30), -30, 0.5),
        (Taper(window="chebyshev", sidelobe_db=50), -50, 0.1),
    ],
)
def test_sidelobes_are_those_of_the_window(taper, golden_db, within_db):
    u = np.linspace(0, 12, 12_001)
    level_db = 20 * np.log10(np.abs(array.response(u, taper)) + 1e-9)
    null = int(np.argmax(np.diff(level_db) > 0))
    assert level_db[null:].max() == pytest.approx(golden_db, abs=within_db)


@pytest.mark.parametrize("window", ["uniform", "hann", "hamming", "taylor", "chebyshev"])
def test_beams_are_as_wide_as_they_are_said_to_be(window):
    taper = Taper(window=window)
    length = array.aperture_wavelengths(2.0, taper)
    assert array.response(np.sin(np.deg2rad(1.0)) * length, taper) ** 2 == pytest.approx(
        0.5, rel=1e-3
    )
    if window == "uniform":
        assert length == pytest.approx(50.8 / 2.0, rel=0.01)


def test_range_resolution_is_c_over_2b() -> None:
    device = ArraySettings(bandwidth_khz=30)
    assert array.range_resolution_m(device, 1500) == pytest.approx(0.025)
    kernel = array.range_kernel(0.001, replace(device, pulse=Taper(window="uniform")), 1500)
    middle = len(kernel) // 2
    assert kernel[middle + 25] == pytest.approx(0, abs=1e-6)  # the first null
    assert array.range_kernel(1.0, device, 1500) == pytest.approx([1])


@given(
    st.integers(2, 100), st.floats(5, 160), st.floats(0.1, 10),
    st.sampled_from(["uniform", "hann", "hamming", "taylor", "chebyshev"]), st.booleans(),
)  # fmt: skip
@settings(max_examples=8, deadline=None)
def test_beam_mixing_keeps_energy_for_any_beams(beams, hfov_deg, width_deg, window, tabled):
    table = None
    if tabled:  # as close together in the middle as a linear array makes them
        half = np.sin(np.deg2rad(hfov_deg / 2))
        table = tuple(np.rad2deg(np.arcsin(np.linspace(-0.99, 0.99, beams) * half)))
    sonar = SonarSettings(hfov_deg=hfov_deg, beams=beams, beam_azimuths_deg=table)
    device = ArraySettings(beamwidth_deg=width_deg, horizontal=Taper(window=window))
    mixing = array.beam_mixing(sonar.beam_centres_rad(), device)
    np.testing.assert_allclose((mixing.astype(np.float64) ** 2).sum(axis=1), 1, rtol=1e-5)


@pytest.mark.parametrize(
    "words",
    [
        [], ["sonar.beams=129"], ["sonar.beams=512"], ["sonar=oculus_m1200d_hf"],
        ["sonar.beams=6", "sonar.beam_azimuths_deg=[-20,-11,-3,5,9,20]", "sonar.hfov_deg=45"],
    ],
    ids=["halves", "odd", "modes", "modes of a device", "lopsided"],
)  # fmt: skip
def test_fast_beams_are_the_matrix_product(words):
    """To 2e-5 of the row's strongest number, and intensities never below zero."""
    frame, rendered = constant_field(size=(60, 80))
    ping = ping_of(observe(frame, rendered, compose_config(["experiment=physical", *words])))
    field = np.random.default_rng(3).standard_normal((1, 2, *ping.shape)).astype(np.float32)
    power = np.zeros(ping.shape, np.float32)
    power[:, -1] = 1  # on one side alone
    matrix = mixing(ping.sonar).astype(np.float64)
    along = np.apply_along_axis(np.convolve, 2, field.astype(np.float64), ping.kernel, "same")
    expected = along @ matrix
    error = np.abs(beamform(field, ping) - expected) / np.abs(expected).max(axis=-1, keepdims=True)
    assert error.max() < 2e-5
    along = np.apply_along_axis(np.convolve, 0, power.astype(np.float64), ping.kernel**2, "same")
    blurred = beamform_power(power, ping)
    assert blurred.min() >= 0
    np.testing.assert_allclose(blurred, along @ matrix**2, atol=2e-5)


def _powers(depths_m: np.ndarray, plate_m: float, frequency_khz: float) -> np.ndarray:
    """Total echo power of a plate that faces the sonar, at each distance."""
    settings_ = config(
        sonar={"frequency_khz": frequency_khz, "vfov_deg": 60,
               "range": {"auto": False, "min_m": 0.5, "max_m": 40}, "range_bins": 2048},
    )  # fmt: skip
    totals = []
    for depth_m in depths_m:
        frame, _ = constant_field(size=(960, 960))
        camera = replace(frame.intrinsics, fx=3000.0, fy=3000.0, cx=480.0, cy=480.0)
        u = (np.arange(960) - 480) / 3000
        inside = (np.abs(u) < plate_m / 2 / depth_m)[:, None] & (np.abs(u) < plate_m / 2 / depth_m)
        depth = np.where(inside, np.float32(depth_m), np.float32(0))
        square = 1 + u[:, None] ** 2 + u**2
        # albedo cos / r^2 with the normal towards the camera
        radiance = np.where(inside, square**-1.5 / depth_m**2, 0).astype(np.float32)
        frame = replace(frame, depth_m=depth, intrinsics=camera)
        window = Window("slant_range", 0.5, 40.0, -0.2, 0.2)
        plate = LitSurface(frame, Rendered(radiance, inside), window, settings_.sonar)
        plate_scatterers = scatterers(plate, settings_.water, coherent(settings_))
        totals.append(plate_scatterers.power.sum(dtype=np.float64))
    return np.array(totals)


@pytest.mark.parametrize("frequency_khz", [100, 900, 3000])
def test_a_small_target_loses_40_log_r_and_twice_the_absorption(frequency_khz):
    """mu * area / r^4 for a plate seen face on: its target strength minus 2 TL, the area once."""
    depths_m = np.array([2.0, 3.0, 4.0, 8.0])
    level_db = 10 * np.log10(_powers(depths_m, 0.2, frequency_khz))
    absorption = WaterSettings(10, 35, 5, 8).absorption_db_per_m(frequency_khz)
    golden_db = -25 + 10 * np.log10(0.04) - 40 * np.log10(depths_m) - 2 * absorption * depths_m
    np.testing.assert_allclose(level_db, golden_db, atol=0.1)


def test_materials_differ_as_the_table_says() -> None:
    frame, rendered = constant_field()
    labels = np.zeros(frame.depth_m.shape, np.uint8)
    labels[:, : labels.shape[1] // 2] = 9  # Tire
    frame = replace(frame, segmentation=labels)
    settings_ = config(acoustics={"reflectivity_db": {"Background": -25, "Tire": -15}})
    window = observe(frame, rendered, settings_).window
    lit_ = LitSurface(frame, rendered, window, settings_.sonar)
    lit_scatterers = scatterers(lit_, settings_.water, coherent(settings_))
    halves = lit_scatterers.power[:, :60].mean(), lit_scatterers.power[:, -60:].mean()
    assert halves[0] / halves[1] == pytest.approx(10, rel=0.02)
    with pytest.raises(FactoryError, match="Tyre"):
        config(acoustics={"reflectivity_db": {"Tyre": -10}})


def test_tvg_levels_what_it_knows() -> None:
    """40 log r + 2 a r undoes the losses of the constant field's opposite: here, power per bin."""
    of = ping_of(observed(config(acoustics={"tvg_log": 0, "tvg_absorption": True})))
    expected = beamform_power(of.scatterers.power, of) * of.gain[:, None]
    rows = expected[30:-30].mean(axis=1)
    assert rows.max() / rows.min() == pytest.approx(1, abs=0.05)


def test_the_papers_data_set_does_not_know_of_physics() -> None:
    """Settings that do not reach its images do not reach its name either."""
    plain = compose_config([])
    assert not {"acoustics", "water"} & set(identity(plain))
    assert "array" not in identity(plain)["sonar"]
    physical = [compose_config(["experiment=physical", f"water={w}"]) for w in ("sea", "fresh")]
    assert len({digest(identity(settings_)) for settings_ in physical}) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["noise=physical"], "noise.speckle acts on the complex field; set acoustics=coherent"),
        (["acoustics=coherent"], "noise.range_spreading moves points"),
        (["experiment=physical", "resample.rate=0.4"], "resample thins points"),
        (["experiment=physical", "noise.speckle.looks=0"], "noise.speckle.looks: must lie in"),
        (["sonar.array.horizontal.window=square"], "sonar.array.horizontal.window"),
        (["water.ph=3"], "water.ph"),
        (["sonar.range_bins=4000", "sonar.samples_per_bin=4"], "samples_per_bin"),
    ],
)
def test_mistakes_are_one_line(words, said):
    with pytest.raises(FactoryError) as caught:
        compose_config(words)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


# --- Levels of the paper's points, and the weight of an offset mount ---


def test_points_twenty_decibels_down_are_not_black_at_forty() -> None:
    """Half of the image has a hundredth of the echo: half the grey scale of 40 dB."""
    settings = compose_config(
        ["sonar.transfer={kind: log, dynamic_range_db: 40, percentile: 99}", "noise=none",
         "sonar.hfov_deg=24", "sonar.range={auto: false, min_m: 4, max_m: 8}", "resample.rate=1",
         "sonar.image.layout=polar", "dataset.dtype=float32", "sonar.tvg_db_per_decade=0",
         "sonar.projection=slant_range", "sonar.beams=64", "sonar.range_bins=64"]
    )  # fmt: skip
    frame, rendered = constant_field()
    radiance = rendered.radiance.copy()
    radiance[:, : radiance.shape[1] // 2] /= 100
    observed = observe(frame, Rendered(radiance, rendered.surface), settings)
    clean = make_pair(observed, 0, settings).clean.astype(np.float64)
    weak = clean[8:-8, 8:24].mean()
    strong = clean[8:-8, 40:56].mean()
    assert strong - weak == pytest.approx(0.5, abs=0.01)


def test_points_of_an_offset_mount_have_the_area_that_a_pixel_sees() -> None:
    """A wall before both: cos_s / cos_c (r_c / r_s)^2."""
    frame, _ = constant_field(size=(240, 320))
    camera = replace(frame.intrinsics, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
    frame = replace(frame, depth_m=np.full((240, 320), 4, np.float32), intrinsics=camera)
    mount = Mount(translation_m=(0.5, 0.8, -0.3))
    u = (np.arange(320) - 160) / 300
    v = ((np.arange(240) - 120) / 300)[:, None]
    ahead = 4 - 0.5
    left = -4 * u - 0.8
    up = -4 * v + 0.3
    camera_m2 = 16 * (1 + u**2 + v**2)
    sonar_m2 = ahead**2 + left**2 + up**2
    cosines = (ahead / np.sqrt(sonar_m2)) / (4 / np.sqrt(camera_m2))
    golden = cosines * camera_m2 / sonar_m2
    weight = mount_weight(frame, mount, 2)
    np.testing.assert_allclose(weight[2:-2, 2:-2], golden[2:-2, 2:-2], rtol=2e-3)

    settings = compose_config(["render=embree", "sonar.tvg_db_per_decade=0"]).sonar
    sonar = replace(settings, mount=mount, hfov_deg=60.0, vfov_deg=60.0)
    radiance = np.ones((240, 320), np.float32)
    window = Window("slant_range", 1.0, 9.0, -0.5, 0.5)
    surface = LitSurface(frame, Rendered(radiance, radiance > 0), window, sonar)
    echoes, pixel, _ = surface.insonified
    np.testing.assert_allclose(echoes.strength, weight.ravel()[pixel], rtol=1e-6)
    with_camera = replace(surface, sonar=replace(sonar, mount=Mount()))
    assert (with_camera.insonified.echoes.strength == 1).all()


# --- Every device as it ships: power, grain, noise and beams against closed forms ---

# Devices of one maker differ in numbers alone: the quick tests take every other one.
SOME_DEVICES = [
    pytest.param(name, marks=[pytest.mark.slow] if number % 2 else [])
    for number, name in enumerate(NAMES)
]
# One of each array and its beams: the others differ in numbers that the closed forms below have.
QUICK = ("camera_matched", "aris_1800_hf", "aris_3000", "oculus_m1200d_hf", "ping360")
OTHERS = ("blueview_p900_90", "didson_lf", "gemini_720is", "oculus_m750d_lf", "sonoptix_echo")
RECIPES = [
    *(f"sonar={device}" for device in QUICK),
    *(pytest.param(f"sonar={device}", marks=pytest.mark.slow) for device in OTHERS),
    "experiment=aris_mdd",
]
# Half-power points of the squared sinc and of the Hamming window's response, and the integrals of
# both over their argument: 1 by Parseval, and (0.54^2 + 0.46^2 / 2) / 0.54^2.
HALF_POWER = {"uniform": 0.442946, "hamming": 0.6515}
INTEGRAL = {"uniform": 1.0, "hamming": 1.3628}


@cache
def composed(recipe: str, *words: str) -> FactoryConfig:
    recipe_words = ["experiment=physical", recipe] if recipe.startswith("sonar") else [recipe]
    return compose_config([*recipe_words, *words])


@cache
def ground() -> tuple[Frame, Rendered]:
    """The constant field, from 2.2 to 4.4 m: within the range of every device."""
    frame, rendered = constant_field()
    return replace(frame, depth_m=frame.depth_m * np.float32(0.55)), rendered


def listened(settings: FactoryConfig) -> Ping:
    return ping_of(observe(*ground(), settings))


def lit(ping: Ping) -> tuple[slice, slice]:
    """Bins away from the edges of the window and of what the camera saw."""
    beams = np.flatnonzero(ping.scatterers.power.any(axis=0))
    rows = np.flatnonzero(ping.scatterers.power.any(axis=1))
    edge_rows = int(np.ceil(0.12 / ping.bin_m))
    inner = max(int(0.2 * len(beams)), 2)
    return (
        slice(rows[0] + edge_rows, rows[-1] - edge_rows),
        slice(beams[0] + inner, beams[-1] - inner),
    )


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def decibels(ratio: Any) -> Any:
    return 10 * np.log10(ratio)


def intensity(field: np.ndarray) -> np.ndarray:
    return np.asarray((field.astype(np.float64) ** 2).sum(axis=1).mean(axis=0))


@pytest.mark.parametrize("recipe", RECIPES)
def test_speckle_has_the_power_and_the_grain_that_the_device_gives_it(recipe):
    """Mean intensity within 0.2 dB of the expected; bins as alike as the pulse makes them."""
    settings = composed(recipe)
    ping = listened(settings)
    inner = lit(ping)
    expected = (beamform_power(ping.scatterers.power, ping) * ping.gain[:, None])[inner]
    many_looks, one_look = (
        received(
            ping,
            [DrawnEffect("speckle", SPECKLE, {"looks": n}, 0, (n,))],
        )
        for n in (8, 1)
    )
    assert decibels((many_looks[inner] ** 2 / expected).mean()) == pytest.approx(0, abs=0.2)
    single = one_look[inner] ** 2 / expected - 1
    kernel = np.append(ping.kernel, 0)
    alike = float((kernel[1:] * kernel[:-1]).sum() / (kernel**2).sum()) ** 2
    assert (single[1:] * single[:-1]).mean() / (single**2).mean() == pytest.approx(alike, abs=0.06)


@pytest.mark.parametrize("device", SOME_DEVICES)
def test_noise_and_haze_are_those_of_the_closed_forms(device):
    """Both over the echo of a surface of known backscatter, in what pulse and beam hold of each."""
    settings = composed(f"sonar={device}")
    ping = listened(settings)
    sonar = settings.sonar
    rows, beams = lit(ping)
    device_ = sonar.array
    water = settings.water
    across = device_.horizontal.window
    upright = device_.vertical.window
    beam_rad = (INTEGRAL[across] / HALF_POWER[across]) * np.sin(
        np.deg2rad(device_.beamwidth_deg) / 2
    )
    one_way = (INTEGRAL[upright] / HALF_POWER[upright]) * np.sin(np.deg2rad(sonar.vfov_deg) / 2)
    pulse_m = water.sound_speed_m_s() / 2000 / device_.bandwidth_khz
    pulse_m *= INTEGRAL[device_.pulse.window] * HALF_POWER["uniform"]
    pulse_m /= HALF_POWER[device_.pulse.window]
    centre = beams.start + (beams.stop - beams.start) // 2
    azimuth = sonar.beam_centres_rad()
    width = (azimuth[centre + 1] - azimuth[centre - 1]) / 2

    silence = np.zeros((1, 2, *ping.shape), np.float32)
    noise = intensity(receiver(silence.copy(), ping, rng(), level_db=7, grain="sample"))
    noise_db = (
        thermal_noise_db(sonar.frequency_khz, device_.bandwidth_khz)
        - decibels(4 * np.pi / (beam_rad * one_way)) - device_.source_level_db + 7
    )  # fmt: skip
    # What is received of an echo of density p is p pulse beam; the image has p dr dtheta.
    noise_db += decibels(ping.bin_m * width * np.cos(azimuth[centre]) / (pulse_m * beam_rad))
    near = slice(max(centre - 3, 0), centre + 4)
    assert decibels(noise[:, near].mean()) == pytest.approx(noise_db, abs=0.2)

    empty = Signal(np.zeros(ping.shape, np.float32), silence)
    haze = intensity(volume(empty, ping, rng(), strength_db=-50).field)
    row = (rows.start + rows.stop) // 2
    some = slice(row - 20, row + 21)
    range_m = ping.range_m.astype(np.float64)[some]
    two_way = 2 / 3 * np.sin(np.deg2rad(sonar.vfov_deg) / 2) / HALF_POWER["uniform"]
    assert upright == "uniform"
    absorbed_db = 2 * water.absorption_db_per_m(sonar.frequency_khz) * range_m
    level = 10**-5 * width * two_way * ping.bin_m / range_m**2 * 10 ** (-absorbed_db / 10)
    relative = haze[some, near] / level[:, None]
    assert decibels(relative.mean()) == pytest.approx(0, abs=0.35)  # of 287 bins
    assert decibels(haze[some].mean(axis=1) / level).mean() == pytest.approx(
        decibels(np.gradient(azimuth).mean() / width), abs=0.2
    )


@pytest.mark.parametrize("device", NAMES)
def test_no_grating_lobe_lies_in_the_sector(device):
    sonar = sonar_preset(device)
    mixing = array.beam_mixing(sonar.beam_centres_rad(), sonar.array)
    sine = np.sin(sonar.beam_centres_rad())
    length = array.aperture_wavelengths(sonar.array.beamwidth_deg, sonar.array.horizontal)
    first = np.abs(mixing[0]) / np.abs(mixing[0]).max()
    beyond = first[np.abs(sine - sine[0]) * length > 2.0]
    ceiling_db = {"uniform": -13.0, "hamming": -42.0}[sonar.array.horizontal.window]
    assert 20 * np.log10(beyond.max() + 1e-9) < ceiling_db


def test_a_narrow_beam_has_no_grating_lobe_either() -> None:
    """0.4 degrees over 130: 256 elements had the strongest of the lobes 28 degrees away."""
    taper = Taper(window="hamming")
    length = array.aperture_wavelengths(0.4, taper)
    apart = np.linspace(2.0, 2 * length * np.sin(np.deg2rad(65)), 20_000)
    assert 20 * np.log10(np.abs(array.response(apart, taper)).max()) < -42


@pytest.mark.parametrize("window", ["uniform", "hann", "hamming", "taylor"])
def test_shading_leaves_the_pulse_as_long_as_the_bandwidth_says(window):
    """0.886 c / 2B at -3 dB, for any window of the spectrum."""
    device = replace(composed("sonar=camera_matched").sonar.array, pulse=Taper(window=window))
    kernel = array.range_kernel(1e-4, replace(device, bandwidth_khz=75), 1500)
    power = kernel.astype(np.float64) ** 2 / kernel.max() ** 2
    assert (power >= 0.5).sum() * 1e-4 == pytest.approx(0.886 * 0.01, rel=0.02)
    assert power.sum() * 1e-4 == pytest.approx(
        array.pulse_length_m(replace(device, bandwidth_khz=75), 1500), rel=0.02
    )


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(60, -10), (-40, 8), (5, -9), (0, 9)])
def test_beams_of_a_line_array_are_cones(azimuth_deg, elevation_deg):
    """sin(bearing) = sin(azimuth) cos(elevation), 1.47 degrees from the azimuth at (60, -10)."""
    settings = composed(
        "sonar=oculus_m750d_lf", "sonar.range={auto: false, min_m: 1, max_m: 20}",
        "sonar.image.layout=polar",
    )  # fmt: skip
    frame, _ = ground()
    camera = replace(frame.intrinsics, fx=200.0, fy=200.0, cx=400.0, cy=100.0)
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    column = round(400 + 200 * np.tan(azimuth))
    row = round(100 - 200 * np.tan(elevation) / np.cos(azimuth))
    depth_m = np.zeros((200, 800), np.float32)
    radiance = np.zeros((200, 800), np.float32)
    depth_m[row, column] = 4.0
    radiance[row, column] = 1.0
    frame = replace(frame, depth_m=depth_m, intrinsics=camera, rgb=np.zeros((200, 800, 3), "u1"))
    window = Window("slant_range", 1, 20, -1.2, 1.2)
    target = LitSurface(frame, Rendered(radiance, depth_m > 0), window, settings.sonar)
    target_scatterers = scatterers(target, settings.water, coherent(settings))
    point = np.array([(column - 400) / 200, (row - 100) / 200, 1.0])
    golden = np.rad2deg(np.arcsin(point[0] / np.linalg.norm(point)))
    beam = int(np.flatnonzero(target_scatterers.power.any(axis=0))[0])
    assert np.rad2deg(settings.sonar.beam_centres_rad())[beam] == pytest.approx(golden, abs=0.13)


def test_beam_tables_are_those_of_recordings() -> None:
    """ARIS beams as the maker measured them; Oculus beams in equal steps of the sine."""
    aris = composed("sonar=aris_3000").sonar.beam_azimuths_deg
    assert aris is not None
    assert (aris[0], aris[-1], len(aris)) == (-15.0156, 15.0068, 128)
    narrow = composed("sonar=aris_1800_hf").sonar.beam_azimuths_deg
    assert narrow is not None
    spacing = np.diff(narrow)
    assert spacing.min() < 0.25 < 0.34 < spacing.max()  # the lens spreads them in the middle
    oculus = composed("sonar=oculus_m1200d_hf").sonar.beam_centres_rad()
    np.testing.assert_allclose(np.diff(np.sin(oculus)), 1 / 511, atol=2.5e-4)


def test_rows_of_the_camera_leave_no_stripes_on_far_ground() -> None:
    # From 6.4 to 7.8 m a row of the camera covers three range bins or more.
    levels_db = [
        decibels(ping_of(observe(*stage.plane(pitch_deg=6, rows=rows), stage.settings())).expected)
        for rows in (400, 1600)
    ]
    residual_db = (levels_db[0] - levels_db[1])[220:290, 20:76]
    assert abs(np.diff(residual_db, axis=0)).mean() < 0.02
