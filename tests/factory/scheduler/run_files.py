"""What a run leaves on disk, and waiting for it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path


def shard_bytes(directory: Path) -> dict[str, bytes]:
    """Path below the dataset -> content, of every shard."""
    paths = sorted(directory.glob("*/*.h5"))
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in paths}


def failures(directory: Path) -> dict[str, dict[str, str]]:
    """Frame name -> its line of failed.jsonl."""
    lines = (directory / "failed.jsonl").read_text().splitlines()
    return {item["frame"]: item for item in map(json.loads, lines)}


def litter(directory: Path) -> list[str]:
    """Files that a run must not leave behind."""
    return [path.name for path in directory.rglob(".*")]


def wait_for(condition: Callable[[], object], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.02)
