"""The reader: every sample, from anywhere, in any process; and index.h5 for h5py alone."""

from __future__ import annotations

import gc
import multiprocessing
import pickle
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import psutil
import pytest
import torch

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset import PairDataset, reader, writer
from simnfnd.factory.dataset.manifest import load_manifest
from simnfnd.factory.dataset.pair_dataset import Share
from tests.factory.dataset.hostile import admit, whole, with_layers
from tests.factory.dataset.some_shards import SOURCE, some_pairs, write

SHARD = "train/shard-00000.h5"
PAIRS = [with_layers(pair) for scene in ("alpha", "beta") for pair in some_pairs(4, scene)]


def opened(folder: Path, **keywords: Any) -> PairDataset:
    return PairDataset(folder, trusted=True, **keywords)


def test_every_sample_is_what_was_written(sound: Path) -> None:
    layers = ("noisy", "clean", "shadow", "range", "instance", "layers/background")
    with PairDataset(sound, layers=layers) as pairs:
        assert len(pairs) == 8
        for sample, pair in zip(pairs, PAIRS, strict=True):
            assert tuple(sample) == layers
            for name in ("noisy", "clean", "shadow"):
                np.testing.assert_array_equal(sample[name], getattr(pair, name))
            for name in layers[3:]:
                np.testing.assert_array_equal(sample[name], pair.layers[name])
                assert sample[name].dtype == pair.layers[name].dtype


def np_index(item: Any) -> Any:
    """What numpy takes for the same."""
    return item if isinstance(item, slice) else np.asarray(item, None if len(item) else np.intp)


@pytest.mark.parametrize(
    "item",
    [
        *(slice(None), slice(2, 7), slice(7, 1, -2), slice(3, 3)),
        *([5, 0, 5, -1], np.array([3, 4, 5]), [], np.array([], np.int64)),
        *(np.arange(8) % 3 == 0, np.zeros(8, bool), [True] * 8, torch.tensor([2, 6])),
    ],
)
def test_several_samples_at_once_are_stacked(sound: Path, item: Any) -> None:
    noisy = np.stack([pair.noisy for pair in PAIRS])
    with opened(sound) as pairs:
        np.testing.assert_array_equal(pairs[item]["noisy"], noisy[np_index(item)])
        assert pairs[item]["clean"].dtype == np.uint8
        np.testing.assert_array_equal(pairs[-8]["noisy"], pairs[np.int64(0)]["noisy"])
        for wrong in (8, -9, [8], True, np.zeros(7, bool), [0.5], np.zeros((2, 2), np.int64)):
            with pytest.raises(IndexError):
                pairs[wrong]


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_values_are_in_the_range_that_is_stated(tmp_path: Path, dtype: str, scaled: bool) -> None:
    with opened(whole(tmp_path / "dataset", dtype=dtype), scaled=scaled) as pairs:
        clean = pairs[0]["clean"]
        assert clean.dtype == pairs.dtype == (np.float32 if scaled else dtype)
        low, high = pairs.value_range
        assert (low, high) == ((0, 255) if pairs.dtype == np.uint8 else (0.0, 1.0))
        np.testing.assert_allclose(clean / high, np.asarray(PAIRS[0].clean, float) / 255, atol=1e-6)


def open_files(folder: Path) -> list[str]:
    names = [file.path for file in psutil.Process().open_files()]
    return [name for name in names if name.startswith(str(folder))]


def noisy_of(pairs: PairDataset, number: int) -> bytes:
    return bytes(pairs[number]["noisy"].tobytes())


def test_nothing_is_open_before_the_first_read_and_after_the_last(folder: Path) -> None:
    pairs = opened(folder)
    assert open_files(folder) == []
    noisy_of(pairs, 0)
    noisy_of(pairs, 7)
    assert len(open_files(folder)) == 2
    pairs.close()
    assert open_files(folder) == []
    noisy_of(pairs, 0)
    del pairs
    gc.collect()
    assert open_files(folder) == []


def test_a_dataset_of_many_shards_keeps_few_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "_MOST_FILES", 4)
    for number in range(7):
        pair = replace(PAIRS[0], noisy=np.full((24, 20), number, np.uint8), layers={})
        write(tmp_path, [pair], f"train/shard-{number:05d}.h5")
    with opened(tmp_path) as pairs:
        for _ in range(2):
            assert [int(sample["noisy"][0, 0]) for sample in pairs] == list(range(len(pairs)))
            assert len(open_files(tmp_path)) == 4


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_other_processes_read_the_same(sound: Path, method: str) -> None:
    pairs = opened(sound)
    expected = [noisy_of(pairs, number) for number in range(8)]  # files are open when it forks
    context = multiprocessing.get_context(method)
    with ProcessPoolExecutor(2, mp_context=context) as pool:
        assert list(pool.map(noisy_of, [pairs] * 8, range(8))) == expected
    assert noisy_of(pickle.loads(pickle.dumps(pairs)), 5) == expected[5]
    pairs.close()


def test_threads_read_the_same(sound: Path) -> None:
    pairs = opened(sound)
    expected = [noisy_of(pairs, number) for number in range(8)]
    wrong: list[int] = []

    def read(seed: int) -> None:
        for number in np.random.default_rng(seed).integers(8, size=200):
            if noisy_of(pairs, int(number)) != expected[number]:
                wrong.append(int(number))

    threads = [threading.Thread(target=read, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def test_shuffled_samples_come_once_from_several_workers(sound: Path) -> None:
    from torch.utils.data import DataLoader, IterableDataset

    class Shuffled(IterableDataset[Any]):
        def __iter__(self) -> Iterator[Any]:
            return opened(sound).shuffled(3)

    alone = [sample["noisy"].tobytes() for sample in opened(sound).shuffled(3)]
    assert len(set(alone)) == 8
    for workers in (0, 3):
        loader = DataLoader(
            Shuffled(),
            None,
            num_workers=workers,
            multiprocessing_context="fork" if workers else None,
        )
        assert sorted(np.asarray(batch["noisy"]).tobytes() for batch in loader) == sorted(alone)
    shares = [opened(sound).shuffled(3, share=Share(rank, 2)) for rank in range(2)]
    parts = [[sample["noisy"].tobytes() for sample in share] for share in shares]
    assert parts == [alone[::2], alone[1::2]]


def test_links_into_a_store_are_read_where_they_are_trusted(sound: Path, tmp_path: Path) -> None:
    linked = tmp_path / "linked"
    for path in sound.rglob("*.*"):
        place = linked / path.relative_to(sound)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(path)
    with pytest.raises(FactoryError, match="trusted=True"):
        PairDataset(linked)
    with opened(linked) as pairs, opened(sound) as originals:
        np.testing.assert_array_equal(pairs[:]["noisy"], originals[:]["noisy"])


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lambda root: (root / "train/shard-00001.h5").unlink(), "shard-00001.h5: listed .* absent"),
        (lambda root: (root / "manifest.json").write_text("{"), "manifest.json: damaged"),
        (lambda root: (root / SHARD).write_bytes(b"x"), r"00000\.h5: 1 bytes, the manifest says"),
        (lambda root: shutil.rmtree(root), "no such folder"),
    ],
)
def test_a_dataset_that_is_not_whole_is_refused_at_once(
    folder: Path, harm: Callable[[Path], Any], words: str
) -> None:
    harm(folder)
    with pytest.raises(FactoryError, match=words) as caught:
        PairDataset(folder)
    assert "\n" not in str(caught.value)


def test_an_unknown_or_absent_layer_is_named(folder: Path) -> None:
    with pytest.raises(FactoryError, match="/photo: "):
        PairDataset(folder, layers=("noisy", "photo"))
    pairs = opened(folder, layers=("layers/multipath",))
    with pytest.raises(FactoryError, match=r"layers/multipath.*dataset\.layers"):
        pairs[0]


@pytest.mark.parametrize("trusted", [False, True])
def test_another_schema_names_file_and_cure(folder: Path, trusted: bool) -> None:
    with h5py.File(folder / SHARD, "r+") as file:
        file.attrs["schema"] = "simnfnd/2"
    admit(folder)
    with pytest.raises(FactoryError, match=r"shard-00000\.h5: attribute schema .*2'.*matching"):
        PairDataset(folder, trusted=trusted)[0]


def test_an_index_never_shows_zeros_for_a_shard(folder: Path, monkeypatch) -> None:
    with h5py.File(folder / "index.h5") as index:
        joined = index["train/noisy"][()]
    monkeypatch.setattr(writer, "_MOST_JOINED_BYTES", 1)
    manifest = load_manifest(folder)
    assert manifest is not None
    writer.write_index(folder, manifest)
    with h5py.File(folder / "index.h5") as index:
        linked = [shard["noisy"][()] for shard in index["train"].values()]
        np.testing.assert_array_equal(np.concatenate(linked), joined)
        assert len(linked) == 2
    (folder / SHARD).unlink()
    with h5py.File(folder / "index.h5") as index, pytest.raises(KeyError):
        index[SHARD.removesuffix(".h5")]


def test_h5py_alone_reads_the_index_of_a_moved_dataset(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved = folder.rename(tmp_path / "elsewhere")
    monkeypatch.chdir("/")
    with h5py.File(moved / "index.h5") as index, opened(moved) as pairs:
        assert set(index) == {"train", "test", "axes"}
        for name in ("noisy", "clean", "shadow"):
            stack = index[f"train/{name}"]
            np.testing.assert_array_equal(stack[:], [getattr(pair, name) for pair in PAIRS])
            assert [dimension.label for dimension in stack.dims] == ["sample", "ahead", "right"]
            np.testing.assert_array_equal(stack.dims[1][0][:], SOURCE.axes()[0].values)
            assert not stack.is_virtual
        assert index["test/layers/background"].shape == (4, 24, 20)
        assert index["train/segmentation"].attrs["classes"][1] == "Bottle"
        np.testing.assert_array_equal(index["train/meta"][()], pairs.meta())
        assert index.attrs["schema"] == "simnfnd/1"
        np.testing.assert_array_equal(pairs[6]["noisy"], index["train/noisy"][6])
