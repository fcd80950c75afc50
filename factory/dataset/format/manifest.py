"""manifest.json: which shards make up the dataset, and how to tell that they are whole.

While a run goes on, what it has settled lies beside the shards (`results`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ...errors import FactoryError
from ...files import sha256_of, write_atomically
from ...small_files import one_line, parse_json, read_regular
from ...storage.copies import fetched
from .results import outcomes
from .schema import SCHEMA, SPLITS
from .shard_info import ShardInfo, shard_info

__all__ = ["Manifest", "ShardInfo", "damage", "load_manifest", "save_manifest"]

MANIFEST_NAME = "manifest.json"
# All shards as one file, by virtual datasets.
INDEX_NAME = "index.h5"
# Every setting of the run.
CONFIG_NAME = "config.yaml"
# Keys of a configuration under which those of earlier datasets are kept.
PARTS = ("merged", "extends")

# A shard takes some 400 bytes.
MAX_SHARDS = 200_000
_MAX_BYTES = 1 << 27


@dataclass(frozen=True)
class Manifest:
    """All finished shards of a dataset, by path.

    config: the settings that `config_hash` stands for.
    index_sha256: of the index.h5 that shows these very shards; empty: there is none.
    """

    config_hash: str
    generator: str
    config: Mapping[str, Any] = field(default_factory=dict)
    shards: Mapping[str, ShardInfo] = field(default_factory=dict)
    index_sha256: str = ""

    def with_shard(self, info: ShardInfo) -> Manifest:
        """The manifest with `info` added, or put in place of the same path."""
        return replace(self, shards={**self.shards, info.path: info}, index_sha256="")

    def samples(self, split: str | None = None) -> int:
        """Number of samples, in all or of one split."""
        return sum(s.samples for s in self.shards.values() if split in (None, s.split))

    @property
    def config_hashes(self) -> frozenset[str]:
        """Hashes that its shards may state: its own, or those of datasets that went into it."""
        return frozenset(
            {self.config_hash, *(str(part.get("config_hash")) for part in self.parts())}
        )

    def parts(self) -> Iterator[Mapping[str, Any]]:
        """The records of the datasets that were merged into this one, or that it extends."""
        waiting = [self.config]
        while waiting:
            config = waiting.pop()
            for key in PARTS:
                listed = config.get(key)
                listed = listed if isinstance(listed, list) else []
                found = [part for part in listed if isinstance(part, dict)]
                yield from found
                waiting += found

    def total_bytes(self) -> int:
        """Size of all shards together."""
        return sum(s.bytes for s in self.shards.values())


def save_manifest(directory: Path, manifest: Manifest) -> None:
    """Write manifest.json atomically; equal manifests give equal bytes."""
    shards = [manifest.shards[path] for path in sorted(manifest.shards)]
    totals = {
        split: {
            "samples": sum(s.samples for s in shards if s.split == split),
            "shards": sum(s.split == split for s in shards),
            "bytes": sum(s.bytes for s in shards if s.split == split),
        }
        for split in SPLITS
    }
    document = {
        "schema": SCHEMA,
        "generator": manifest.generator,
        "config_hash": manifest.config_hash,
        "config": manifest.config,
        "totals": totals,
        **({"index_sha256": manifest.index_sha256} if manifest.index_sha256 else {}),
        "shards": [asdict(shard) for shard in shards],
    }
    text = json.dumps(document, indent=1) + "\n"
    write_atomically(directory / MANIFEST_NAME, text.encode())


def load_manifest(directory: Path) -> Manifest | None:
    """Read manifest.json, or None when there is none.

    What runs have settled since is taken in.  Raises FactoryError when it is damaged.
    """
    path = directory / MANIFEST_NAME
    try:
        document = parse_json(read_regular(path, _MAX_BYTES))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema is {document['schema']!r}, expected {SCHEMA!r}")
        shards = [shard_info(item) for item in document["shards"]]
        if len({shard.path for shard in shards}) != len(shards):
            raise ValueError("a shard is listed twice")
        hash_, generator = document["config_hash"], document["generator"]
        config, index = document["config"], document.get("index_sha256", "")
        if not all(isinstance(text, str) for text in (hash_, generator, index)):
            raise ValueError("config_hash, generator and index_sha256 must be text")
        if not isinstance(config, dict):
            raise ValueError("config must be an object")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FactoryError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        reason = one_line(error)
        raise FactoryError(
            f"{path}: damaged ({reason}); delete it and run again, the shards are then made anew"
        ) from error
    found = {shard.path: shard for shard in shards}
    for name, outcome in outcomes(directory, hash_).items():
        if outcome.info is None:
            found.pop(name, None)
        else:
            found[name] = outcome.info
    still = len(found) == len(shards) and all(found.get(one.path) == one for one in shards)
    return Manifest(hash_, generator, config, found, index if still else "")


def damage(directory: Path, info: ShardInfo) -> str | None:
    """What is wrong with a finished shard on disk (absent, size, SHA-256), or None."""
    path = directory / info.path
    fetched(path)
    try:
        size = path.stat().st_size
        if size != info.bytes:
            return f"{size} bytes instead of {info.bytes}"
        return None if sha256_of(path) == info.sha256 else "SHA-256 differs"
    except FileNotFoundError:
        return "absent"
    except OSError as error:
        return f"cannot be read ({error.strerror})"
