"""Image formation: geometry against hand-computed places, energy, and the transfer curves."""

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.fan_geometry import pixel_size
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.simulation.render.base import Mount
from simnfnd.factory.simulation.sonar import polar, transfer
from simnfnd.factory.simulation.sonar.fan import fan_table
from simnfnd.factory.simulation.sonar.polar import in_plane
from simnfnd.factory.simulation.sonar.settings import SonarSettings, TransferSettings
from simnfnd.factory.simulation.sonar.window import Extent, fit_window, set_window
from tests.clouds import HALF_RAD, to_sonar, uniform_scene, window

SHARP = {"point_spread": {"range_bins": 0, "beams": 0}}


def sonar(**keys) -> SonarSettings:
    return build(SonarSettings, {"range": {"auto": False, "min_m": 1, "max_m": 9}, **SHARP, **keys})


def test_fan_shows_a_point_where_it_is():
    """Far range on top, right on the right: a blob at 6 m and 10 degrees right."""
    device = sonar()
    level = np.zeros((256, 256), np.float32)
    blob = in_plane(np.full(500, 6.0), np.full(500, np.deg2rad(10)), np.ones(500))
    level = polar.spread_points(
        polar.accumulate(blob, window(), device),
        build(SonarSettings, {"point_spread": {"range_bins": 1, "beams": 1}}),
    )
    fan = fan_table(device, 1 / 9).bilinear(level)
    row, column = np.unravel_index(fan.argmax(), fan.shape)
    pixel_m = 9 * pixel_size(device, 1 / 9)
    assert (row + 0.5) * pixel_m == pytest.approx(9 - 6 * np.cos(np.deg2rad(10)), abs=1.5 * pixel_m)
    assert (column + 0.5 - 128) * pixel_m == pytest.approx(
        6 * np.sin(np.deg2rad(10)), abs=1.5 * pixel_m
    )


@pytest.mark.parametrize("kind", ["linear", "power", "log", "soft_log"])
def test_transfer_is_monotone_bounded_and_hits_its_reference(kind):
    curve = TransferSettings(kind=kind, reference=0.8, exponent=0.5, percentile=90)
    clean = np.linspace(0, 10, 1001, dtype=np.float32)
    scale = transfer.full_scale(clean, curve)
    values = transfer.grey(np.linspace(0, 100, 500), scale, curve)
    assert np.all(np.diff(values) >= 0)
    assert values[0] == 0
    assert values[-1] == 1
    level = np.percentile(clean[clean > 0], 90)
    assert transfer.grey(np.array([level]), scale, curve)[0] == pytest.approx(0.8, abs=1e-4)


def test_soft_log_is_the_formula_for_amplitudes_and_intensities():
    """A logarithm far above the unit, a straight line far below, `black` where nothing is."""
    curve = TransferSettings(kind="soft_log", dynamic_range_db=60, black=0.1, reference=0.5)
    amplitude = np.array([1.0, 0.1, 1e-3, 1e-4, 0.0], np.float32)
    want = 0.1 + 0.9 * np.log(1 + 1e6 * amplitude**2) / np.log(1 + 1e6)
    assert transfer.grey(amplitude, 1.0, curve) == pytest.approx(want, abs=1e-6)
    energy = amplitude * amplitude
    assert transfer.grey(energy, 1.0, curve, "intensity") == pytest.approx(want, abs=1e-6)
    for quantity in ("amplitude", "intensity"):
        scale = transfer.full_scale(np.array([2.0, 3.0, 5.0]), curve, quantity)
        shown = transfer.grey(np.array([4.6]), scale, curve, quantity)
        assert shown[0] == pytest.approx(0.5, abs=1e-4)


def test_quantisation_is_last_and_rounds():
    grey = np.array([0, 0.5, 1.0], np.float32)
    assert transfer.quantise(grey, "uint8").tolist() == [0, 128, 255]
    assert transfer.quantise(grey, "float32").dtype == np.float32


def test_mount_axes():
    """Camera x right, y down, z forward; sonar x forward, y left, z up."""
    points = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert to_sonar(Mount(), points).tolist() == [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    down = to_sonar(Mount(pitch_deg=90), np.array([[0, 2.0, 0]]))
    np.testing.assert_allclose(down, [[2, 0, 0]], atol=1e-12)
    left = to_sonar(Mount(yaw_deg=90), np.array([[-2.0, 0, 0]]))
    np.testing.assert_allclose(left, [[2, 0, 0]], atol=1e-12)
    above = to_sonar(Mount(translation_m=(0, 0, 1)), np.array([[0, 0, 5.0]]))
    np.testing.assert_allclose(above, [[5, 0, -1]], atol=1e-12)
    assert not Mount(translation_m=(0, 0, 1)).colocated
    assert Mount(pitch_deg=5).colocated


def test_window_fits_the_echoes_and_forgets_stray_points():
    scene = uniform_scene(near_m=3, far_m=8)
    lit_m = np.concatenate([scene.range_m, np.full(20, 25, np.float32)])
    fitted = fit_window(Extent(lit_m, -HALF_RAD, HALF_RAD), build(SonarSettings, {}))
    assert 2 < fitted.range_min_m < 3
    assert 7.9 < fitted.range_max_m < 8.6
    assert (fitted.azimuth_min_rad, fitted.azimuth_max_rad) == (-HALF_RAD, HALF_RAD)
    assert fitted.near_fraction * 16 == pytest.approx(round(fitted.near_fraction * 16))


def test_a_place_keeps_one_of_the_windows():
    windows = {"range": {"auto": False, "windows_m": [[1, 4], [2, 5]]}}
    device: SonarSettings = build(SonarSettings, windows)
    assert not device.range.fixed
    drawn = {
        (place, frame): set_window(device, 7, FrameRef("seabed", place, frame)).range
        for place in map(str, range(40))
        for frame in "ab"
    }
    for (place, _), actual in drawn.items():
        assert actual == drawn[place, "a"]
        assert actual.fixed
    shares = [sum(window.min_m == near for window in drawn.values()) / 80 for near in (1, 2)]
    assert min(shares) > 0.25
    assert {(window.min_m, window.max_m) for window in drawn.values()} == {(1, 4), (2, 5)}
    usual: SonarSettings = build(SonarSettings, {"range": {"auto": False}})
    assert set_window(usual, 7, FrameRef("seabed", "3", "a")) is usual


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"range": {"min_m": 5, "max_m": 5}}, "min_m must be smaller"),
        ({"range": {"auto": False, "windows_m": [[1, 4], [3, 2]]}}, "got [3, 2]"),
        ({"transfer": {"black": 0.1}}, "for kind=soft_log"),
        ({"transfer": {"kind": "soft_log", "black": 0.9, "reference": 0.8}}, "below reference"),
        ({"hfov_deg": 0}, "sonar.hfov_deg"),
        ({"beam": 64}, "sonar.beam: unknown key"),
        ({"beams": 3, "beam_azimuths_deg": [0, 1]}, "2 entries for 3 beams"),
        ({"beams": 2, "beam_azimuths_deg": [1, 0]}, "must increase"),
        ({"beams": 2, "beam_azimuths_deg": [0, 60]}, "within hfov_deg"),
        ({"mount": {"translation_m": [1, 2]}}, "sonar.mount.translation_m"),
    ],
)
def test_bad_settings_name_the_key(keys, said):
    with pytest.raises(FactoryError) as caught:
        build(SonarSettings, keys, prefix="sonar")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
