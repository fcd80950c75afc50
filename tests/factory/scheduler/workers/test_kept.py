"""Workers that serve one point of a sweep after the other."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.scheduler.workers.kept import keep_workers, release_workers
from tests.fake_source import BrokenSource, FakeConfig
from tests.run_fake import make
from tests.worker_processes import workers_of


def workers() -> set[int]:
    """Process numbers of the workers that live."""
    return {child.pid for child in workers_of(os.getpid())}


def contents(directory: Path) -> dict[str, bytes]:
    """Path below the dataset -> content, of every shard."""
    return {
        str(path.relative_to(directory)): path.read_bytes() for path in directory.glob("*/*.h5")
    }


@pytest.fixture(autouse=True)
def nothing_kept() -> Iterator[None]:
    """Neither before nor after a test."""
    release_workers()
    yield
    release_workers()
    assert workers() == set()


def test_the_next_run_has_the_same_workers_and_makes_the_same_bytes(tmp_path: Path) -> None:
    other = FakeConfig(delay_s=0.001)
    make(tmp_path / "alone", other)
    assert workers() == set()
    keep_workers()
    make(tmp_path / "first")
    first = workers()
    assert len(first) == 2
    make(tmp_path / "second", other)
    assert workers() == first
    assert contents(tmp_path / "second") == contents(tmp_path / "alone")


def test_another_crew_replaces_them(tmp_path: Path) -> None:
    keep_workers()
    make(tmp_path / "two")
    first = workers()
    make(tmp_path / "one", workers=1)
    assert len(workers()) == 1
    assert not workers() & first


def test_a_kept_worker_that_died_is_replaced(tmp_path: Path) -> None:
    keep_workers()
    make(tmp_path / "first")
    for number in workers():
        os.kill(number, signal.SIGKILL)
    report = make(tmp_path / "second")
    assert (report.samples, report.failures) == (32, ())


def test_none_are_kept_after_a_run_that_broke(tmp_path: Path) -> None:
    keep_workers()
    with pytest.raises(FactoryError):
        make(tmp_path / "broken", source=BrokenSource)
    assert workers() == set()
