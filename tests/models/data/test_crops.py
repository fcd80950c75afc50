"""Pairs on their way to a network: scenes held out, visits, crops, weaker noise, reuse."""

from __future__ import annotations

import pickle
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from simnfnd.factory.errors import FactoryError
from simnfnd.models.data.crops import Crops, KeptSource, Visit, VisitSampler, concatenate, drawn
from simnfnd.models.data.pairs import (
    PairSource,
    Sample,
    hold_out,
    read_table,
)
from simnfnd.models.settings import RendersData
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
    one = tuple(s for s in samples if s.scene == samples[0].scene)
    learning, validation = hold_out(one, 0.3, seed=0)
    assert {s.frame for s in learning}.isdisjoint(s.frame for s in validation)
    assert learning
    assert validation
    with pytest.raises(FactoryError, match="one frame"):
        hold_out(tuple(s for s in one if s.frame == one[0].frame), 0.5, seed=0)


def test_crops_are_windows_of_the_images_mirrored_at_most(dataset: Path) -> None:
    table = read_table(dataset, "train")
    samples = table.samples
    crops = Crops(PairSource(samples, None), crops=4, seed=0)
    whole = PairSource(samples, None).sample(3, None)
    assert whole.clean is not None
    assert whole.shadow is not None
    images = whole.noisy, whole.clean, whole.shadow
    windows, mirrored = set(), set()
    views = np.lib.stride_tricks.sliding_window_view(np.stack(images), (3, 20, 20))[0]
    for number in range(10):
        batch = crops[Visit(number, 3, 0, 20)]
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


class Counting:
    """Samples that say which visit they are, and how often one was made."""

    def __init__(self) -> None:
        self.made: Counter[tuple[int, int | None]] = Counter()

    def __len__(self) -> int:
        return 5

    def sample(self, index: int, visit: int | None) -> Sample:
        self.made[index, visit] += 1
        picture = np.full((2, 2), index + 10 * (visit or 0), np.float32)
        return Sample(picture, picture, None, None, None)


def test_kept_pictures_are_those_of_the_source_and_made_once() -> None:
    plain, counting = Counting(), Counting()
    kept = KeptSource(counting)
    for number in range(400):
        picture = drawn(number, 8, 0)
        index, visit = picture % 5, picture // 5
        np.testing.assert_array_equal(
            kept.sample(index, visit).noisy, plain.sample(index, visit).noisy
        )
    assert set(counting.made.values()) == {1}
    assert len(counting.made) == 50
    # Validation pictures are not kept, and a copy in another process begins with none.
    kept.sample(0, None)
    kept.sample(0, None)
    assert counting.made[0, None] == 2
    assert not pickle.loads(pickle.dumps(kept))._kept


def test_the_sampler_goes_on_where_it_was_interrupted() -> None:
    data = data_settings(kind="renders", batch=4, crops=2, reuse=3)
    assert isinstance(data, RendersData)
    whole = VisitSampler(7, data, steps=5, seed=1)
    steps = []
    for interval in range(6):
        whole.begin(interval, 0)
        steps += list(whole)
    later = VisitSampler(7, data, steps=5, seed=1)
    later.begin(4, 0)
    assert list(later) == steps[20:25]
    later.begin(4, 2)
    assert list(later) == steps[22:25]
    visits = [visit for step in steps for visit in step]
    assert [visit.number for visit in visits] == list(range(60))
    shown = {(visit.image, visit.round) for visit in visits}
    assert len(shown) == 20
    # Every picture is another image until all were shown.
    first = [visit for visit in visits if visit.number % 3 == 0][:7]
    assert sorted(visit.image for visit in first) == list(range(7))
