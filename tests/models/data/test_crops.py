"""Pairs on their way to a network: scenes held out, visits, crops, weaker noise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from simnfnd.factory.errors import FactoryError
from simnfnd.models.data.crops import Crops, Visit, VisitSampler, concatenate
from simnfnd.models.data.pairs import (
    PairSource,
    hold_out,
    read_table,
)
from tests.models.data.data_settings import data_settings
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
    one = tuple(s for s in samples if s.scene == samples[0].scene)
    learning, validation = hold_out(one, 0.3, seed=0)
    assert {s.frame for s in learning}.isdisjoint(s.frame for s in validation)
    assert learning
    assert validation
    with pytest.raises(FactoryError, match="one frame"):
        hold_out(tuple(s for s in one if s.frame == one[0].frame), 0.5, seed=0)


def visits(images: int, data: Any, steps: int = 5, intervals: int = 7) -> list[list[Visit]]:
    """All steps of a training."""
    sampler = VisitSampler(images, data, steps, seed=1)
    found = []
    for interval in range(intervals):
        sampler.begin(interval, 0)
        assert len(sampler) == steps
        found += list(sampler)
    return found


def test_every_image_is_visited_before_any_is_visited_again() -> None:
    steps = visits(7, data_settings(batch=1))
    drawn = [visit for step in steps for visit in step]
    assert [visit.number for visit in drawn] == list(range(35))
    assert [visit.round for visit in drawn] == [number // 7 for number in range(35)]
    rounds = [[visit.image for visit in drawn[i : i + 7]] for i in range(0, 35, 7)]
    assert all(sorted(images) == list(range(7)) for images in rounds)
    assert len({tuple(images) for images in rounds}) > 1


def test_crops_are_windows_of_the_images_mirrored_at_most(dataset: Path) -> None:
    table = read_table(dataset, "train")
    samples = table.samples
    crops = Crops(PairSource(samples, None), crops=4, seed=0)
    whole = PairSource(samples, None).sample(3, None)
    assert whole.clean is not None
    assert whole.shadow is not None
    images = whole.noisy, whole.clean, whole.shadow
    windows, mirrored = set(), set()
    for number in range(10):
        batch = crops[Visit(number, 3, 0, 20)]
        assert batch["noisy"].shape == (4, 1, 20, 20)
        for row in range(4):
            places = [
                (top, left, flip)
                for top in range(29)
                for left in range(29)
                for flip in (False, True)
                if all(
                    np.array_equal(
                        image[top : top + 20, left : left + 20][:, :: -1 if flip else 1],
                        batch[name][row, 0].numpy(),
                    )
                    for name, image in zip(("noisy", "clean", "shadow"), images, strict=True)
                )
            ]
            assert len(places) >= 1, "a crop is no window of the image"
            windows.add(places[0][:2])
            mirrored.add(places[0][2])
    assert len(windows) > 20
    assert mirrored == {False, True}


def test_some_visits_show_weaker_noise_down_to_none(dataset: Path) -> None:
    samples = read_table(dataset, "train").samples
    source = PairSource(samples, None, weaker=0.5, seed=0)
    whole = source.sample(0, None)
    noisy, clean = whole.noisy, whole.clean
    assert clean is not None
    factors = []
    for visit in range(60):
        seen = source.sample(0, visit).noisy
        factors.append(float(np.vdot(seen - clean, noisy - clean) / np.sum((noisy - clean) ** 2)))
        np.testing.assert_allclose(seen, clean + factors[-1] * (noisy - clean), atol=1e-5)
    assert 0.3 < np.mean(np.array(factors) < 0.999) < 0.7
    assert min(factors) == pytest.approx(0, abs=1e-6)
    np.testing.assert_array_equal(source.sample(0, 7).noisy, source.sample(0, 7).noisy)


def test_reading_processes_change_nothing(dataset: Path) -> None:
    samples = read_table(dataset, "train").samples
    data = data_settings(batch=4, patch=16)

    def batches(workers: int) -> list[torch.Tensor]:
        loader = DataLoader(
            Crops(PairSource(samples, None, weaker=0.5), seed=0),
            batch_sampler=VisitSampler(len(samples), data, 3, seed=0),
            collate_fn=concatenate,
            num_workers=workers,
            multiprocessing_context="spawn" if workers else None,
        )
        return [batch["noisy"] for batch in loader]

    for one, other in zip(batches(0), batches(1), strict=True):
        assert torch.equal(one, other)
