"""Where range and bearing lie: fans and polar images, of the factory and of real devices."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from simnfnd.factory.simulation.sonar.fan import fan_table
from simnfnd.factory.simulation.sonar.settings import SonarSettings

FAN = {"hfov_deg": 60, "image": {"width_px": 90, "height_px": 70}, "beams": 64}
POLAR = {"hfov_deg": 40, "image": {"layout": "polar"}, "beams": 4, "range_bins": 3}


def sonar(values: dict[str, object]) -> SonarSettings:
    device: SonarSettings = build(SonarSettings, values)
    return device


@pytest.mark.parametrize("near", [0.0, 0.05, 0.4])
def test_the_sector_of_a_fan_is_the_one_that_the_factory_fills(near: float) -> None:
    device = sonar(FAN)
    geometry = FanGeometry.from_sonar(device, near * 5, 5.0)
    mask = geometry.sector_mask(70, 90)
    assert np.mean(mask != fan_table(device, near).inside) < 0.001
    assert np.mean(mask != (geometry.maps(0, 0, 70, 90)["sector"] > 0)) < 0.001
    assert geometry.near_px == pytest.approx(near * geometry.far_px)
    assert geometry.range_span_m == pytest.approx(5 - 5 * near)


def test_a_record_limits_the_data_to_what_the_camera_saw() -> None:
    record = {"range_min_m": 1, "range_max_m": 4, "azimuth_min_deg": -10, "azimuth_max_deg": 90}
    geometry = FanGeometry.from_record(sonar(POLAR), record)
    assert (geometry.near_fraction, geometry.range_span_m) == (0.25, 3.0)
    assert geometry.data_fraction == (0.25, 1.0)
    assert geometry.azimuth_max_rad == math.radians(20)
    maps = geometry.maps(0, 0, 3, 4)
    np.testing.assert_allclose(np.rad2deg(maps["azimuth_rad"][0]), [-15, -5, 5, 15], rtol=1e-6)
    np.testing.assert_allclose(maps["range_fraction"][:, 0], [0.375, 0.625, 0.875])
    np.testing.assert_array_equal(maps["sector"][0], [0, 1, 1, 1])
    assert geometry.sector_mask(3, 4).all()
    with pytest.raises(KeyError):
        FanGeometry.from_record(sonar(POLAR), {"range_min_m": 1.0})


def test_beams_need_not_be_evenly_spaced() -> None:
    table = (-20.0, -5.0, 0.0, 20.0)
    geometry = FanGeometry.from_sonar(sonar({**POLAR, "beam_azimuths_deg": table}), 1.0, 4.0)
    maps = geometry.maps(1, 1, 2, 3)
    np.testing.assert_allclose(np.rad2deg(maps["azimuth_rad"][0]), table[1:], atol=1e-6)
    rows, columns = geometry.pixels(np.full(2, 0.625), np.deg2rad([-12.5, 10.0]))
    np.testing.assert_allclose(rows, 1)
    np.testing.assert_allclose(columns, [0.5, 2.5])


def test_a_polar_image_gets_its_size_when_it_is_read() -> None:
    geometry = FanGeometry.polar(math.radians(40))
    assert geometry.near_fraction == 0
    assert geometry.range_span_m is None
    sized = geometry.with_size(3, 4)
    assert sized.with_size(30, 40) is sized
    expected = FanGeometry.from_sonar(sonar(POLAR), 0.0, 1.0)
    for name, values in expected.maps(0, 0, 3, 4).items():
        np.testing.assert_allclose(sized.maps(0, 0, 3, 4)[name], values, rtol=1e-6, err_msg=name)


def test_the_device_of_a_dataset_by_another_program_is_unknown() -> None:
    recorded = recorded_sonar({"sonar": {**FAN, "range_bins": 256}})
    assert recorded is not None
    device = sonar(FAN)
    assert FanGeometry.from_sonar(recorded, 1, 5) == FanGeometry.from_sonar(device, 1, 5)
    np.testing.assert_array_equal(recorded.beam_centres_rad(), device.beam_centres_rad())
    assert recorded_sonar({"sonar": {"wings": 2}}) is None
    assert recorded_sonar({}) is None
    with pytest.raises(FactoryError):
        sonar({"wings": 2})
