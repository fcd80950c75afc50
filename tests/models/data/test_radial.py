"""What is drawn along bearings, and water under correlated grain."""

from __future__ import annotations

import numpy as np

from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.data.crops import whole_bearings
from simnfnd.models.data.pairs import TrainingImage
from simnfnd.models.data.radial import with_radial
from simnfnd.models.data.water import with_water
from simnfnd.models.networks.bearing_view import SEGMENTS, bearing_view, sector_of, share_at

SHAPE = 200, 240
FAN = FanGeometry.fan(np.pi / 3, apex_x_px=120, apex_y_px=199, near_px=30, far_px=190)


def even_image(level: float = 0.1) -> TrainingImage:
    image = np.full(SHAPE, level, np.float32) * FAN.maps(0, 0, *SHAPE)["sector"]
    return TrainingImage(image, image.copy(), np.ones(SHAPE, np.float32), FAN)


def test_interference_is_in_no_target_and_crosses_all_ranges() -> None:
    with_interference = 0
    with_walls = 0
    for seed in range(40):
        sample = with_radial(even_image(), np.random.default_rng(seed))
        assert sample.undisturbed is not None
        added = sample.noisy - sample.undisturbed
        assert added.min() >= 0
        with_walls += float((sample.clean > sample.clean[FAN_INSIDE].mean() + 0.05).mean()) > 0.002
        seen = whole_bearings(sample)
        assert seen is not None
        if added.max() < 0.05:
            assert seen.interference.max() < 0.05
            continue
        with_interference += 1
        strongest = seen.interference[:, seen.interference.mean(axis=0).argmax()]
        assert np.mean(strongest > 0) > 0.9
        assert abs(float((sample.clean - sample.undisturbed)[FAN_INSIDE].mean())) < 0.1
    assert with_interference > 8
    assert with_walls > 8


def test_an_image_of_unknown_geometry_stays_as_it_is() -> None:
    image = np.full(SHAPE, 0.1, np.float32)
    sample = TrainingImage(image, image)
    assert with_radial(sample, np.random.default_rng(0)) is sample
    assert with_water(sample, np.random.default_rng(0)) is sample


def test_grain_of_water_keeps_its_mean_and_correlates() -> None:
    correlations = []
    for seed in range(12):
        sample = with_water(even_image(), np.random.default_rng(seed))
        grain = (sample.noisy / np.maximum(sample.clean, 1e-3))[80:120, 100:140]
        if 0.01 < sample.clean[100, 120] < 0.2:
            assert abs(float(grain.mean()) - 1) < 0.25
        steps = grain - grain.mean()
        correlations.append(float((steps[1:] * steps[:-1]).mean() / (steps**2).mean()))
    assert min(correlations) < 0.2 < 0.4 < max(correlations)


def test_what_a_view_states_returns_to_its_pixels() -> None:
    maps = FAN.maps(0, 0, *SHAPE)
    view = bearing_view(maps["azimuth_rad"], FAN)
    assert view[1].all()
    values = np.repeat(view[:1, 255], SEGMENTS, axis=0)
    bearings = share_at(values, sector_of(FAN), maps["range_fraction"], maps["azimuth_rad"])
    inside = (maps["sector"] > 0) & (np.abs(maps["azimuth_rad"]) < 0.5)
    assert np.abs(bearings - maps["azimuth_rad"])[inside].max() < 0.01


FAN_INSIDE = FAN.maps(0, 0, *SHAPE)["sector"] > 0
