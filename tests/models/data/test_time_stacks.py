"""Means of frames as training images, and targets that are known in part."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.data.pairs import ImageSource, TrainingImage
from simnfnd.models.data.time_stacks import (
    MixedSource,
    Stack,
    open_stacks,
    standing,
)
from simnfnd.models.networks import averaged
from simnfnd.models.settings import MixedData
from simnfnd.models.training.objective import completed
from tests.models.data.small_renders import composed
from tests.models.recordings.fan_images import fan, preset

SHAPE = (64, 80)
POLAR = FanGeometry.polar().with_size(*SHAPE)


def scene() -> np.ndarray:
    return np.linspace(0.2, 0.6, SHAPE[1], dtype=np.float32)[None].repeat(SHAPE[0], 0)


def stack(count: int) -> Stack:
    noise = np.random.default_rng(0).normal(0, 0.05, (count, *SHAPE))
    grey = (np.clip(scene() + noise, 0, 1) * 255).astype(np.uint8)
    return Stack(grey, POLAR)


def test_recordings_give_single_frames_and_means_towards_the_mean_of_others() -> None:
    numbers = set()
    for seed in range(30):
        sample = stack(20).sample(np.random.default_rng(seed))
        assert np.isfinite(sample.clean).mean() > 0.9
        assert np.nanstd(sample.clean - scene()) < 0.02
        if sample.frames is None:
            continue
        assert sample.frames.min() >= 0
        assert sample.frames.max() <= averaged(7) + 1e-6
        numbers.add(round(float(2 ** (2 * sample.frames.max()))))
        # Its condition is the noise that is left.
        even = sample.frames == sample.frames.max()
        left = float((sample.noisy - scene())[even].std())
        assert left < 1.3 * 0.05 / 2 ** float(sample.frames.max())
    assert len(numbers) >= 3


@pytest.mark.parametrize(("count", "is_target"), [(3, False), (12, True)])
def test_a_mean_of_few_frames_is_no_target(count: int, is_target: bool, tmp_path: Path) -> None:
    """Its speckle would teach a network to keep speckle."""
    image = fan(preset("aris_1800_lf", 96, 128), 0.3, holes=False)[0]
    rng = np.random.default_rng(0)
    for number in range(count):
        noisy = image * rng.uniform(0.95, 1.0, image.shape)
        cv2.imwrite(str(tmp_path / f"{number:02}.png"), noisy.astype(np.uint8))
    if not is_target:
        with pytest.raises(FactoryError, match="10 frames of a static scene"):
            open_stacks([str(tmp_path)], 48)
        return
    (stack_of_images,) = open_stacks([str(tmp_path)], 48)
    assert len(stack_of_images.frames) == count


def test_static_speckle_stays_in_the_target() -> None:
    rng = np.random.default_rng(1)
    noisy = np.clip(scene() * rng.gamma(3, 1 / 3, SHAPE), 0, 1).astype(np.float32)
    remaining = [
        standing(TrainingImage(noisy, scene(), np.zeros(SHAPE, np.float32), POLAR), rng)
        for _ in range(12)
    ]
    spread = [float(np.nanstd(sample.clean - scene())) for sample in remaining]
    assert min(spread) < 0.01
    assert max(spread) > 0.1
    for sample in remaining:
        assert sample.frames is not None
        assert np.nanmax(np.abs(sample.noisy - sample.clean)) < 0.5


def test_unknown_targets_cost_nothing() -> None:
    clean = torch.tensor([[[[0.2, float("nan")]]]])
    prediction = torch.tensor([[[[0.5, 0.7]]]])
    batch = {"clean": clean, "noisy": clean.nan_to_num()}
    assert completed(batch, prediction)["clean"].flatten().tolist() == [
        torch.tensor(0.2).item(),
        torch.tensor(0.7).item(),
    ]


class Only(ImageSource):
    """A source of one pair."""

    images = range(4)

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        grey = np.full(SHAPE, 0.3, np.float32)
        return TrainingImage(grey, grey, np.zeros(SHAPE, np.float32), POLAR)


def test_all_kinds_are_mixed_and_every_visit_is_the_same_again() -> None:
    settings, _ = composed("data=mixed", "dataset.dir=x")
    assert isinstance(settings.data, MixedData)
    data = replace(settings.data, points_share=0.2, recordings_share=0.3, several=0.5)
    source = MixedSource(Only(), Only(), [stack(20)], data, seed=3)
    samples = [source.sample(index % 4, index // 4) for index in range(60)]
    levels = {round(float(sample.clean[0, 0]), 1) for sample in samples}
    assert len(levels) > 1, "points, devices and recordings"
    again = source.sample(2, 5)
    np.testing.assert_array_equal(again.noisy, samples[22].noisy)
