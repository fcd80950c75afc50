"""Every device as it ships: power, grain, noise and beams against closed forms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import FactoryConfig
from simnfnd.factory.frame import Frame
from simnfnd.factory.imaging.coherent import received
from simnfnd.factory.imaging.effect import DrawnEffect
from simnfnd.factory.imaging.scatterers import scatterers
from simnfnd.factory.imaging.signal import Ping, Signal, beamform_power
from simnfnd.factory.noise.receiver import receiver
from simnfnd.factory.noise.speckle import SPECKLE, volume
from simnfnd.factory.pairs import observe
from simnfnd.factory.render.base import Rendered
from simnfnd.factory.sonar import array
from simnfnd.factory.sonar.array import Taper, thermal_noise_db
from simnfnd.factory.sonar.window import Window
from tests.constant_field import constant_field, ping_of
from tests.project_files import ROOT

DEVICES = sorted(path.stem for path in (ROOT / "conf/sonar").glob("*.yaml"))
RECIPES = [*(f"sonar={device}" for device in DEVICES), "experiment=aris_mdd"]
# Half-power points of the squared sinc and of the Hamming window's response, and the integrals of
# both over their argument: 1 by Parseval, and (0.54^2 + 0.46^2 / 2) / 0.54^2.
HALF_POWER = {"uniform": 0.442946, "hamming": 0.6515}
INTEGRAL = {"uniform": 1.0, "hamming": 1.3628}


@cache
def composed(recipe: str, *words: str) -> FactoryConfig:
    given = ["experiment=physical", recipe] if recipe.startswith("sonar") else [recipe]
    return compose_config([*given, *words])


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
    assert settings.noise.speckle is not None
    cell_m = settings.noise.speckle.scatterer_m.values[0]
    many, one = (
        received(
            ping,
            [DrawnEffect("speckle", SPECKLE, {"looks": n, "scatterer_m": cell_m}, 0, (n,))],
        )
        for n in (8, 1)
    )
    assert decibels((many[inner] ** 2 / expected).mean()) == pytest.approx(0, abs=0.2)
    single = one[inner] ** 2 / expected - 1
    kernel = np.append(ping.kernel, 0)
    alike = float((kernel[1:] * kernel[:-1]).sum() / (kernel**2).sum()) ** 2
    assert (single[1:] * single[:-1]).mean() / (single**2).mean() == pytest.approx(alike, abs=0.06)


@pytest.mark.parametrize("device", DEVICES)
def test_noise_and_haze_are_those_of_the_closed_forms(device):
    """Both over the echo of a surface of known backscatter, in what pulse and beam hold of each."""
    settings = composed(f"sonar={device}")
    ping, sonar = listened(settings), settings.sonar
    rows, beams = lit(ping)
    device_, water = sonar.array, settings.water
    across, upright = device_.horizontal.window, device_.vertical.window
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
    # What is received of an echo of density p is p pulse beam; the picture has p dr dtheta.
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


@pytest.mark.parametrize("device", DEVICES)
def test_no_grating_lobe_lies_in_the_sector(device):
    sonar = composed(f"sonar={device}").sonar
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
    depth_m, radiance = np.zeros((200, 800), np.float32), np.zeros((200, 800), np.float32)
    depth_m[row, column], radiance[row, column] = 4.0, 1.0
    frame = replace(frame, depth_m=depth_m, intrinsics=camera, rgb=np.zeros((200, 800, 3), "u1"))
    made = scatterers(
        frame, Rendered(radiance, depth_m > 0), Window("slant_range", 1, 20, -1.2, 1.2),
        settings.sonar, settings.water, settings.acoustics,
    )  # fmt: skip
    point = np.array([(column - 400) / 200, (row - 100) / 200, 1.0])
    golden = np.rad2deg(np.arcsin(point[0] / np.linalg.norm(point)))
    beam = int(made.bins[0]) % settings.sonar.beams
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
