"""manifest.json and failed.jsonl: which shards and frames make up the dataset, and which do not.

While a run goes on, what became of a shard lies in a file beside it: train/shard-00000.json.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from ..errors import FactoryError
from ..files import explain_os_errors, remove_file, sha256_of, write_atomically
from ..frame import FrameRef
from ..small_files import one_line, parse_json, read_regular
from ..storage.copies import fetched
from .schema import SCHEMA, SPLITS, config_hash

MANIFEST_NAME = "manifest.json"
# All shards as one file, by virtual datasets.
INDEX_NAME = "index.h5"
FAILURES_NAME = "failed.jsonl"
# Every setting of the run.
CONFIG_NAME = "config.yaml"
# Keys of a configuration under which those of earlier datasets are kept.
PARTS = ("merged", "extends")
FAILURE_KEYS = ("frame", "shard", "kind", "reason", "command")

# A shard takes some 400 bytes.
MAX_SHARDS = 200_000
_MAX_BYTES = 1 << 27
_PATH = re.compile(rf"({'|'.join(SPLITS)})/[A-Za-z0-9_-]+\.h5")
_OUTCOME = re.compile(r"shard-\d{5,}\.json")


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

    @classmethod
    def of(cls, item: Mapping[str, Any]) -> ShardInfo:
        """The shard that plain values describe.  Raises ValueError, KeyError or TypeError."""
        return cls(**{**item, "failed": tuple(item.get("failed", ()))})


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

    def of_split(self, split: str) -> list[ShardInfo]:
        """The shards of a split, in the order of their paths."""
        return [shard for _, shard in sorted(self.shards.items()) if shard.split == split]

    def samples(self, split: str | None = None) -> int:
        """Number of samples, in all or of one split."""
        return sum(s.samples for s in self.shards.values() if split in (None, s.split))

    @property
    def config_hashes(self) -> frozenset[str]:
        """Hashes that its shards may state: its own, or those of datasets that went into it."""
        found, waiting = {self.config_hash}, [self.config]
        for listed in (config.get(key) for config in waiting for key in PARTS):
            several = listed if isinstance(listed, list) else []
            parts = [part for part in several if isinstance(part, dict)]
            found |= {str(part.get("config_hash")) for part in parts}
            waiting += parts  # which the loop then comes to
        return frozenset(found)

    def total_bytes(self) -> int:
        """Size of all shards together."""
        return sum(s.bytes for s in self.shards.values())


def save_manifest(directory: Path, manifest: Manifest) -> None:
    """Write manifest.json atomically; equal manifests give equal bytes."""
    shards = [manifest.shards[path] for path in sorted(manifest.shards)]
    totals = {
        split: {
            "samples": manifest.samples(split),
            "shards": len(manifest.of_split(split)),
            "bytes": sum(s.bytes for s in manifest.of_split(split)),
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

    What runs have settled since is included.  Raises FactoryError when it is damaged.
    """
    path = directory / MANIFEST_NAME
    try:
        document = parse_json(read_regular(path, _MAX_BYTES))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema is {document['schema']!r}, expected {SCHEMA!r}")
        shards = [ShardInfo.of(item) for item in document["shards"]]
        found = {shard.path: shard for shard in shards}
        if len(found) != len(shards):
            raise ValueError("a shard is listed twice")
        hash_, generator = document["config_hash"], document["generator"]
        config, index = document["config"], document.get("index_sha256", "")
        if not all(isinstance(text, str) for text in (hash_, generator, index)):
            raise ValueError("config_hash, generator and index_sha256 must be text")
        if not isinstance(config, dict):
            raise ValueError("config must be an object")
        if config_hash(config) != hash_:
            raise ValueError(f"its config does not give its config_hash {hash_[:40]!r}")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FactoryError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        reason = one_line(error)
        raise FactoryError(
            f"{path}: damaged ({reason}); delete it and run again, the shards are then made anew"
        ) from error
    before = dict(found)
    for name, outcome in outcomes(directory, hash_).items():
        if outcome.info is None:
            found.pop(name, None)
        else:
            found[name] = outcome.info
    return Manifest(hash_, generator, config, found, index if found == before else "")


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


@dataclass(frozen=True)
class ShardOutcome:
    """What became of one shard.

    config_hash: of the settings that it was made with.
    info: the finished shard; None when no frame gave a sample.
    failures: a line of failed.jsonl for each frame that gave none.
    """

    path: str
    config_hash: str
    info: ShardInfo | None
    failures: Sequence[Mapping[str, str]]


def save_outcome(directory: Path, outcome: ShardOutcome) -> None:
    """Write it beside its shard, atomically.  Raises FactoryError when that is impossible."""
    document = {
        "schema": SCHEMA,
        "config_hash": outcome.config_hash,
        "path": outcome.path,
        "shard": asdict(outcome.info) if outcome.info else None,
        "failures": list(outcome.failures),
    }
    path = (directory / outcome.path).with_suffix(".json")
    with explain_os_errors(path):
        path.parent.mkdir(exist_ok=True)
    write_atomically(path, json.dumps(document).encode())


def outcomes(directory: Path, config_hash: str | None = None) -> dict[str, ShardOutcome]:
    """Path of the shard -> its outcome, of all that lie in a dataset.

    config_hash: of those that count; None: all.  A damaged one is passed over: its shard is made
    again.
    """
    found = {}
    for path in _outcome_files(directory):
        try:
            document = parse_json(read_regular(path))
            if document["schema"] != SCHEMA:
                continue
            info = ShardInfo.of(document["shard"]) if document["shard"] else None
            failures = [
                {key: str(item[key]) for key in FAILURE_KEYS} for item in document["failures"]
            ]
            hash_, name = str(document["config_hash"]), str(document["path"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if name == f"{path.parent.name}/{path.stem}.h5" and config_hash in (None, hash_):
            found[name] = ShardOutcome(name, hash_, info, failures)
    return found


def forget_outcomes(directory: Path) -> None:
    """Remove them all: manifest.json and failed.jsonl hold them."""
    for path in _outcome_files(directory):
        with explain_os_errors(path):
            remove_file(path)


def _outcome_files(directory: Path) -> list[Path]:
    return [
        path
        for split in SPLITS
        for path in sorted((directory / split).glob("shard-*.json"))
        if _OUTCOME.fullmatch(path.name)
    ]


FailureKind = Literal["frame", "error", "crash", "timeout"]


@dataclass(frozen=True)
class Failure:
    """One frame (all its planned variants) that gave no sample.

    kind: frame (its data is bad), error (a defect of the program), crash (its worker process
        died) or timeout.
    shard: the shard that it was planned for.
    """

    ref: FrameRef
    kind: FailureKind
    reason: str
    shard: str


def save_failures(
    directory: Path, failures: Iterable[Failure], rerun_command: Callable[[FrameRef], str]
) -> None:
    """Write failed.jsonl, one JSON object a line in the order of shards and frames.

    `rerun_command(ref)` is the command line that tries that one frame again.
    """
    found = sorted(failures, key=lambda item: (item.shard, item.ref.name))
    lines = [json.dumps(line) for line in failure_lines(found, rerun_command)]
    write_atomically(directory / FAILURES_NAME, "".join(f"{line}\n" for line in lines).encode())


def failure_lines(
    failures: Iterable[Failure], rerun_command: Callable[[FrameRef], str]
) -> list[dict[str, str]]:
    """What failed.jsonl and the results beside shards say of failures."""
    return [
        {
            "frame": failure.ref.name,
            "shard": failure.shard,
            "kind": failure.kind,
            "reason": failure.reason,
            "command": rerun_command(failure.ref),
        }
        for failure in failures
    ]


def load_failures(directory: Path) -> list[dict[str, str]]:
    """The lines of failed.jsonl, and what runs have settled since.

    A last line without an end, as earlier versions left it when they were killed, is passed over.
    Raises FactoryError when one is damaged.
    """
    path = directory / FAILURES_NAME
    try:
        content = read_regular(path, _MAX_BYTES) if path.exists() else b""
        read = [parse_json(line) for line in content.decode().split("\n")[:-1]]
        items = [{key: str(item[key]) for key in FAILURE_KEYS} for item in read]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FactoryError(
            f"{path}: cannot be read ({one_line(error)}); run the dataset's command again, it is "
            "written anew"
        ) from error
    settled = outcomes(directory)
    kept = [item for item in items if item["shard"] not in settled]
    return kept + [dict(line) for path in sorted(settled) for line in settled[path].failures]
