"""Shards at a URL: how often each is fetched, by one reader, by several, and for the tables."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.read import stream, tables
from simnfnd.factory.dataset.read.open_shards import OpenShards
from simnfnd.factory.dataset.read.reader import bring
from simnfnd.factory.dataset.read.stream import Windows
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.storage.copies import fetched, local_folder
from simnfnd.factory.storage.store import Store
from tests.factory.dataset.hostile import PROVENANCE
from tests.fake_source import FakeConfig, FakeSource, refs
from tests.project_files import ROOT

fsspec = pytest.importorskip("fsspec")

SHARDS, PAIRS, WINDOW = 12, 3, 2


@dataclass
class Asked:
    """What a storage was asked for.  counts: whole shards by name.  pieces: bytes of parts."""

    counts: Counter[str] = field(default_factory=Counter)
    pieces: Counter[str] = field(default_factory=Counter)

    @property
    def most(self) -> int:
        """How often the shard that was fetched most often was."""
        return max(self.counts.values(), default=0)


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of a dozen shards of two scenes in a folder."""
    frames = refs(SHARDS * PAIRS - PAIRS) + refs(PAIRS, "gamma")
    return made(tmp_path_factory.mktemp("local") / "dozen", frames, PAIRS, FakeConfig())


def made(folder: Path, frames: list[FrameRef], a_shard: int, config: FakeConfig) -> Path:
    """A dataset of these frames in a folder."""
    source = FakeSource(config)
    how = source.axes(), source.columns(), PROVENANCE, DatasetSettings()
    infos = {}
    for number in range(len(frames) // a_shard):
        some = frames[number * a_shard :][:a_shard]
        pairs = [source.pairs(ref, (0,))[0] for ref in some]
        info = write_shard(folder, f"train/shard-{number:05d}.h5", pairs, *how)
        assert info is not None
        infos[info.path] = info
    save_manifest(folder, Manifest(PROVENANCE.config_hash, "simnfnd test", {}, infos))
    return folder


def put(local: Path, name: str) -> str:
    """The dataset at memory://."""
    system = fsspec.filesystem("memory")
    for path in (local / "manifest.json", *local.glob("train/*.h5")):
        system.pipe(f"/{name}/{path.relative_to(local).as_posix()}", path.read_bytes())
    return f"memory://{name}"


@pytest.fixture
def url(local: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The same at memory://, with an empty place for copies."""
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE", str(tmp_path / "copies"))
    yield put(local, "once")
    fsspec.filesystem("memory").rm("/once", recursive=True)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    found, plain = Asked(), Store.get

    def get(self: Store, name: str, start: int | None = None, end: int | None = None) -> Any:
        content = plain(self, name, start, end)
        if name.endswith(".h5") and name != "index.h5":
            if start is None:
                found.counts[name] += 1
                time.sleep(0.01)  # as long as others need to ask for it, too
            else:
                found.pieces[name] += len(content or b"")
        return content

    monkeypatch.setattr(Store, "get", get)
    return found


def _sizes(pairs: PairDataset) -> dict[Path, int]:
    return {path: info.bytes for path, info in pairs._expected.shards.items()}


def keep(monkeypatch: pytest.MonkeyPatch, local: Path, shards: float) -> None:
    """Room for so many shards."""
    size = max(path.stat().st_size for path in local.glob("train/*.h5"))
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE_BYTES", str(int(shards * size)))


def finish(windows: Windows) -> None:
    """Wait for what is fetched ahead."""
    assert windows._threads is not None
    windows._threads.shutdown()
    windows._threads = None


def visits_of(images: int, steps: int, windows: Windows | None) -> Any:
    """One visit a step, as a training has them."""
    from simnfnd.models.data.crops import VisitSampler
    from simnfnd.models.settings import PairsData

    data = PairsData(
        kind="pairs",
        patch=16,
        batch=1,
        crops=1,
        stages=(),
        flip=False,
        weaker=0,
        validation=0.1,
        validation_limit=None,
        workers=0,
    )
    return VisitSampler(images, data, 1, steps, 0, windows)


# One shard; less than a window; one and a half; two and what may go at once; all.
@pytest.mark.parametrize("room", [1, 1.5, 3.3, 4.5, 50])
def test_shuffled_fetches_each_shard_once_an_epoch(
    local: Path, url: str, asked: Asked, monkeypatch: pytest.MonkeyPatch, room: float
) -> None:
    keep(monkeypatch, local, room)
    with PairDataset(url) as distant, PairDataset(local) as near:
        for epoch in range(2):
            found = [one["noisy"].tobytes() for one in distant.shuffled(3, epoch, window=WINDOW)]
            wanted = [one["noisy"].tobytes() for one in near.shuffled(3, epoch, window=WINDOW)]
            assert found == wanted
            assert asked.most <= epoch + 1
    assert len(asked.counts) == SHARDS


@pytest.mark.parametrize("room", [1, 4.5])
def test_training_fetches_each_shard_once_for_the_table_and_once_a_round(
    local: Path, url: str, asked: Asked, monkeypatch: pytest.MonkeyPatch, room: float
) -> None:
    pytest.importorskip("torch")
    from simnfnd.models.data.pairs import PairSource, read_table, windows_of

    monkeypatch.setattr(stream, "WINDOW", WINDOW)
    keep(monkeypatch, local, room)
    table = read_table(url, "train")
    assert asked.counts == {f"train/shard-{number:05d}.h5": 1 for number in range(SHARDS)}
    asked.counts.clear()
    source = PairSource(table.samples, table.sonar)
    for step in visits_of(len(source), len(source), windows_of(source)):
        for visit in step:
            source.sample(visit.image, visit.number)
    # 36 visits: one round, of which the cache still holds some shards.
    assert asked.most == 1
    asked.counts.clear()
    assert read_table(url, "train").samples == table.samples
    assert sum(asked.counts.values()) <= 1, "tables are kept; one shard is opened for the settings"


def test_the_first_window_of_a_training_is_fetched_ahead(
    local: Path, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch")
    brought: list[Path] = []
    monkeypatch.setattr(stream, "bring", lambda path, wait: brought.append(path))
    with PairDataset(url) as pairs:
        places = [pairs.place(index)[0] for index in range(len(pairs))]
    windows = Windows(places, WINDOW)
    steps = iter(visits_of(len(places), len(places) + 1, windows))
    first = next(steps)[0].image
    finish(windows)
    assert places[first] in brought
    assert len(brought) == 2 * WINDOW
    for _ in range(len(places) - 1):
        next(steps)
    finish(windows)
    brought.clear()
    again = next(steps)[0].image
    finish(windows)
    assert places[again] in brought, "of the new round, and not of the one before"


def test_readers_behind_find_their_shards_where_there_is_room(
    local: Path, url: str, asked: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As loading processes are: the sampler is ahead of them, and each opens a shard by itself."""
    late = 2 * WINDOW * PAIRS
    # Two windows behind, the one that is reached and the next one, and what may go at once.
    keep(monkeypatch, local, 4 * WINDOW * 16 / 15 + 1)
    with PairDataset(url) as pairs:
        places = [pairs.place(index) for index in range(len(pairs))]
        sizes = _sizes(pairs)
    windows = Windows([path for path, _ in places], WINDOW, sizes=sizes, unread=late)
    order = windows.order(np.random.default_rng(5))
    readers = [OpenShards(), OpenShards()]
    for position in range(len(order) + late):
        if position < len(order):
            windows.reach(position)
        if position >= late:
            path, row = places[order[position - late]]
            readers[position % 2].read(path, ("noisy",), row)
    windows.close()
    assert asked.counts == {f"train/shard-{number:05d}.h5": 1 for number in range(SHARDS)}


def test_a_round_that_goes_on_in_the_middle_is_fetched_ahead(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    brought: list[Path] = []
    monkeypatch.setattr(stream, "bring", lambda path, wait: brought.append(path))
    with PairDataset(url) as pairs:
        places = [pairs.place(index)[0] for index in range(len(pairs))]
    windows = Windows(places, WINDOW)
    order = windows.order(np.random.default_rng(5))
    middle = 3 * WINDOW * PAIRS + 1
    windows.reach(middle)
    finish(windows)
    following = order[3 * WINDOW * PAIRS : 5 * WINDOW * PAIRS]
    assert set(brought) == {places[index] for index in following}


def test_threads_that_want_one_shard_fetch_it_once(url: str, asked: Asked) -> None:
    path = local_folder(url) / "train/shard-00007.h5"
    threads = [threading.Thread(target=bring, args=(path,)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert path.exists()
    assert asked.counts == {"train/shard-00007.h5": 1}


def test_processes_that_want_one_shard_fetch_it_once(
    local: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE", str(tmp_path / "copies"))
    path = local_folder(f"file://{local}") / "train/shard-00007.h5"
    log = tmp_path / "log"
    code = (
        "import sys, time; from pathlib import Path\n"
        "from simnfnd.factory.storage.store import Store\n"
        "from simnfnd.factory.dataset.read.reader import bring\n"
        "plain = Store.get\n"
        "def get(self, name, *part):\n"
        "    open(sys.argv[2], 'a').write(name + '\\n')\n"
        "    time.sleep(2)\n"
        "    return plain(self, name, *part)\n"
        "Store.get = get\n"
        "bring(Path(sys.argv[1]))"
    )
    words = [sys.executable, "-c", code, str(path), str(log)]
    both = [subprocess.Popen(words, cwd=ROOT) for _ in range(2)]
    assert [process.wait(60) for process in both] == [0, 0]
    assert path.exists()
    assert log.read_text() == "train/shard-00007.h5\n"


def test_of_large_shards_pieces_are_fetched_for_the_table(
    asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # No piece is so large that nothing of what HDF5 reads is beyond it.
    for name, value in (("_HEAD", 4096), ("_TAIL", 2048), ("_STEP", 2048), ("_LARGE", 1)):
        monkeypatch.setattr(tables, f"{name}_BYTES", value)
    monkeypatch.setattr(tables, "_TRIES", 50)
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE", str(tmp_path / "copies"))
    large = made(tmp_path / "large", refs(24), 8, FakeConfig(shape=(240, 200)))
    with PairDataset(large) as near, PairDataset(put(large, "large")) as distant:
        wanted, found = near.meta(), distant.meta()
        assert found.dtype == wanted.dtype
        assert found.tobytes() == wanted.tobytes()
        assert not list(distant.folder.glob("t*/*.h5"))
        assert (len(asked.pieces), len(asked.counts)) == (3, 0)
        for path, size in _sizes(distant).items():
            assert 4096 + 2048 < asked.pieces[f"train/{path.name}"] < size / 2
        asked.pieces.clear()
        assert distant.meta().tobytes() == wanted.tobytes()
        assert not asked.pieces, "they are kept beside the copy"


def test_a_large_shard_that_is_damaged_is_told_as_any_other(
    local: Path, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "_LARGE_BYTES", 1)
    path = local / "train/shard-00003.h5"
    content = bytearray(path.read_bytes())
    with PairDataset(local) as pairs:
        row = pairs.meta()[3 * PAIRS].tobytes()
    content[content.index(row) + 2] ^= 1
    fsspec.filesystem("memory").pipe("/once/train/shard-00003.h5", bytes(content))
    with (
        PairDataset(url) as pairs,
        pytest.raises(FactoryError, match=r"shard-00003.h5: .*differ from their checksum"),
    ):
        pairs.meta()


def test_kept_tables_of_another_state_are_not_taken(
    local: Path, url: str, asked: Asked, tmp_path: Path
) -> None:
    with PairDataset(url) as pairs:
        assert len(pairs.meta()) == SHARDS * PAIRS
        (kept,) = pairs.folder.glob(".tables-*")
    kept.write_bytes(kept.read_bytes()[:-5])
    with PairDataset(url) as pairs:
        assert len(pairs.meta()) == SHARDS * PAIRS, "a damaged one is made anew"
    with PairDataset(local) as near:
        less = Manifest(
            PROVENANCE.config_hash,
            "simnfnd test",
            {},
            {
                info.path: info
                for info in near._expected.shards.values()
                if info.path != "train/shard-00011.h5"
            },
        )
    (tmp_path / "less").mkdir()
    save_manifest(tmp_path / "less", less)
    content = (tmp_path / "less/manifest.json").read_bytes()
    fsspec.filesystem("memory").pipe("/once/manifest.json", content)
    with PairDataset(url) as pairs:
        assert len(pairs.meta()) == (SHARDS - 1) * PAIRS
        assert len(list(pairs.folder.glob(".tables-*"))) == 1


def test_a_limit_that_is_no_number_is_one_line(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE_BYTES", "10 GB")
    with (
        PairDataset(url) as pairs,
        pytest.raises(FactoryError, match="SIMNFND_CLOUD_CACHE_BYTES=10 GB: must be a whole"),
    ):
        pairs[0]


def test_a_shard_that_waited_for_its_look_is_not_the_first_to_go(url: str) -> None:
    folder = local_folder(url)
    first, second = (folder / f"train/shard-{number:05d}.h5" for number in range(2))
    bring(first)
    fetched(second, look=lambda aside: os.utime(aside, ns=(0, aside.stat().st_mtime_ns)))
    assert first.stat().st_atime_ns < second.stat().st_atime_ns
