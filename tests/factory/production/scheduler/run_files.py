"""Runs in two stages, what a run leaves on disk, and waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from simnfnd.factory.dataset.manifest import load_failures
from tests.fake_source import FakeConfig, FakePreparer, GentleSource
from tests.run_fake import make


def staged(directory: Path, config: FakeConfig = FakeConfig(), **changes: Any):  # noqa: B008
    """`make` with frames that are prepared by other workers, in a folder beside the dataset."""
    config = replace(config, prepared=config.prepared or str(directory.parent / "prepared"))
    return make(directory, config, source=GentleSource, preparer=FakePreparer, **changes)


def shard_bytes(directory: Path) -> dict[str, bytes]:
    """Path below the dataset -> content, of every shard."""
    paths = sorted(directory.glob("*/*.h5"))
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in paths}


def failures(directory: Path) -> dict[str, dict[str, str]]:
    """Frame name -> its line of failed.jsonl."""
    return {item["frame"]: item for item in load_failures(directory)}


def litter(directory: Path) -> list[str]:
    """Files that a run must not leave behind."""
    return [path.name for path in directory.rglob(".*")]


def wait_for(condition: Callable[[], object], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.02)
