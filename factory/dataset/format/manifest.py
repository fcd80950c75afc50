"""manifest.json: which shards make up the dataset, and how to tell that they are whole.

While a run goes on, manifest.jsonl beside it takes a line for every shard that is settled: to write
all of manifest.json again for each would take a time that grows with the square of their number.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ...errors import FactoryError
from ...files import (
    explain_os_errors,
    put_out,
    remove_file,
    sha256_of,
    write_atomically,
)
from ...ownership import check_fences
from ...small_files import one_line, parse_json, read_regular
from ...storage.copies import fetched
from .schema import SCHEMA, SPLITS

MANIFEST_NAME = "manifest.json"
# What was settled since manifest.json was written; gone when a run has ended.
ADDED_NAME = "manifest.jsonl"
# All shards as one file, by virtual datasets.
INDEX_NAME = "index.h5"
# Every setting of the run.
CONFIG_NAME = "config.yaml"
# Keys of a configuration under which those of earlier datasets are kept.
PARTS = ("merged", "extends")

# A shard takes some 400 bytes.
MAX_SHARDS = 200_000
_MAX_BYTES = 1 << 27
_PATH = re.compile(rf"({'|'.join(SPLITS)})/[A-Za-z0-9_-]+\.h5")


@dataclass(frozen=True)
class ShardInfo:
    """One finished shard.

    path: below the dataset's folder, with forward slashes.
    plan: digest of the frames and variants that the shard was meant to hold.
    failed: names of the planned frames that it lacks.
    config_hash: of the settings that it was made with; empty: those of the manifest.
    """

    path: str
    split: str
    samples: int
    bytes: int
    sha256: str
    plan: str = ""
    failed: tuple[str, ...] = ()
    config_hash: str = ""

    def __post_init__(self) -> None:
        counts = (self.samples, self.bytes)
        texts = (self.path, self.split, self.sha256, self.plan, self.config_hash, *self.failed)
        if not all(type(count) is int and count >= 0 for count in counts):
            raise ValueError(f"samples and bytes must be counts, got {counts}")
        # Every sample takes some bytes: no count may be what no file can hold.
        if self.samples > self.bytes:
            raise ValueError(f"{self.samples} samples in {self.bytes} bytes")
        if not all(isinstance(text, str) for text in texts):
            raise ValueError("path, split, sha256, plan, failed and config_hash must be text")
        # Nothing outside the dataset's folder may be named, whoever wrote the file.
        if not _PATH.fullmatch(self.path) or self.path.split("/")[0] != self.split:
            raise ValueError(f"{self.path!r} is no shard of split {self.split!r}")


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
        **({"index_sha256": manifest.index_sha256} if manifest.index_sha256 else {}),
        "shards": [asdict(shard) for shard in shards],
    }
    text = json.dumps(document, indent=1) + "\n"
    write_atomically(directory / part_name(MANIFEST_NAME, part), text.encode())
    # Should we die before this, its first line tells that it is of an older manifest.json.
    remove_file(directory / part_name(ADDED_NAME, part))


class Additions:
    """manifest.jsonl of a run: what it settled since it wrote manifest.json.

    Not forced onto the disk: what a power cut takes of it is made again.
    """

    def __init__(self, directory: Path, part: str = "") -> None:
        self._path = directory / part_name(ADDED_NAME, part)
        self._manifest = directory / part_name(MANIFEST_NAME, part)

    def note(self, path: str, info: ShardInfo | None) -> None:
        """Add that the shard at `path` is finished, or (None) that there is none."""
        check_fences(self._path)
        entry = {"path": path, "shard": asdict(info) if info else None}
        with explain_os_errors(self._path), self._path.open("ab") as file:
            if not file.tell():
                first = {"manifest": sha256_of(self._manifest)}
                file.write(json.dumps(first).encode() + b"\n")
            file.write(json.dumps(entry).encode() + b"\n")
        put_out(self._path)


def load_manifest(directory: Path, part: str = "") -> Manifest | None:
    """Read manifest.json (of a slice: `part`), or None when there is none.

    What a run has added since, or had when it was killed, is taken in.
    Raises FactoryError when it is damaged.
    """
    path = directory / part_name(MANIFEST_NAME, part)
    try:
        content = read_regular(path, _MAX_BYTES)
        document = parse_json(content)
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema is {document['schema']!r}, expected {SCHEMA!r}")
        shards = [_shard(item) for item in document["shards"]]
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
    _take_in(directory / part_name(ADDED_NAME, part), hashlib.sha256(content).hexdigest(), found)
    still = len(found) == len(shards) and all(found.get(one.path) == one for one in shards)
    return Manifest(hash_, generator, config, found, index if still else "")


def _take_in(added: Path, manifest_sha256: str, shards: dict[str, ShardInfo]) -> None:
    """Bring `shards` up to date; stops at the first line that a crash has spoilt."""
    try:
        first, *lines = read_regular(added, _MAX_BYTES).split(b"\n")[:-1] or [b""]
        if parse_json(first)["manifest"] != manifest_sha256:
            return
        for line in lines:
            entry = parse_json(line)
            info = _shard(entry["shard"]) if entry["shard"] else None
            if info is None:
                shards.pop(str(entry["path"]), None)
            else:
                shards[info.path] = info
    except (OSError, ValueError, KeyError, TypeError):
        return


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


def _shard(item: dict[str, Any]) -> ShardInfo:
    return ShardInfo(**{**item, "failed": tuple(item.get("failed", ()))})
