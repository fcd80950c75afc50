"""Moving targets in training images."""

from __future__ import annotations

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.data.pairs import TrainingImage
from simnfnd.models.data.sources import open_data
from simnfnd.models.data.targets import Target, draw_targets, insert_targets
from simnfnd.models.data.time_stacks import resized
from simnfnd.models.networks import averaged
from tests.models.data.small_renders import composed

SHAPE = (96, 120)
NOISE = 0.05


def ground(frames: float | None = None) -> TrainingImage:
    """Even ground under noise; frames: how many were averaged."""
    sigma = NOISE if frames is None else NOISE * 2 ** -(float(averaged(frames)) / 2)
    clean = np.full(SHAPE, 0.4, np.float32)
    noise = np.random.default_rng(0).normal(0, sigma, SHAPE).astype(np.float32)
    count = None if frames is None else np.full(SHAPE, averaged(frames), np.float32)
    return TrainingImage(clean + noise, clean, np.zeros(SHAPE, np.float32), None, count)


def target(contrast: float) -> Target:
    return Target(
        row=48, column=60, angle_rad=0.3, semi_major_px=8, semi_minor_px=4, softness=3,
        contrast=contrast,
    )  # fmt: skip


@pytest.mark.parametrize("contrast", [3.0, -3.0])
@pytest.mark.parametrize("frames", [None, 7.0])
def test_a_target_has_its_contrast_in_the_image_and_in_its_reference(
    contrast: float, frames: float | None
) -> None:
    before = ground(frames)
    after = insert_targets(before, [target(contrast)])
    added = after.clean - before.clean
    assert added[48, 60] == pytest.approx(contrast * NOISE, rel=0.2)
    np.testing.assert_allclose(after.noisy - before.noisy, added, atol=1e-6)
    assert np.abs(added[:20]).max() < 1e-3


def test_a_target_in_black_water_is_not_seen() -> None:
    black = np.zeros(SHAPE, np.float32)
    after = insert_targets(TrainingImage(black, black), [target(6)])
    assert not after.noisy.any()


def test_an_unknown_reference_stays_unknown() -> None:
    sample = ground()
    sample.clean[40:60] = np.nan
    after = insert_targets(sample, [target(3)])
    assert np.isnan(after.clean[40:60]).all()
    assert np.isfinite(after.clean[:40]).all()


def test_targets_depend_on_the_stream_alone() -> None:
    first, second, third = (draw_targets(np.random.default_rng(seed), SHAPE) for seed in (1, 1, 2))
    assert first == second
    assert first != third


def test_a_resized_fan_keeps_range_and_bearing_of_the_scene() -> None:
    fan = FanGeometry.fan(0.6, apex_x_px=100, apex_y_px=220, near_px=40, far_px=200)
    maps = fan.maps(0, 0, 240, 200)
    sample = TrainingImage(maps["range_fraction"] / 2, maps["range_fraction"] / 2, None, fan)
    shapes = set()
    for seed in range(12):
        after = resized(sample, np.random.default_rng(seed))
        assert after.geometry is not None
        expected = after.geometry.maps(0, 0, *after.noisy.shape)["range_fraction"]
        inside = (expected > 0.2) & (expected < 0.9)
        gain = np.median(after.noisy[inside] / expected[inside])
        np.testing.assert_allclose(after.noisy[inside] / gain, expected[inside], atol=0.01)
        shapes.add(after.noisy.shape)
    assert len(shapes) > 3


def test_training_without_a_dataset_or_words_that_make_one_is_refused() -> None:
    settings, _ = composed("data=mixed", "data.make=[]")
    with pytest.raises(FactoryError, match="dataset"):
        open_data(settings)
