"""Pairs on their way to a network: scenes held out, visits, crops, reuse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.data.crops import Crops, KeptSource, Visit, VisitSampler, concatenate
from simnfnd.models.data.pairs import (
    ImageSource,
    TrainingImage,
    TrainingPairs,
    hold_out,
    read_table,
)
from tests.models.data.small_renders import data_settings
from tests.small_dataset import write_dataset


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=24, test=4, size=48)


def test_validation_shares_no_scene_with_training(dataset: Path) -> None:
    samples = read_table(dataset, "train").samples
    assert len(samples) == 24
    learning, validation = hold_out(samples, 0.1, seed=0)
    assert {s.scene for s in learning}.isdisjoint(s.scene for s in validation)
    assert len(learning) + len(validation) == 24
    assert len({s.scene for s in validation}) == 1
    of_scene = tuple(s for s in samples if s.scene == samples[0].scene)
    learning, validation = hold_out(of_scene, 0.3, seed=0)
    assert {s.frame for s in learning}.isdisjoint(s.frame for s in validation)
    assert learning
    assert validation
    with pytest.raises(FactoryError, match="one frame"):
        hold_out(tuple(s for s in of_scene if s.frame == of_scene[0].frame), 0.5, seed=0)


def test_crops_are_windows_of_the_images_mirrored_at_most(dataset: Path) -> None:
    table = read_table(dataset, "train")
    samples = table.samples
    crops = Crops(TrainingPairs(samples, None), data_settings(crops=4, patch=20), 0)
    whole = TrainingPairs(samples, None).sample(3, None)
    assert whole.shadow is not None
    images = whole.noisy, whole.clean, whole.shadow
    windows = set()
    mirrored = set()
    views = np.lib.stride_tricks.sliding_window_view(np.stack(images), (3, 20, 20))[0]
    for number in range(10):
        batch = crops[Visit(number, 3, 0)]
        assert batch["noisy"].shape == (4, 1, 20, 20)
        cuts = np.concatenate([batch[name].numpy() for name in ("noisy", "clean", "shadow")], 1)
        for row in cuts:
            places = [
                (flip, *place)
                for flip in (1, -1)
                for place in np.argwhere((views == row[..., ::flip]).all(axis=(2, 3, 4)))
            ]
            assert places, "a crop is no window of the image"
            mirrored.add(places[0][0])
            windows.add(tuple(places[0][1:]))
    assert len(windows) > 20
    assert mirrored == {1, -1}


@pytest.mark.slow
def test_reading_processes_change_nothing(dataset: Path) -> None:
    samples = read_table(dataset, "train").samples
    data = data_settings(batch=4, patch=16)

    def batches(workers: int) -> list[torch.Tensor]:
        loader = DataLoader(
            Crops(TrainingPairs(samples, None, weaker=0.5), data, 0),
            batch_sampler=VisitSampler(len(samples), data, 3, seed=0),
            collate_fn=concatenate,
            num_workers=workers,
            multiprocessing_context="spawn" if workers else None,
        )
        return [batch["noisy"] for batch in loader]

    for first, second in zip(batches(0), batches(1), strict=True):
        assert torch.equal(first, second)


def test_the_sampler_goes_on_where_it_was_interrupted() -> None:
    data = data_settings(batch=4, crops=2, reuse=3)
    whole = VisitSampler(7, data, every=5, seed=1)
    steps = []
    for whole.step in range(0, 30, 5):
        steps += list(whole)
    later = VisitSampler(7, data, every=5, seed=1)
    for later.step in (20, 22):
        assert list(later) == steps[later.step : 25]
    visits = [visit for step in steps for visit in step]
    assert [visit.number for visit in visits] == list(range(60))
    # Of eight lanes each draws a new image at every third visit.
    shown = {(visit.image, visit.round) for visit in visits}
    assert len(shown) == pytest.approx(20, abs=8)


def test_all_images_are_visited_before_any_is_visited_again() -> None:
    sampler = VisitSampler(7, data_settings(batch=4, crops=2), every=50, seed=1)
    visits = [visit for step in sampler for visit in step]
    for first in range(0, 98, 7):
        assert sorted(visit.image for visit in visits[first : first + 7]) == list(range(7))


class CountedSource(ImageSource):
    """Counts the samples that are made."""

    def __init__(self, images: int) -> None:
        self.images = range(images)
        self.count = 0

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        self.count += 1
        return TrainingImage(np.zeros((8, 8), np.float32), np.zeros((8, 8), np.float32))


@pytest.mark.parametrize("processes", [1, 2, 8])
@pytest.mark.parametrize("images", [54, 3000])
def test_an_image_serves_as_many_visits_as_asked_for(images: int, processes: int) -> None:
    """For any number of reading processes, which take the steps in turns."""
    sampler = VisitSampler(images, data_settings(batch=8, crops=2, reuse=8), every=100, seed=0)
    counted = CountedSource(images)
    remaining = [KeptSource(counted, processes) for _ in range(processes)]
    visits = 0
    for sampler.step in range(0, 1000, 100):
        for number, step in enumerate(sampler):
            for visit in step:
                remaining[number % processes].sample(visit.image, visit.round)
                visits += 1
    assert visits / counted.count > 7
