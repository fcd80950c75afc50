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
    settings = DatasetSettings(**changes)
    return write_shard(root, relative, pairs, SOURCE.axes(), SOURCE.columns(), provenance, settings)


def dataset(root: Path) -> Manifest:
    """Two scenes that train, one that tests, in three shards, with a manifest."""
    manifest = open_folder(root, {"whole": True}, PROVENANCE)
    for relative, scene in (
        ("train/shard-00000.h5", "alpha"),
        ("train/shard-00001.h5", "beta"),
        ("test/shard-00000.h5", "gamma"),
    ):
        info = write(root, some_pairs(4, scene), relative)
        assert info is not None
        manifest = manifest.with_shard(info)
    save_manifest(root, manifest)
    return manifest
