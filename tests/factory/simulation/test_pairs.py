"""One frame to its pairs: what clean and noisy share, what differs, and that it repeats."""

import numpy as np
import pytest

from simnfnd.factory.common.errors import FrameError
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.labels.image_axes import image_axes
from simnfnd.factory.simulation.pairs import pair_maker as pairs
from tests.frames import POST_M, ground_and_post, plain_render

OFF = {
    effect: {"enabled": False}
    for effect in ("range_spreading", "multipath", "azimuth", "range_arc", "background")
}


def config(**keys) -> FactoryConfig:
    return from_mapping({"scenes": {"kind": "seabed"}, **keys})


def observed(settings: FactoryConfig, frame=None):
    frame = frame or ground_and_post()
    return pairs.observe(frame, plain_render(frame), settings)


def test_without_noise_the_noisy_image_is_the_clean_one():
    settings = config(noise=OFF)
    pair = pairs.make_pair(observed(settings), 0, settings)
    np.testing.assert_array_equal(pair.noisy, pair.clean)
    assert pair.clean.max() == 255


def test_seed_changes_the_noise_and_never_the_scene():
    first_settings, second_settings = (config(seed=seed, resample={"rate": 1.0}) for seed in (1, 2))
    first, second = (
        pairs.make_pair(observed(settings), 0, settings)
        for settings in (first_settings, second_settings)
    )
    np.testing.assert_array_equal(first.clean, second.clean)
    assert first.noisy.tobytes() != second.noisy.tobytes()


def test_the_record_makes_the_sample_again():
    """Every drawn value, given back as a number, gives the same image."""
    drawn = {"background": {"density": {"uniform": [0.1, 0.9]}, "strength": {"uniform": [0, 1]}}}
    settings = config(noise=drawn, resample={"rate": {"uniform": [0.3, 0.9]}})
    pair = pairs.make_pair(observed(settings), 3, settings)
    fixed = {
        "background": {
            "density": pair.record["noise.background.density"],
            "strength": pair.record["noise.background.strength"],
        }
    }
    replay = config(noise=fixed, resample={"rate": pair.record["resample.rate"]})
    again = pairs.make_pair(observed(replay), 3, replay)
    assert again.noisy.tobytes() == pair.noisy.tobytes()


@pytest.mark.parametrize("projection", ["slant_range", "top_view"])
def test_the_post_is_where_it_stands_and_casts_a_shadow(projection):
    settings = config(
        noise=OFF,
        resample={"rate": 1.0},
        sonar={
            "projection": projection,
            "vfov_deg": 60,
            "image": {"layout": "polar"},
            "tvg_db_per_decade": 20,
            "transfer": {"percentile": 100},
        },
    )
    frame = ground_and_post(480, 320)
    scene = observed(settings, frame)
    pair = pairs.make_pair(scene, 0, settings)
    window = scene.window
    middle = pair.clean[:, 126:130].mean(axis=1)
    range_m = window.range_min_m + (np.arange(256) + 0.5) / 256 * window.range_span_m
    # It stands at 3 m along the optical axis; its ends are up to 4 % farther in slant range.
    brightest_m = range_m[middle.argmax()]
    assert POST_M * 0.99 < brightest_m < POST_M * (1.05 if projection == "slant_range" else 1.01)
    # Over its head the seabed shows again from 8 m on.
    behind = (range_m > POST_M * 1.25) & (range_m < 7.5)
    assert pair.shadow[behind][:, 126:130].mean() > 0.95
    assert pair.shadow[behind][:, 40:60].mean() < 0.05
    assert middle[behind].mean() < 2


def test_resampling_keeps_the_asked_fraction_and_repeats():
    settings = config(resample={"rate": 0.25})
    scene = observed(settings)
    pair = pairs.make_pair(scene, 0, settings)
    assert pair.record["points.scene"] == pytest.approx(0.25 * len(scene.scene.echoes), rel=0.05)
    background = float(pair.record["points.background"]) / float(pair.record["points.scene"])
    assert background == pytest.approx(pair.record["noise.background.density"], rel=0.01)
    assert pairs.make_pair(scene, 0, settings).noisy.tobytes() == pair.noisy.tobytes()


def test_bearings_that_the_camera_did_not_see_are_black_in_both():
    settings = config(sonar={"hfov_deg": 120, "image": {"layout": "polar"}})
    scene = observed(settings)
    pair = pairs.make_pair(scene, 0, settings)
    unseen = np.abs(np.rad2deg(settings.sonar.beam_centres_rad())) > 23.5
    assert not pair.noisy[:, unseen].any()
    assert not pair.clean[:, unseen].any()
    assert not pair.shadow[:, unseen].any()
    assert pair.noisy[:, ~unseen].any(axis=0).mean() > 0.9
    assert pair.record["azimuth_max_deg"] == pytest.approx(22.4, abs=0.3)


def test_a_sonar_that_looks_elsewhere_is_a_bad_frame_with_its_name():
    settings = config(sonar={"mount": {"yaw_deg": 120}})
    with pytest.raises(FrameError, match="here/plain/0001"):
        observed(settings)


def test_images_of_several_windows_have_metres_of_their_own():
    settings = config(sonar={"range": {"auto": False, "windows_m": [[1, 5], [2, 6]]}})
    actual = {}
    for place in map(str, range(12)):
        scene = observed(settings, ground_and_post(scene=place))
        record = pairs.make_pair(scene, 0, settings).record
        actual[record["range_min_m"]] = record["range_max_m"]
    assert actual == {1: 5, 2: 6}
    assert {axis.units for axis in image_axes(settings.sonar)} == {"px"}


def test_fixed_range_axes_are_metres():
    settings = config(sonar={"range": {"auto": False, "min_m": 1, "max_m": 5}})
    ahead, right = image_axes(settings.sonar)
    assert ahead.units == right.units == "m"
    assert ahead.values[0] > ahead.values[-1]
    assert ahead.values[0] == pytest.approx(5, abs=0.02)
    assert right.values.mean() == pytest.approx(0, abs=1e-9)
