"""failed.jsonl: every frame that is not in the dataset, why, and how to try it again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...errors import FactoryError
from ...files import write_atomically
from ...frame import FrameRef
from ...small_files import one_line, parse_json, read_regular
from ..format.manifest import FAILURE_KEYS, outcomes

FAILURES_NAME = "failed.jsonl"
_MOST_BYTES = 1 << 27

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
    items: list[dict[str, str]] = []
    lines = []
    try:
        lines = read_regular(path, _MOST_BYTES).decode().split("\n")[:-1]
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        raise FactoryError(
            f"{path}: cannot be read ({one_line(error)}); run the dataset's command again, it is "
            "written anew"
        ) from error
    for number, line in enumerate(lines, start=1):
        try:
            item = parse_json(line)
            items.append({key: str(item[key]) for key in FAILURE_KEYS})
        except (ValueError, KeyError, TypeError) as error:
            raise FactoryError(
                f"{path}:{number}: damaged; run the dataset's command again, it is written anew"
            ) from error
    settled = outcomes(directory)
    kept = [item for item in items if item["shard"] not in settled]
    return kept + [dict(line) for path in sorted(settled) for line in settled[path].failures]
