"""How training images are shown: noisy and clean alike, drawn per visit."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch

from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.data.crops import Crops, Visit, crop
from simnfnd.models.data.displays import (
    Band,
    Display,
    Glare,
    ImagePart,
    draw_display,
    gains,
    resized_planes,
    show,
    with_greys,
)
from simnfnd.models.data.pairs import ImageSource, TrainingImage
from tests.models.data.small_renders import data_settings

WHOLE = ImagePart(0, 0, (60, 40), (60, 40))


class OneImage(ImageSource):
    """A flat fan with a shadow, under speckle."""

    images = range(1)

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        rng = np.random.default_rng(0)
        clean = np.full((60, 40), 0.2, np.float32)
        clean[20:30, 10:20] = 0
        noisy = clean * rng.uniform(0.5, 1.5, clean.shape).astype(np.float32)
        geometry = FanGeometry.polar().with_size(60, 40)
        return TrainingImage(noisy, clean, (clean == 0).astype(np.float32), geometry)


def test_the_default_display_changes_nothing() -> None:
    image = np.random.default_rng(0).random((60, 40), np.float32)
    assert np.array_equal(show(image, Display(), WHOLE), image)
    assert np.array_equal(with_greys(image, 0), image)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_band_multiplies_its_rows_or_columns_and_no_others(axis: int) -> None:
    display = Display(bands=(Band(axis, low=0.4, high=0.6, gain=3, edge=0.02),))
    gain = np.moveaxis(gains(display, WHOLE), axis, 0)
    side = len(gain)
    np.testing.assert_allclose(gain[int(0.45 * side) : int(0.55 * side)], 3)
    np.testing.assert_allclose(gain[: int(0.35 * side)], 1)
    np.testing.assert_allclose(gain[int(0.65 * side) :], 1)


def test_a_slope_is_even_in_decibels_from_the_far_to_the_near_range() -> None:
    gain = gains(Display(near_db=12, far_db=-6), WHOLE)
    steps = np.diff(20 * np.log10(gain[:, 0]))
    np.testing.assert_allclose(steps, 18 / 60, rtol=1e-2)
    assert gain[0, 0] < 10 ** (-5 / 20)
    assert gain[-1, 0] > 10 ** (11 / 20)


def test_glare_is_brightest_at_its_point() -> None:
    gain = gains(Display(glare=Glare(row=0.5, column=0.5, radius=0.1, gain=4)), WHOLE)
    assert gain[30, 20] == gain.max() == pytest.approx(4, rel=0.02)
    assert gain[0, 0] == pytest.approx(1)


def test_bright_pixels_saturate_and_unknown_ones_stay_unknown() -> None:
    image = np.full((60, 40), 0.6, np.float32)
    image[5, 5] = np.nan
    shown = show(image, Display(gain=2, gamma=0.5), WHOLE)
    assert np.isnan(shown[5, 5])
    assert np.nanmin(shown) == 1


def test_a_window_is_shown_as_the_part_of_the_image_that_it_is() -> None:
    display = draw_display_with_everything()
    image = np.random.default_rng(1).random((60, 40), np.float32)
    window = ImagePart(13, 7, (20, 16), (60, 40))
    part = show(image[13:33, 7:23], display, window)
    np.testing.assert_allclose(part, show(image, display, WHOLE)[13:33, 7:23], atol=1e-6)


def draw_display_with_everything() -> Display:
    band = Band(0, 0.3, 0.7, 2.0, 0.05)
    return Display(1.0, 0.9, 4, -3, (band,), Glare(0.2, 0.4, 0.3, 2), 0.8)


def test_few_greys_are_few() -> None:
    image = np.linspace(0, 1, 1000, dtype=np.float32)[None]
    assert len(np.unique(with_greys(image, 16))) == 16


def test_draws_follow_the_seed_and_cover_every_change() -> None:
    def drawn(seed: int) -> Display:
        return draw_display(np.random.default_rng(seed))

    assert drawn(3) == drawn(3)
    displays = [drawn(seed) for seed in range(200)]
    for name, unchanged in vars(Display()).items():
        share = np.mean([getattr(display, name) != unchanged for display in displays])
        assert 0.05 < share < 0.7, name
    band_gains = [band.gain for display in displays for band in display.bands]
    assert min(band_gains) < 0.3
    assert max(band_gains) > 4


@lru_cache(maxsize=2)  # composing a configuration takes longer than all else here
def crops(displays: float) -> Crops:
    data = data_settings(crops=2, batch=2, patch=24, displays=displays)
    return Crops(OneImage(), data, 0, ("range_fraction", "azimuth_rad", "sector"))


def test_every_visit_is_shown_in_its_own_way() -> None:
    plain = crops(0.0)
    shown = crops(1.0)
    differing = 0
    for number in range(20):
        visit = Visit(number, 0, 0)
        batch = shown[visit]
        as_made = plain[visit]
        assert batch.keys() == as_made.keys()
        assert all(batch[name].shape == as_made[name].shape for name in batch)
        assert all(batch[name].dtype == as_made[name].dtype for name in batch)
        assert 0 <= float(batch["noisy"].min()) <= float(batch["noisy"].max()) <= 1
        assert set(np.unique(batch["sector"])) <= {0.0, 1.0}
        again = Crops(OneImage(), shown.data, 0, shown.extras)[visit]
        assert all(torch.equal(batch[name], again[name]) for name in batch)
        differing += not torch.equal(batch["clean"], as_made["clean"])
    assert differing > 10


def test_noisy_and_clean_image_are_shown_alike() -> None:
    """Where nothing saturates, speckle stays in proportion to what it lies on."""
    sample = OneImage().sample(0, 0)
    display = Display(gain=0.5, near_db=3, bands=(Band(0, 0.2, 0.6, 0.4, 0.1),))
    before = crop(sample, (0, 0), (60, 40), False)
    after = crop(sample, (0, 0), (60, 40), False, (), display)
    lit = before["clean"] > 0
    ratios = [(batch["noisy"] / batch["clean"])[lit] for batch in (before, after)]
    torch.testing.assert_close(*ratios)
    assert not torch.allclose(before["clean"], after["clean"])


def test_a_smaller_size_averages_pixels() -> None:
    plane = np.kron([[0, 1], [1, 0]], np.ones((8, 8))).astype(np.float32)
    noisy = plane + np.float32(0.1) * (np.indices(plane.shape).sum(0) % 2).astype(np.float32)
    small = resized_planes({"noisy": noisy}, (8, 8))["noisy"]
    np.testing.assert_allclose(small, plane[::2, ::2] + 0.05, atol=1e-6)


def test_a_display_is_a_value() -> None:
    assert replace(Display(), gain=2.0) == Display(gain=2.0)
