"""Locks between containers and machines, under work that never pauses, and after a take-over."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import write_atomically
from simnfnd.factory.ownership import Fence, check_fences, fenced, myself
from simnfnd.factory.scheduler import lock as locks
from simnfnd.factory.scheduler import run
from simnfnd.factory.scheduler.lock import LOCK_NAME, Lock, owner_of
from tests.fake_source import FakeConfig, FakeSource
from tests.run_fake import make


def leave(folder: Path, **changes: Any) -> Path:
    """A lock of a live owner that differs from this process in some things."""
    path = folder / LOCK_NAME
    path.write_text(json.dumps({"token": "other", **myself(), **changes}))
    return path


def age(path: Path, seconds: float) -> None:
    when = time.time() - seconds
    os.utime(path, (when, when))


def test_a_container_with_our_host_name_and_number_keeps_its_lock(tmp_path: Path) -> None:
    """Process 1 of each, but of another space of numbers."""
    path = leave(tmp_path, space="0badcafe", started=1.0)
    for seconds in (0, 300, -300):
        age(path, seconds)
        with pytest.raises(FactoryError, match="is being written by process"), Lock(tmp_path):
            pass
    for seconds in (900, -900):
        age(path, seconds)
        assert owner_of(tmp_path) is None
    with Lock(tmp_path):
        pass


def test_a_start_is_told_by_ticks_and_not_by_a_clock(tmp_path: Path) -> None:
    age(leave(tmp_path), 9e9)
    assert owner_of(tmp_path) is not None, "it lives, however long ago it was touched"
    leave(tmp_path, started=myself()["started"] - 1)
    assert owner_of(tmp_path) is None


@pytest.mark.parametrize(
    "content", [b"", b"[]", b'{"pid": "1"}', b'{"host": 7, "pid": 1}', b"[" * 9]
)
def test_what_names_nobody_holds_nothing(tmp_path: Path, content: bytes) -> None:
    (tmp_path / LOCK_NAME).write_bytes(content)
    with Lock(tmp_path):
        pass
    assert not os.listdir(tmp_path)


def test_a_folder_in_place_of_the_lock_holds_nothing(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).mkdir()
    with Lock(tmp_path):
        pass


def test_the_heart_beats_while_the_owner_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(locks, "_BEAT_S", 0.02)
    with Lock(tmp_path) as lock:
        age(lock.path, 400)
        deadline = time.monotonic() + 5
        while time.time() - lock.path.stat().st_mtime > 300 and time.monotonic() < deadline:
            time.sleep(0.02)
        assert time.time() - lock.path.stat().st_mtime < 300
        leave(tmp_path)
        while not lock._lost and time.monotonic() < deadline:
            time.sleep(0.02)
        with pytest.raises(FactoryError, match="was taken by process"):
            lock.check()
    assert (tmp_path / LOCK_NAME).exists(), "the new owner's lock was removed"


def test_who_lost_the_folder_writes_nothing(tmp_path: Path) -> None:
    write_atomically(tmp_path / "a", b"before")
    with Lock(tmp_path):
        write_atomically(tmp_path / "a", b"mine")
        beside = tmp_path / "x" / ".." / "a"
        leave(tmp_path)
        with pytest.raises(FactoryError, match="nothing more is written"):
            write_atomically(tmp_path / "a", b"late")
        with pytest.raises(FactoryError, match="nothing more is written"):
            check_fences(beside)
        write_atomically(tmp_path.parent / "beside", b"elsewhere")
    assert (tmp_path / "a").read_bytes() == b"mine"
    assert sorted(os.listdir(tmp_path)) == [LOCK_NAME, "a"]
    write_atomically(tmp_path / "a", b"after")


def test_a_worker_asks_for_the_token_of_its_run(tmp_path: Path) -> None:
    fence = Fence(tmp_path / LOCK_NAME, "gone")
    with fenced(fence), pytest.raises(FactoryError, match="was taken away"):
        check_fences(tmp_path / "train" / "shard-00000.h5")
    check_fences(tmp_path / "train" / "shard-00000.h5")


class Stealing(FakeSource):
    """A source during which another run takes over; the folder is its configuration."""

    def __init__(self, config: Any) -> None:
        super().__init__(FakeConfig())
        self.folder = Path(config)

    def pairs(self, *words: Any) -> Any:
        leave(self.folder)
        return super().pairs(*words)


@pytest.mark.parametrize("after", ["shards", "description"])
def test_a_run_that_was_taken_over_ends_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    serial = {"backend": "serial"}
    if after == "description":
        describe: Callable[..., None] = run._describe

        def late(job: Any, report: Any) -> None:
            leave(tmp_path)
            describe(job, report)

        monkeypatch.setattr(run, "_describe", late)
        changes: dict[str, Any] = {}
    else:
        changes = {"source": Stealing, "config": str(tmp_path)}
    with pytest.raises(FactoryError, match="nothing more is written here"):
        make(tmp_path, scheduler=serial, **changes)
    manifest = load_manifest(tmp_path)
    assert manifest is not None
    assert bool(manifest.shards) == (after == "description")
    assert not list(tmp_path.glob("*/*.h5")) or after == "description"
    assert not (tmp_path / "index.h5").exists()
    assert owner_of(tmp_path) is not None
