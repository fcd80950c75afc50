"""manifest.json and failed.jsonl: which shards and frames make up the dataset, and which do not.

While a run goes on, what became of a shard lies in a file beside it: train/shard-00000.json.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from ..common.errors import FactoryError
from ..common.files import (
    explain_os_errors,
    real_path,
    remove_file,
    sha256_of,
    write_atomically,
)
from ..common.small_files import one_line, parse_json, read_regular
from .frame_ref import FrameRef
from .schema import SCHEMA, SPLITS, config_hash
from .storage import fetched

MANIFEST_NAME = "manifest.json"
INDEX_NAME = "index.h5"
FAILURES_NAME = "failed.jsonl"
CONFIG_NAME = "config.yaml"
# Keys of a configuration under which those of earlier datasets are kept.
PARTS = ("merged", "extends")
FAILURE_KEYS = ("frame", "shard", "kind", "reason", "command")

_PATH = re.compile(rf"({'|'.join(SPLITS)})/[A-Za-z0-9_-]+\.h5")


@dataclass(frozen=True)
class ShardInfo:
    """One finished shard.

    path: below the dataset's folder, with forward slashes.
    plan: digest of the frames and variants that the shard was meant to hold.
    failed: names of the planned frames that it lacks.
    config_hash: of the settings that it was made with; empty: those of the manifest.
    inputs: hash of the files that its frames were read from; empty: of none.
    """

    path: str
    split: str
    samples: int
    bytes: int
    sha256: str
    plan: str = ""
    failed: tuple[str, ...] = ()
    config_hash: str = ""
    inputs: str = ""

    def __post_init__(self) -> None:
        texts = (self.path, self.split, self.sha256, self.plan, self.config_hash, self.inputs)
        if not all(isinstance(text, str) for text in (*texts, *self.failed)):
            raise ValueError(
                "path, split, sha256, plan, config_hash, inputs and failed must be text"
            )
        # Every sample takes some bytes: no count may be what no file can hold.
        counts = (self.samples, self.bytes)
        if not all(type(count) is int for count in counts) or not 0 <= self.samples <= self.bytes:
            raise ValueError(f"samples and bytes must be counts, got {counts}")
        # Nothing outside the dataset's folder may be named, whoever wrote the file.
        if not _PATH.fullmatch(self.path) or self.path.split("/")[0] != self.split:
            raise ValueError(f"{self.path!r} is no shard of split {self.split!r}")

    @classmethod
    def of(cls, item: Mapping[str, Any]) -> ShardInfo:
        """The shard that plain values describe.  Raises ValueError, KeyError or TypeError."""
        return cls(**{**item, "failed": tuple(item.get("failed", ()))})

    def plain(self) -> dict[str, Any]:
        """The entry as JSON holds it, without `inputs` where there are none."""
        values = asdict(self)
        return values if self.inputs else {k: v for k, v in values.items() if k != "inputs"}


@dataclass(frozen=True)
class Manifest:
    """All finished shards of a dataset, by path.

    config: what `config_hash` stands for.  index_sha256: of the index.h5 that shows these very
    shards; empty: there is none.
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
        hashes = {self.config_hash}
        waiting = [self.config]
        for listed in (config.get(key) for config in waiting for key in PARTS):
            several = listed if isinstance(listed, list) else []
            parts = [part for part in several if isinstance(part, dict)]
            hashes |= {str(part.get("config_hash")) for part in parts}
            waiting += parts  # which the loop then comes to
        return frozenset(hashes)

    def total_bytes(self) -> int:
        """Size of all shards together."""
        return sum(s.bytes for s in self.shards.values())


def save_manifest(directory: Path, manifest: Manifest) -> None:
    """Write manifest.json atomically; equal manifests give equal bytes."""
    document = {
        "schema": SCHEMA,
        "generator": manifest.generator,
        "config_hash": manifest.config_hash,
        "config": manifest.config,
        "totals": _totals(manifest.shards.values()),
        **({"index_sha256": manifest.index_sha256} if manifest.index_sha256 else {}),
        "shards": [manifest.shards[path].plain() for path in sorted(manifest.shards)],
    }
    text = json.dumps(document, indent=1) + "\n"
    write_atomically(directory / MANIFEST_NAME, text.encode())


def load_manifest(directory: Path) -> Manifest | None:
    """Read manifest.json, or None when there is none.

    What runs have settled since is included.  Raises FactoryError when it is damaged.
    """
    path = directory / MANIFEST_NAME
    try:
        document = parse_json(read_regular(path))
        if document["schema"] != SCHEMA:
            raise ValueError(f"schema is {document['schema']!r}, expected {SCHEMA!r}")
        shards = [ShardInfo.of(item) for item in document["shards"]]
        read = Manifest(
            document["config_hash"],
            document["generator"],
            document["config"],
            {shard.path: shard for shard in shards},
            document.get("index_sha256", ""),
        )
        if len(read.shards) != len(shards):
            raise ValueError("a shard is listed twice")
        texts = (read.config_hash, read.generator, read.index_sha256)
        if not all(isinstance(text, str) for text in texts) or not isinstance(read.config, dict):
            raise ValueError("config_hash, generator and index_sha256 are texts, config an object")
        if config_hash(read.config) != read.config_hash:
            raise ValueError(f"its config does not give its config_hash {read.config_hash[:40]!r}")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FactoryError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, KeyError, TypeError) as error:
        raise FactoryError(
            f"{path}: damaged ({one_line(error)}); delete it and run again, the shards are then "
            "made anew"
        ) from error
    current = dict(read.shards)
    for name, (info, _) in outcomes(directory, read.config_hash).items():
        current.pop(name, None)
        if info is not None:
            current[name] = info
    return read if current == read.shards else replace(read, shards=current, index_sha256="")


def _totals(shards: Iterable[ShardInfo]) -> dict[str, dict[str, int]]:
    """Samples, shards and bytes of each split."""
    totals = {split: {"samples": 0, "shards": 0, "bytes": 0} for split in SPLITS}
    for shard in shards:
        counts = totals[shard.split]
        counts["samples"] += shard.samples
        counts["shards"] += 1
        counts["bytes"] += shard.bytes
    return totals


def totals_problem(directory: Path) -> str | None:
    """What is wrong with `totals` of a manifest.json that `load_manifest` has read, or None."""
    document = parse_json(read_regular(directory / MANIFEST_NAME))
    counted = _totals(ShardInfo.of(item) for item in document["shards"])
    if document.get("totals") == counted:
        return None
    return f"its totals are not {counted}, those of the listed shards; make the dataset again"


def is_inside(root: Path, path: Path) -> bool:
    """Whether `path`, links followed, is a regular file below `root`."""
    return real_path(path).is_relative_to(real_path(root)) and os.path.isfile(path)


def damage(directory: Path, info: ShardInfo, *, whole: bool = True) -> str | None:
    """What is wrong with a finished shard on disk (absent, size, SHA-256), or None.

    whole: compare the SHA-256, too, for which all of the file is read.
    """
    path = directory / info.path
    fetched(path)
    try:
        size = path.stat().st_size
        if size != info.bytes:
            return f"{size} bytes, the manifest says {info.bytes}"
        return "SHA-256 differs" if whole and sha256_of(path) != info.sha256 else None
    except FileNotFoundError:
        return "listed in the manifest but absent"
    except OSError as error:
        return f"cannot be read ({error.strerror})"


Lines = list[dict[str, str]]
"""Lines of failed.jsonl, one for each frame that gave no sample."""


def save_outcome(
    directory: Path, shard: str, config_hash: str, info: ShardInfo | None, failures: Lines
) -> None:
    """Write what became of a shard beside it, atomically.

    shard: its path.  config_hash: of the settings that it was made with.
    info: the finished shard; None when no frame gave a sample.
    """
    document = {
        "schema": SCHEMA,
        "config_hash": config_hash,
        "path": shard,
        "shard": info.plain() if info else None,
        "failures": failures,
    }
    path = (directory / shard).with_suffix(".json")
    with explain_os_errors(path):
        path.parent.mkdir(exist_ok=True)
    write_atomically(path, json.dumps(document).encode())


def outcomes(
    directory: Path, config_hash: str | None = None
) -> dict[str, tuple[ShardInfo | None, Lines]]:
    """Path of the shard -> what `save_outcome` wrote, of all that lie in a dataset.

    config_hash: of those that count; None: all.  A damaged one is passed over: its shard is made
    again.
    """
    outcome_of_shard: dict[str, tuple[ShardInfo | None, Lines]] = {}
    for path in _outcome_files(directory):
        with suppress(OSError, ValueError, KeyError, TypeError):
            document = parse_json(read_regular(path))
            info = ShardInfo.of(document["shard"]) if document["shard"] else None
            failures = _lines(document["failures"])
            name = document["path"]
            known = document["schema"] == SCHEMA and name == f"{path.parent.name}/{path.stem}.h5"
            if known and config_hash in (None, document["config_hash"]):
                outcome_of_shard[name] = info, failures
    return outcome_of_shard


def forget_outcomes(directory: Path) -> None:
    """Remove them all: manifest.json and failed.jsonl hold them."""
    for path in _outcome_files(directory):
        with explain_os_errors(path):
            remove_file(path)


def _outcome_files(directory: Path) -> list[Path]:
    return [path for split in SPLITS for path in sorted(directory.glob(f"{split}/shard-*.json"))]


def _lines(items: Iterable[Any]) -> Lines:
    return [{key: str(item[key]) for key in FAILURE_KEYS} for item in items]


FailureKind = Literal["frame", "error", "crash", "timeout"]


@dataclass(frozen=True)
class Failure:
    """One frame (all its planned variants) that gave no sample.

    kind: frame (its data is bad), error (a defect of the program), crash (its worker process
        died) or timeout.  shard: that it was planned for.
    """

    ref: FrameRef
    kind: FailureKind
    reason: str
    shard: str


def failure_lines(failures: Iterable[Failure], rerun_command: Callable[[FrameRef], str]) -> Lines:
    """What failed.jsonl and the results beside shards say of failures.

    `rerun_command(ref)` is the command line that tries that one frame again.
    """
    rows = (
        (failure.ref.name, failure.shard, failure.kind, failure.reason, rerun_command(failure.ref))
        for failure in failures
    )
    return [dict(zip(FAILURE_KEYS, values, strict=True)) for values in rows]


def save_failures(directory: Path, lines: Lines) -> None:
    """Write failed.jsonl, one JSON object a line in the order of shards and frames."""
    sorted_lines = sorted(lines, key=lambda line: (line["shard"], line["frame"]))
    text = "".join(f"{json.dumps(line)}\n" for line in sorted_lines)
    write_atomically(directory / FAILURES_NAME, text.encode())


def load_failures(directory: Path) -> Lines:
    """The lines of failed.jsonl, and what runs have settled since.

    Raises FactoryError when one is damaged.
    """
    path = directory / FAILURES_NAME
    try:
        content = read_regular(path) if path.exists() else b""
        items = _lines(parse_json(line) for line in content.decode().split("\n")[:-1])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FactoryError(
            f"{path}: cannot be read ({one_line(error)}); run the dataset's command again, it is "
            "written anew"
        ) from error
    settled = outcomes(directory)
    unsettled = [item for item in items if item["shard"] not in settled]
    return unsettled + [line for _, (_, lines) in sorted(settled.items()) for line in lines]
