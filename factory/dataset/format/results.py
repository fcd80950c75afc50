"""What became of a shard, in a file beside it: train/shard-00000.json while a run goes on."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from ...files import explain_os_errors, remove_file, write_atomically
from ...small_files import parse_json, read_regular
from .schema import SCHEMA, SPLITS
from .shard_info import ShardInfo, shard_info

_NAME = re.compile(r"shard-\d{5,}\.json")
FAILURE_KEYS = ("frame", "shard", "kind", "reason", "command")


@dataclass(frozen=True)
class ShardOutcome:
    """The outcome of one shard.

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
    for path in _files(directory):
        try:
            document = parse_json(read_regular(path))
            if document["schema"] != SCHEMA:
                continue
            info = document["shard"] and shard_info(document["shard"])
            failures = [
                {key: str(item[key]) for key in FAILURE_KEYS} for item in document["failures"]
            ]
            hash_, name = str(document["config_hash"]), str(document["path"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if name == f"{path.parent.name}/{path.stem}.h5" and config_hash in (None, hash_):
            found[name] = ShardOutcome(name, hash_, info or None, failures)
    return found


def forget_outcomes(directory: Path) -> None:
    """Remove them all: manifest.json and failed.jsonl hold them."""
    for path in _files(directory):
        with explain_os_errors(path):
            remove_file(path)


def _files(directory: Path) -> list[Path]:
    return [
        path
        for split in SPLITS
        for path in sorted((directory / split).glob("shard-*.json"))
        if _NAME.fullmatch(path.name)
    ]
