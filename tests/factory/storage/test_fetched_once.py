"""Shards at a URL: how often each is fetched, by one reader, by several, and for the tables."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.storage.store import Store
from tests.factory.dataset.hostile import PROVENANCE
from tests.fake_source import FakeConfig, FakeSource, refs

fsspec = pytest.importorskip("fsspec")

SHARDS, PAIRS, WINDOW = 12, 3, 2


@dataclass
class Asked:
    """What a storage was asked for.  counts: shards by name."""

    counts: Counter[str] = field(default_factory=Counter)

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
    values = dict(PROVENANCE.config)
    save_manifest(folder, Manifest(PROVENANCE.config_hash, "simnfnd test", values, infos))
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

    def get(self: Store, name: str) -> Any:
        content = plain(self, name)
        if name.endswith(".h5") and name != "index.h5":
            found.counts[name] += 1
            time.sleep(0.01)  # as long as others need to ask for it, too
        return content

    monkeypatch.setattr(Store, "get", get)
    return found


def keep(monkeypatch: pytest.MonkeyPatch, local: Path, shards: float) -> None:
    """Room for so many shards."""
    size = max(path.stat().st_size for path in local.glob("train/*.h5"))
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE_BYTES", str(int(shards * size)))


def visits_of(images: int, steps: int, places: list[Path] | None) -> Any:
    """One visit a step, as a training has them."""
    from simnfnd.models.data.crops import VisitSampler
    from simnfnd.models.settings import PairsData

    data = PairsData(
        kind="pairs",
        patch=16,
        batch=1,
        crops=1,
        weaker=0,
        validation=0.1,
        validation_limit=None,
        workers=0,
    )
    return VisitSampler(images, data, steps, 0, places)


# One shard; all.
@pytest.mark.parametrize("room", [1, 50])
def test_shuffled_fetches_each_shard_once_an_epoch(
    local: Path, url: str, asked: Asked, monkeypatch: pytest.MonkeyPatch, room: float
) -> None:
    keep(monkeypatch, local, room)
    with PairDataset(url) as distant, PairDataset(local) as near:
        for epoch in range(2):
            found = [one["noisy"].tobytes() for one in distant.shuffled(3, epoch, window=WINDOW)]
            wanted = [one["noisy"].tobytes() for one in near.shuffled(3, epoch, window=WINDOW)]
            assert found == wanted
            assert sorted(found) == sorted(one["noisy"].tobytes() for one in near)
            kept = sum(path.stat().st_size for path in distant.folder.glob("t*/*.h5"))
            assert kept <= int(os.environ["SIMNFND_CLOUD_CACHE_BYTES"])
            assert asked.most <= epoch + 1
    assert len(asked.counts) == SHARDS


@pytest.mark.parametrize("room", [1, 4.5])
def test_training_fetches_each_shard_once_for_the_table_and_once_a_round(
    local: Path, url: str, asked: Asked, monkeypatch: pytest.MonkeyPatch, room: float
) -> None:
    pytest.importorskip("torch")
    from simnfnd.models.data.pairs import PairSource, distant_places, read_table

    keep(monkeypatch, local, room)
    table = read_table(url, "train")
    assert asked.counts == {f"train/shard-{number:05d}.h5": 1 for number in range(SHARDS)}
    asked.counts.clear()
    source = PairSource(table.samples, table.sonar)
    for step in visits_of(len(source), len(source), distant_places(source)):
        for visit in step:
            source.sample(visit.image, visit.number)
    # 36 visits: one round, of which the cache still holds some shards.
    assert asked.most == 1


def test_a_limit_that_is_no_number_is_one_line(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE_BYTES", "10 GB")
    with (
        PairDataset(url) as pairs,
        pytest.raises(FactoryError, match="SIMNFND_CLOUD_CACHE_BYTES=10 GB: must be a whole"),
    ):
        pairs[0]
