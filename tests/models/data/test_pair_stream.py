"""The endless stream: fresh noise, no duplicates, the same for any number of workers."""

from __future__ import annotations

import pickle
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from simnfnd import FactoryError, PairDataset, PairStream, make_dataset

WORDS = (
    "experiment=demo", "render=analytic", "scenes.locations=3", "scenes.frames_per_location=2",
    "scenes.width=160", "scenes.height=100", "dataset.preview_pairs=0", "scheduler=serial",
)  # fmt: skip


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """Of a dataset whose renders are in the cache; its folder is the last one's."""
    folder = tmp_path_factory.mktemp("stream")
    words = (*WORDS, f"cache.dir={folder / 'cache'}")
    make_dataset(*words, out=folder / "data")
    return (*words, f"dataset.dir={folder / 'data'}")


def fingerprints(batches: Any) -> list[bytes]:
    """Of each batch, wherever it was made."""
    return [batch["noisy"].numpy().tobytes() for batch in batches]


@pytest.mark.slow
def test_batches_are_pairs_under_fresh_noise(words: tuple[str, ...]) -> None:
    stream = PairStream(*words, batch_size=2, seed=4)
    frames = len(stream.frames)
    assert frames == 4
    batch = stream.batch(0)
    assert {name: (values.shape, values.dtype) for name, values in batch.items()} == {
        "noisy": (torch.Size([2, 256, 256]), torch.float32),
        "clean": (torch.Size([2, 256, 256]), torch.float32),
        "shadow": (torch.Size([2, 256, 256]), torch.bool),
    }
    assert 0 <= batch["noisy"].min() < batch["noisy"].max() <= 1
    assert not torch.equal(batch["noisy"], batch["clean"])
    rounds = [[stream.pair(position) for position in range(k, k + frames)] for k in (0, frames)]
    names = [[pair.record["frame"] for pair in round_] for round_ in rounds]
    scenes = [[pair.record["scene"] for pair in round_] for round_ in rounds]
    places = [sorted(zip(*both, strict=True)) for both in zip(scenes, names, strict=True)]
    assert places[0] == places[1]
    assert len(set(places[0])) == frames
    noisy = {pair.noisy.tobytes() for round_ in rounds for pair in round_}
    assert len(noisy) == 2 * frames
    folder = words[-1].partition("=")[2]
    with PairDataset(folder, "train", trusted=True) as pairs:
        assert not noisy & {sample["noisy"].tobytes() for sample in pairs}
        clean = {sample["clean"].tobytes() for sample in pairs}
    assert len(clean) == frames


@pytest.mark.slow
def test_labels_and_shapes_are_those_of_the_dataset(words: tuple[str, ...]) -> None:
    layers = ("noisy", "clean", "shadow", "segmentation", "instance", "range")
    folder = Path(words[-1].partition("=")[2]).with_name("labelled")
    labelled = (*words[:-1], "dataset.layers=[segmentation,range]")
    make_dataset(*labelled, out=folder)
    with PairDataset(folder, "train", layers=layers, scaled=True, trusted=True) as pairs:
        stored = pairs[:]
    for stream in (
        PairStream(*words, layers=layers, batch_size=4),
        PairStream(words[-2], dataset=folder, batch_size=4),
    ):
        batch = stream.batch(0)
        assert set(batch) == set(layers)
        for name in layers:
            values = batch[name].numpy()
            assert (values.shape, values.dtype) == (stored[name].shape, stored[name].dtype)
            # Every frame comes once, in another order; new points are drawn for noisy and clean.
            if name not in ("noisy", "clean"):
                images = {image.tobytes() for image in values}
                assert images == {image.tobytes() for image in stored[name]}, name
    with pytest.raises(FactoryError, match="echo"):
        PairStream(*words, layers=("noisy", "echo"))


@pytest.mark.slow
def test_several_workers_give_the_same_batches(words: tuple[str, ...]) -> None:
    stream = PairStream(*words, batch_size=2)
    alone = fingerprints(stream.batch(number) for number in range(6))
    assert len(set(alone)) == 6
    loader = DataLoader(stream, batch_size=None, num_workers=3, multiprocessing_context="fork")
    assert fingerprints(islice(loader, 6)) == alone


@pytest.mark.slow
def test_ranks_share_the_batches_and_resume(words: tuple[str, ...]) -> None:
    together = fingerprints(islice(PairStream(*words, batch_size=1, rank=0, ranks=1), 8))
    for rank in range(2):
        stream = PairStream(*words, batch_size=1, rank=rank, ranks=2)
        assert fingerprints(islice(stream, 4)) == together[rank::2]
        resumed = PairStream(*words, batch_size=1, rank=rank, ranks=2, start=3)
        assert fingerprints(islice(resumed, 1)) == together[rank::2][3:]
    assert fingerprints(islice(PairStream(*words, batch_size=1, seed=1), 8)) != together


def test_torchrun_says_which_rank_it_is(words: tuple[str, ...], monkeypatch: Any) -> None:
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "3")
    stream = PairStream(*words)
    assert (stream.rank, stream.ranks) == (1, 3)
    with pytest.raises(ValueError, match="rank=3"):
        PairStream(*words, rank=3, ranks=3)


def test_the_folder_of_a_dataset_chooses_the_same(words: tuple[str, ...]) -> None:
    *_, cache, folder = words
    stream = PairStream(cache, dataset=folder.partition("=")[2], batch_size=2)
    again = pickle.loads(pickle.dumps(stream))
    expected = fingerprints([PairStream(*words, batch_size=2).batch(1)])
    assert fingerprints([stream.batch(1)]) == fingerprints([again.batch(1)]) == expected


def test_frames_stay_in_memory_without_changing_a_pair(words: tuple[str, ...]) -> None:
    stream = PairStream(*words, batch_size=1)
    first = stream.pair(0)
    for position in range(1, 6):
        stream.pair(position)
    np.testing.assert_array_equal(stream.pair(0).noisy, first.noisy)
    np.testing.assert_array_equal(
        PairStream(*words, batch_size=1).pair(5).noisy, stream.pair(5).noisy
    )


def test_what_cannot_be_streamed_is_told(words: tuple[str, ...], tmp_path: Path) -> None:
    empty = f"cache.dir={tmp_path / 'empty'}"
    with pytest.raises(FactoryError, match=r"4 train frames.*simnfnd make"):
        PairStream(*WORDS, empty)
    with pytest.raises(FactoryError, match=r"split=test: none"):
        PairStream(*words, "split.test_fraction=0", split="test")
    with pytest.raises(FactoryError, match=r"config\.yaml: cannot be read"):
        PairStream(dataset=tmp_path)
    with pytest.raises(ValueError, match="batch_size=0"):
        PairStream(*words, batch_size=0)
