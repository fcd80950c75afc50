"""failed.jsonl: every frame that is not in the dataset, why, and how to try it again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from factory.frame import FrameRef
from factory.shards.files import write_atomically

FAILURES_NAME = "failed.jsonl"

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
    lines = [
        json.dumps(
            {
                "frame": failure.ref.name,
                "shard": failure.shard,
                "kind": failure.kind,
                "reason": failure.reason,
                "command": rerun_command(failure.ref),
            }
        )
        for failure in sorted(failures, key=lambda item: (item.shard, item.ref.name))
    ]
    write_atomically(directory / FAILURES_NAME, "".join(f"{line}\n" for line in lines).encode())
