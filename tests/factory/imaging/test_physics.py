"""The sonar equation against golden values: absorption, beams, pulse, losses, energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import digest, identity
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.imaging.scatterers import scatterers
from simnfnd.factory.imaging.signal import beamform, beamform_power
from simnfnd.factory.pairs import make_pair, observe
from simnfnd.factory.render.base import Mount, Rendered
from simnfnd.factory.sonar import array, transfer
from simnfnd.factory.sonar.array import ArraySettings, Taper, WaterSettings
from simnfnd.factory.sonar.settings import SonarSettings, TransferSettings
from simnfnd.factory.sonar.surface import LitSurface, mount_weight
from simnfnd.factory.sonar.window import Window
from tests.constant_field import config, constant_field, observed, ping_of

SEA = {100: 0.0336, 375: 0.0898, 720: 0.2086, 750: 0.2223, 900: 0.2994, 1200: 0.4953,
       1800: 1.0547, 2100: 1.4183, 3000: 2.8447}  # fmt: skip
FRESH = {750: 0.1460, 1200: 0.3737, 1800: 0.8408, 3000: 2.3355}


@pytest.mark.parametrize(
    ("water", "table"), [(WaterSettings(10, 35, 5, 8), SEA), (WaterSettings(15, 0, 5, 8), FRESH)]
)
def test_absorption(water, table):
    found = [water.absorption_db_per_m(frequency_khz) for frequency_khz in table]
    assert found == pytest.approx(list(table.values()), abs=1e-3)


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
    made = ping_of(observe(frame, rendered, compose_config(["experiment=physical", *words])))
    field = np.random.default_rng(3).standard_normal((1, 2, *made.shape)).astype(np.float32)
    power = np.zeros(made.shape, np.float32)
    power[:, -1] = 1  # on one side alone
    mixing = made.mixing.astype(np.float64)
    along = np.apply_along_axis(np.convolve, 2, field.astype(np.float64), made.kernel, "same")
    expected = along @ mixing
    error = np.abs(beamform(field, made) - expected) / np.abs(expected).max(axis=-1, keepdims=True)
    assert error.max() < 2e-5
    along = np.apply_along_axis(np.convolve, 0, power.astype(np.float64), made.kernel**2, "same")
    blurred = beamform_power(power, made)
    assert blurred.min() >= 0
    np.testing.assert_allclose(blurred, along @ mixing**2, atol=2e-5)


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
        made = scatterers(
            frame, Rendered(radiance, inside), window, settings_.sonar, settings_.water,
            settings_.acoustics,
        )  # fmt: skip
        totals.append(made.power.sum(dtype=np.float64))
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
    made = scatterers(
        frame, rendered, window, settings_.sonar, settings_.water, settings_.acoustics
    )
    halves = made.power[:, :60].mean(), made.power[:, -60:].mean()
    assert halves[0] / halves[1] == pytest.approx(10, rel=0.02)
    with pytest.raises(FactoryError, match="no class is called Tyre"):
        config(acoustics={"reflectivity_db": {"Tyre": -10}})


def test_tvg_levels_what_it_knows() -> None:
    """40 log r + 2 a r undoes the losses of the constant field's opposite: here, power per bin."""
    of = ping_of(observed(config(acoustics={"tvg_log": 0, "tvg_absorption": True})))
    expected = beamform_power(of.scatterers.power, of) * of.gain[:, None]
    rows = expected[30:-30].mean(axis=1)
    assert rows.max() / rows.min() == pytest.approx(1, abs=0.05)


def test_the_papers_data_set_does_not_know_of_physics() -> None:
    """Settings that do not reach its pictures do not reach its name either."""
    plain = compose_config([])
    assert not {"acoustics", "water"} & set(identity(plain))
    assert "array" not in identity(plain)["sonar"]
    other = compose_config(["water=fresh", "sonar.array.beamwidth_deg=3"])
    assert digest(identity(other)) == digest(identity(plain))
    physical = [compose_config(["experiment=physical", f"water={w}"]) for w in ("sea", "fresh")]
    assert len({digest(identity(one)) for one in physical}) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["noise=physical"], "noise.speckle acts on the complex field; set acoustics=field"),
        (["acoustics=field"], "noise.range_spreading moves points"),
        (["experiment=physical", "render.bounces=1"], "render.bounces adds the brightness"),
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


# --- Levels of the paper's points: decibels of an intensity, and the weight of an offset mount ---


def test_decibels_of_an_intensity_are_ten_times_its_logarithm() -> None:
    curve = TransferSettings(kind="log", dynamic_range_db=40)
    level = np.array([1.0, 0.1, 0.01, 1e-4, 1e-5])
    grey = transfer.grey(level, 1.0, curve, "intensity")
    assert grey == pytest.approx([1, 0.75, 0.5, 0, 0], abs=1e-6)
    amplitude = transfer.grey(np.sqrt(level), 1.0, curve, "amplitude")
    assert grey == pytest.approx(amplitude, abs=1e-6)
    half_way = replace(curve, reference=0.5)
    assert transfer.full_scale(np.ones(4), half_way, "intensity") == pytest.approx(100)
    assert transfer.full_scale(np.ones(4), half_way) == pytest.approx(10)


def test_points_twenty_decibels_down_are_not_black_at_forty() -> None:
    """Half of the picture has a hundredth of the echo: half the grey scale of 40 dB."""
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
    weak, strong = clean[8:-8, 8:24].mean(), clean[8:-8, 40:56].mean()
    assert strong - weak == pytest.approx(0.5, abs=0.01)


def test_points_of_an_offset_mount_have_the_area_that_a_pixel_sees() -> None:
    """A wall before both: cos_s / cos_c (r_c / r_s)^2."""
    frame, _ = constant_field(size=(240, 320))
    camera = replace(frame.intrinsics, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
    frame = replace(frame, depth_m=np.full((240, 320), 4, np.float32), intrinsics=camera)
    mount = Mount(translation_m=(0.5, 0.8, -0.3))
    u, v = (np.arange(320) - 160) / 300, ((np.arange(240) - 120) / 300)[:, None]
    ahead, left, up = 4 - 0.5, -4 * u - 0.8, -4 * v + 0.3
    camera_m2, sonar_m2 = 16 * (1 + u**2 + v**2), ahead**2 + left**2 + up**2
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
