"""manifest.json: which shards make up the dataset, and how to tell that they are whole."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from factory.errors import FactoryError
from factory.shards.files import sha256_of, write_atomically
from factory.shards.schema import SCHEMA, SPLITS

MANIFEST_NAME = "manifest.json"

# A shard takes some 400 bytes: enough for a million of them.
_MAX_BYTES = 1 << 29
_PATH = re.compile(rf"({'|'.join(SPLITS)})/[A-Za-z0-9_-]+\.h5")


@dataclass(frozen=True)
class ShardInfo:
    """One finished shard.

    path: below the dataset's folder, with forward slashes.
    plan: digest of the frames and variants that the shard was meant to hold.
    failed: names of the planned frames that it lacks.
    """

    path: str
    split: str
    samples: int
    bytes: int
    sha256: str
    plan: str = ""
    failed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        counts = (self.samples, self.bytes)
        texts = (self.path, self.split, self.sha256, self.plan, *self.failed)
        if not all(type(count) is int and count >= 0 for count in counts):
            raise ValueError(f"samples and bytes must be counts, got {counts}")
        # Every sample takes some bytes: no count may be what no file can hold.
        if self.samples > self.bytes:
            raise ValueError(f"{self.samples} samples in {self.bytes} bytes")
        if not all(isinstance(text, str) for text in texts):
            raise ValueError("path, split, sha256, plan and failed must be text")
        # Nothing outside the dataset's folder may be named, whoever wrote the file.
        if not _PATH.fullmatch(self.path) or self.path.split("/")[0] != self.split:
            raise ValueError(f"{self.path!r} is no shard of split {self.split!r}")


@dataclass(frozen=True)
class Manifest:
    """All finished shards of a dataset, by path.

    config: the settings that `config_hash` stands for.
    """

    config_hash: str
    generator: str
    config: Mapping[str, Any] = field(default_factory=dict)
    shards: Mapping[str, ShardInfo] = field(default_factory=dict)

    def with_shard(self, info: ShardInfo) -> Manifest:
        """The manifest with `info` added, or put in place of the same path."""
        return replace(self, shards={**self.shards, info.path: info})

    def without(self, path: str) -> Manifest:
        """The manifest without the shard at `path`."""
        return replace(self, shards={key: s for key, s in self.shards.items() if key != path})

    def samples(self, split: str | None = None) -> int:
        """Number of samples, in all or of one split."""
        return sum(s.samples for s in self.shards.values() if split in (None, s.split))

    @property
    def config_hashes(self) -> frozenset[str]:
        """Hashes that its shards may state: its own, or those of the datasets merged into it."""
        found, waiting = {self.config_hash}, [self.config]
        while waiting:
            merged = waiting.pop().get("merged")
            parts = (
                [part for part in merged if isinstance(part, dict)]
                if isinstance(merged, list)
                else []
            )
            found |= {str(part.get("config_hash")) for part in parts}
            waiting += parts
        return frozenset(found)

    def total_bytes(self) -> int:
        """Size of all shards together."""
        return sum(s.bytes for s in self.shards.values())


def part_name(name: str, part: str) -> str:
    """File name of a slice's own copy: manifest.json and 0-of-4 give manifest.0-of-4.json."""
    stem, _, suffix = name.rpartition(".")
    return f"{stem}.{part}.{suffix}" if part else name


def save_manifest(directory: Path, manifest: Manifest, part: str = "") -> None:
    """Write manifest.json (of a slice: `part`) atomically; equal manifests give equal bytes."""
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
        "shards": [asdict(shard) for shard in shards],
    }
    text = json.dumps(document, indent=1) + "\n"
    write_atomically(directory / part_name(MANIFEST_NAME, part), text.encode())


def load_manifest(directory: Path, part: str = "") -> Manifest | None:
    """Read manifest.json (of a slice: `part`), or None when there is none.

    Raises FactoryError when it is damaged.
    """
    path = directory / part_name(MANIFEST_NAME, part)
    try:
        size = path.stat().st_size
        if not path.is_file() or size > _MAX_BYTES:
            raise ValueError(f"{size} bytes, or no regular file")
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema is {document['schema']!r}, expected {SCHEMA!r}")
        shards = [_shard(item) for item in document["shards"]]
        if len({shard.path for shard in shards}) != len(shards):
            raise ValueError("a shard is listed twice")
        hash_, generator = document["config_hash"], document["generator"]
        config = document["config"]
        if not (isinstance(hash_, str) and isinstance(generator, str) and isinstance(config, dict)):
            raise ValueError("config_hash and generator must be text, config an object")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FactoryError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        reason = " ".join(str(error).split())[:200]
        raise FactoryError(
            f"{path}: damaged ({reason}); delete it and run again, the shards are then made anew"
        ) from error
    return Manifest(hash_, generator, config, {shard.path: shard for shard in shards})


def damage(directory: Path, info: ShardInfo) -> str | None:
    """What is wrong with a finished shard on disk (absent, size, SHA-256), or None."""
    path = directory / info.path
    try:
        size = path.stat().st_size
        if size != info.bytes:
            return f"{size} bytes instead of {info.bytes}"
        return None if sha256_of(path) == info.sha256 else "SHA-256 differs"
    except FileNotFoundError:
        return "absent"
    except OSError as error:
        return f"cannot be read ({error.strerror})"


def _shard(item: dict[str, Any]) -> ShardInfo:
    return ShardInfo(**{**item, "failed": tuple(item.get("failed", ()))})
