"""failed.jsonl: every frame that is not in the dataset, why, and how to try it again."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...errors import FactoryError
from ...files import explain_os_errors, put_out, write_atomically
from ...frame import FrameRef
from ...ownership import check_fences
from ...small_files import one_line, parse_json, read_regular
from ..format.manifest import part_name

FAILURES_NAME = "failed.jsonl"
_MOST_BYTES = 1 << 27
_KEYS = ("frame", "shard", "kind", "reason", "command")

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
    directory: Path,
    failures: Iterable[Failure],
    rerun_command: Callable[[FrameRef], str],
    part: str = "",
) -> None:
    """Write failed.jsonl, one JSON object a line in the order of shards and frames.

    part: slice of the dataset that the failures are of; it has a file of its own.

    `rerun_command(ref)` is the command line that tries that one frame again.
    """
    found = sorted(failures, key=lambda item: (item.shard, item.ref.name))
    path = directory / part_name(FAILURES_NAME, part)
    write_atomically(path, _lines(found, rerun_command))


def add_failures(
    directory: Path,
    failures: Iterable[Failure],
    rerun_command: Callable[[FrameRef], str],
    part: str = "",
) -> None:
    """Add lines to failed.jsonl while a run goes on; `save_failures` puts all in order at its end.

    On the disk when this returns, and passed on.  A run that is killed meanwhile may leave half a
    last line, of a shard that is not settled yet: `load_failures` passes it over.
    Raises FactoryError when it cannot be written, or another run has taken over the folder.
    """
    path = directory / part_name(FAILURES_NAME, part)
    check_fences(path)
    with explain_os_errors(path), path.open("ab") as file:
        file.write(_lines(failures, rerun_command))
        file.flush()
        os.fsync(file.fileno())
    put_out(path)


def _lines(failures: Iterable[Failure], rerun_command: Callable[[FrameRef], str]) -> bytes:
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
        for failure in failures
    ]
    return "".join(f"{line}\n" for line in lines).encode()


def load_failures(directory: Path) -> list[dict[str, str]]:
    """The lines of failed.jsonl (and of those of slices): frame, shard, kind, reason, command.

    A last line without an end was being written when its run was killed: it is passed over.
    Raises FactoryError when one is damaged.
    """
    items: list[dict[str, str]] = []
    for path in sorted(
        {*directory.glob(FAILURES_NAME), *directory.glob(part_name(FAILURES_NAME, "*-of-*"))}
    ):
        try:
            lines = read_regular(path, _MOST_BYTES).decode().split("\n")[:-1]
        except (OSError, ValueError) as error:
            raise FactoryError(
                f"{path}: cannot be read ({one_line(error)}); run the dataset's command again, it "
                "is written anew"
            ) from error
        for number, line in enumerate(lines, start=1):
            try:
                item = parse_json(line)
                items.append({key: str(item[key]) for key in _KEYS})
            except (ValueError, KeyError, TypeError) as error:
                raise FactoryError(
                    f"{path}:{number}: damaged; run the dataset's command again, it is written anew"
                ) from error
    return items
