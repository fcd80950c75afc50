"""A signal while all that stands beside the shards is written: one line, and nothing is lost."""

from __future__ import annotations

import os
import signal
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from simnfnd.factory.cli import guard
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.scheduler import run
from simnfnd.factory.scheduler.workers.signals import Interrupted, stop_signals
from tests.run_fake import make


class Held:
    """What a weak reference may point to."""


def at_once(number: int) -> None:
    os.kill(os.getpid(), number)


def where_python_throws_it_away(number: int) -> None:
    """As in h5py, whose every open object has a weak reference with a callback."""
    held = Held()
    reference = weakref.ref(held, lambda _: at_once(number))
    del held
    assert reference() is None


SERIAL: dict[str, Any] = {
    "scheduler": {"backend": "serial"},
    "dataset": DatasetSettings(preview_pairs=1),
}


def everything(folder: Path) -> dict[str, bytes]:
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    found = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
    del found["status.json"]  # has the time in it
    return found


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("undisturbed") / "dataset"
    make(folder, **SERIAL)
    return everything(folder)


@pytest.mark.parametrize(
    ("place", "number", "way"),
    [
        ("write_index", signal.SIGTERM, at_once),
        ("write_card", signal.SIGINT, where_python_throws_it_away),
    ],
)
def test_a_signal_at_the_end_of_a_run_is_one_line_and_loses_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    undisturbed: dict[str, bytes],
    place: str,
    number: int,
    way: Callable[[int], None],
) -> None:
    folder = tmp_path / "dataset"
    write = getattr(run, place)

    def interrupted(*given: Any, **named: Any) -> None:
        way(number)
        write(*given, **named)
        time.sleep(30)

    with monkeypatch.context() as patch:
        patch.setattr(run, place, interrupted)
        begun = time.monotonic()
        assert guard(lambda: make(folder, **SERIAL)) == 128 + number
        assert time.monotonic() - begun < 20
    said = capfd.readouterr().err
    assert "Traceback" not in said
    assert said.splitlines()[-1].startswith("error: interrupted; what was finished is kept")
    assert said.count("interrupted") == 1
    assert not [path for path in folder.rglob(".*") if path.name != ".lock"]
    shards = {name for name in undisturbed if name.endswith(".h5") and "/" in name}
    assert {name: everything(folder)[name] for name in shards} == {
        name: undisturbed[name] for name in shards
    }
    assert make(folder, **SERIAL).kept == len(shards)
    assert everything(folder) == undisturbed


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_python_threw_away_is_not_lost(
    capfd: pytest.CaptureFixture[str], number: int
) -> None:
    def stopped(wait_s: float) -> None:
        with stop_signals():
            where_python_throws_it_away(number)
            time.sleep(wait_s)

    before = signal.getsignal(number)
    # The second block ends before the signal can come again.
    for wait_s in (30.0, 0.0):
        begun = time.monotonic()
        with pytest.raises(Interrupted) as caught:
            stopped(wait_s)
        assert caught.value.exit_code == 128 + number
        assert time.monotonic() - begun < 20
    assert "Traceback" not in capfd.readouterr().err
    assert signal.getsignal(number) == before
    time.sleep(0.1)  # nothing comes later
