"""Levels of the paper's points: decibels of an intensity, and the weight of an offset mount."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.pairs import make_pair, observe
from simnfnd.factory.render.base import Mount, Rendered
from simnfnd.factory.sonar import transfer
from simnfnd.factory.sonar.settings import TransferSettings
from simnfnd.factory.sonar.surface import LitSurface, mount_weight
from simnfnd.factory.sonar.window import Window
from tests.constant_field import constant_field


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


def test_azimuths_of_conical_beams_are_bearings() -> None:
    frame, rendered = constant_field(size=(240, 320))
    settings = compose_config(["sonar.vfov_deg=40"]).sonar
    camera = replace(frame.intrinsics, fx=500.0, fy=500.0, cx=160.0, cy=120.0)
    window = Window("slant_range", 1.0, 30.0, -0.5, 0.5)
    plane, cone = (
        LitSurface(replace(frame, intrinsics=camera), rendered, window, settings, conical)
        for conical in (False, True)
    )
    flat, bent = plane.insonified.echoes, cone.insonified.echoes
    golden = np.arcsin(np.sin(flat.azimuth_rad) * np.cos(flat.elevation_rad))
    np.testing.assert_allclose(bent.azimuth_rad, golden, atol=1e-6)
    np.testing.assert_array_equal(bent.range_m, flat.range_m)
