"""A few pairs, a shard of them, and a dataset of three shards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simnfnd.factory.dataset.folder import open_folder
from simnfnd.factory.dataset.manifest import Manifest, ShardInfo, save_manifest
from simnfnd.factory.dataset.schema import Pair, Provenance, config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard
from tests.fake_source import FakeConfig, FakeSource, refs

SHARDS = {
    "train/shard-00000.h5": "alpha",
    "train/shard-00001.h5": "beta",
    "test/shard-00000.h5": "gamma",
}
SOURCE = FakeSource(FakeConfig())
CONFIG = {"seed": 7, "sonar": {"hfov_deg": 30.0}, "noise": {"density": {"uniform": [0.1, 0.5]}}}
PROVENANCE = Provenance(CONFIG, config_hash(CONFIG), "simnfnd 0.1.0")


def some_pairs(count: int = 3, scene: str = "alpha") -> list[Pair]:
    return [SOURCE.pairs(ref, (0,))[0] for ref in refs(count, scene)]


def write(
    root: Path,
    pairs: Any = None,
    relative: str = "train/shard-00000.h5",
    provenance: Provenance = PROVENANCE,
    **changes: Any,
) -> ShardInfo | None:
    pairs = some_pairs() if pairs is None else pairs
    description = SOURCE.axes(), SOURCE.columns(), provenance, DatasetSettings(**changes)
    return write_shard(root, relative, pairs, *description)


def write_all(
    root: Path, shards: dict[str, list[Pair]], provenance: Provenance, **changes: Any
) -> Manifest:
    """Shards by their path below the folder, and the manifest that lists them."""
    manifest = Manifest(provenance.config_hash, provenance.generator, dict(provenance.config))
    for relative, pairs in shards.items():
        info = write(root, pairs, relative, provenance, **changes)
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(root, manifest)
    return manifest


def dataset(root: Path) -> Manifest:
    """Two scenes that train, one that tests, in three shards, with a manifest."""
    open_folder(root, {"whole": True}, PROVENANCE)
    shards = {relative: some_pairs(4, scene) for relative, scene in SHARDS.items()}
    return write_all(root, shards, PROVENANCE)
