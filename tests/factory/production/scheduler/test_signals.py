"""Runs that are interrupted or killed: no process is left behind and nothing is lost."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from simnfnd.factory.common.command_line import guard
from simnfnd.factory.common.files import space
from simnfnd.factory.dataset.manifest import load_failures, load_manifest
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.production.scheduler import run
from tests.factory.production.scheduler.run_files import litter, shard_bytes, staged, wait_for
from tests.fake_source import FakeConfig
from tests.project_files import ROOT
from tests.run_fake import make
from tests.worker_processes import workers_of


def start(*words: object) -> subprocess.Popen[bytes]:
    """A run in a session of its own, as a terminal would give it."""
    command = [sys.executable, *map(str, words)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, cwd=ROOT, start_new_session=True, stdout=pipe, stderr=pipe)


def finished(directory: Path) -> int:
    """Shards that are on record."""
    manifest = load_manifest(directory)
    return len(manifest.shards) if manifest else 0


def session_members(session: int) -> list[int]:
    """Processes of a session that are alive."""
    members = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE:
                members.append(process.pid)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
    return members


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "exit_code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)],
    ids=["ctrl-c", "term", "kill"],
)
def test_signals_stop_quickly_leave_no_process_and_lose_nothing(
    tmp_path: Path, undisturbed: dict[str, bytes], number: int, exit_code: int
) -> None:
    directory = tmp_path / "dataset"
    process = start("-m", "tests.run_fake", directory, 2, 0.1)
    wait_for(lambda: finished(directory))
    start_s = time.monotonic()
    # Ctrl-C reaches every process of the terminal's group, kill only the one.
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - start_s < 5
    assert process.returncode == exit_code
    assert b"Traceback" not in errors
    wait_for(lambda: not session_members(process.pid), 5)
    if number == signal.SIGKILL:
        name = f".shard-00000.h5.here-{space()}-{process.pid}-{16 * '0'}.tmp"
        (directory / "train" / name).write_bytes(b"half")
    else:
        assert litter(directory) == []
    remaining = finished(directory)
    assert 1 <= remaining < 4
    assert make(directory).reused_shards == remaining
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed


NEVER_ENDING_STOP = """
import sys, time
from simnfnd.factory.common.workers.local import LocalBackend
from pathlib import Path
from tests.fake_source import FakeConfig
from tests.run_fake import make
def close(self):
    Path(sys.argv[1] + ".stopping").touch()
    time.sleep(60)
LocalBackend.close = close
make(Path(sys.argv[1]), FakeConfig(delay_s=0.1))
"""


@pytest.mark.slow
def test_a_second_signal_kills_at_once(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    directory = tmp_path / "dataset"
    process = start("-c", NEVER_ENDING_STOP, directory)
    wait_for(lambda: finished(directory))
    os.kill(process.pid, signal.SIGINT)
    wait_for((tmp_path / "dataset.stopping").exists)
    time.sleep(0.4)  # what comes sooner is the same keypress
    assert process.poll() is None
    start_s = time.monotonic()
    os.kill(process.pid, signal.SIGTERM)
    assert process.wait(20) == 143
    assert time.monotonic() - start_s < 2
    wait_for(lambda: not session_members(process.pid), 10)
    make(directory)
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed


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


AT_THE_END: dict[str, Any] = {
    "scheduler": {"backend": "serial"},
    "dataset": DatasetSettings(preview_pairs=1),
}


def everything(folder: Path) -> dict[str, bytes]:
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    actual = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
    del actual["status.json"]  # has the time in it
    return actual


@pytest.fixture(scope="module")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("undisturbed") / "dataset"
    make(folder, **AT_THE_END)
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
    whole_run: dict[str, bytes],
    place: str,
    number: int,
    way: Callable[[int], None],
) -> None:
    folder = tmp_path / "dataset"
    write = getattr(run, place)

    def interrupted(*arguments: Any, **named: Any) -> None:
        way(number)
        write(*arguments, **named)
        time.sleep(30)

    with monkeypatch.context() as patch:
        patch.setattr(run, place, interrupted)
        begun = time.monotonic()
        assert guard(lambda: make(folder, **AT_THE_END)) == 128 + number
        assert time.monotonic() - begun < 20
    said = capfd.readouterr().err
    assert "Traceback" not in said
    assert said.splitlines()[-1].startswith("error: interrupted")
    assert said.count("interrupted") == 1
    assert not [path for path in folder.rglob(".*") if path.name != ".lock"]
    shards = {name for name in whole_run if name.endswith(".h5") and "/" in name}
    assert {name: everything(folder)[name] for name in shards} == {
        name: whole_run[name] for name in shards
    }
    assert make(folder, **AT_THE_END).reused_shards == len(shards)
    assert everything(folder) == whole_run


KILLS = "reef/alpha/0004"
HANGS = "reef/alpha/0009"
WORKER_KILLS = 4
MOST_RUNS = 12

STORM = f"""
import sys
from pathlib import Path
from tests.factory.production.scheduler.run_files import staged
from tests.fake_source import FakeConfig
config = FakeConfig(kills=({KILLS!r},), hangs=({HANGS!r},), delay_s=0.1)
how = dict(scheduler=dict(render_workers=3), workers=5, retries=2, frame_timeout_s=1.5)
staged(Path(sys.argv[1]), config, **how)
"""


@pytest.mark.slow
def test_killing_workers_and_the_run_costs_the_bad_frames_alone(tmp_path: Path) -> None:
    calm = tmp_path / "calm" / "dataset"
    directory = tmp_path / "storm" / "dataset"
    staged(calm, FakeConfig(bad=(KILLS, HANGS)), scheduler={"backend": "serial"})
    directory.parent.mkdir()
    chance = random.Random(0)
    kills = 0
    run_killed = False
    missing = {"not begun"}
    for _ in range(MOST_RUNS):
        command = [sys.executable, "-c", STORM, str(directory)]
        run = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL, start_new_session=True)
        while run.poll() is None:
            time.sleep(chance.uniform(0.2, 0.7))
            workers = workers_of(run.pid)
            if kills < WORKER_KILLS and workers and run.poll() is None:
                chance.choice(workers).kill()
                kills += 1
            if kills > WORKER_KILLS // 2 and not run_killed:
                run.kill()
                run_killed = True
        run.wait()
        missing = {item["frame"] for item in load_failures(directory)}
        if run.returncode == 0 and missing == {KILLS, HANGS}:
            break
    assert missing == {KILLS, HANGS}
    assert (kills, run_killed) == (WORKER_KILLS, True)
    assert shard_bytes(directory) == shard_bytes(calm)
