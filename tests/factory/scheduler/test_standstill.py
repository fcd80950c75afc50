"""A worker that was stopped is found in the time of a frame."""

from __future__ import annotations

import time
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from simnfnd.factory.scheduler import standstill
from simnfnd.factory.scheduler.settings import SchedulerSettings
from simnfnd.factory.scheduler.standstill import Standstill
from tests.fake_source import FakeConfig
from tests.run_fake import make


def test_a_stopped_worker_costs_its_frame_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(standstill._GRACE_S, "local", 0.5)
    begun = time.monotonic()
    config = FakeConfig(stops=("reef/alpha/0002",))
    report = make(tmp_path, config, workers=2, retries=0, frame_timeout_s=2.0)
    assert time.monotonic() - begun < 40, "it used to take (frames + 2) times as long and a minute"
    assert (report.samples, len(report.failures)) == (30, 1)
    (failure,) = report.failures
    assert (failure.ref.name, failure.kind) == ("reef/alpha/0002", "timeout")
    assert "frame_timeout_s=2" in failure.reason


@pytest.mark.parametrize(
    ("backend", "text", "found_s"),
    [("local", "start 3\n", 15.0), ("local", "start 3\ndone 3 2\n", 75.0), ("local", None, 75.0),
     ("dask", "start 3\n", 65.0)],
)  # fmt: skip
def test_how_long_nothing_may_happen(
    tmp_path: Path, backend: Any, text: str | None, found_s: float
) -> None:
    watch = Standstill(SchedulerSettings(backend=backend, frame_timeout_s=5.0))
    journal, future = tmp_path / "journal", Future[Any]()
    running = {future: (None, journal)}
    assert list(watch.among(running, 0.0)) == []
    assert list(watch.among(running, found_s)) == []
    if text is not None:
        journal.write_text(text)
        assert list(watch.among(running, found_s)) == [], "it gained something"
        assert list(watch.among(running, 2 * found_s)) == []
    after = 2 * found_s if text is not None else found_s
    assert list(watch.among(running, after + 0.1)) == [future]
    assert list(watch.among(running, after + 9.9)) == []
    assert list(watch.among(running, after + 30.2)) == [future], "it did not end"
    assert list(watch.among({}, after)) == []
