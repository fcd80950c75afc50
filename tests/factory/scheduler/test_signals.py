"""Runs that are interrupted or killed: nobody is left behind and nothing is lost."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from simnfnd.factory.dataset.manifest import load_manifest
from tests.factory.scheduler.run_files import litter, shard_bytes, wait_for
from tests.project_files import ROOT
from tests.run_fake import make


def start(directory: Path, workers: int, delay_s: float) -> subprocess.Popen[bytes]:
    """A run in a session of its own, as a terminal would give it."""
    command = [sys.executable, "-m", "tests.run_fake", str(directory), str(workers), str(delay_s)]
    return subprocess.Popen(
        command, cwd=ROOT, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


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


@pytest.mark.parametrize(
    ("number", "exit_code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["ctrl-c", "term"]
)
def test_signals_stop_quickly_leave_nobody_and_lose_nothing(
    tmp_path: Path, undisturbed: dict[str, bytes], number: int, exit_code: int
) -> None:
    directory = tmp_path / "dataset"
    process = start(directory, 2, 0.1)
    wait_for(lambda: finished(directory))
    asked = time.monotonic()
    # Ctrl-C reaches every process of the terminal's group, kill only the one.
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - asked < 5
    assert process.returncode == exit_code
    assert b"Traceback" not in errors
    wait_for(lambda: not session_members(process.pid), 5)
    assert litter(directory) == []
    manifest = load_manifest(directory)
    assert manifest is not None
    assert 1 <= len(manifest.shards) < 4
    report = make(directory)
    assert report.kept == len(manifest.shards)
    assert shard_bytes(directory) == undisturbed


NEVER_ENDING_STOP = """
import sys, time
from simnfnd.factory.scheduler.workers.local import LocalBackend
from pathlib import Path
from tests.fake_source import FakeConfig
from tests.run_fake import make
def stop(self):
    Path(sys.argv[1] + ".stopping").touch()
    time.sleep(60)
LocalBackend.stop = stop
make(Path(sys.argv[1]), FakeConfig(delay_s=0.1))
"""


def test_a_second_signal_kills_at_once(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    directory = tmp_path / "dataset"
    process = subprocess.Popen(
        [sys.executable, "-c", NEVER_ENDING_STOP, str(directory)],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    wait_for(lambda: finished(directory))
    os.kill(process.pid, signal.SIGINT)
    wait_for((tmp_path / "dataset.stopping").exists)
    time.sleep(0.4)  # what comes sooner is the same keypress
    assert process.poll() is None
    asked = time.monotonic()
    os.kill(process.pid, signal.SIGTERM)
    assert process.wait(20) == 143
    assert time.monotonic() - asked < 2
    wait_for(lambda: not session_members(process.pid), 10)
    make(directory)
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed


def test_a_killed_parent_takes_its_workers_along_and_the_run_goes_on(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    process = start(directory, 3, 0.1)
    wait_for(lambda: finished(directory))
    process.kill()
    process.communicate(timeout=20)
    wait_for(lambda: not session_members(process.pid), 5)
    report = make(directory)
    assert report.kept >= 1
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed


def test_what_a_run_killed_after_its_last_shard_left_goes_away(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    make(directory, workers=1)
    half_written = (
        "import pathlib, sys; from simnfnd.factory import files; "
        "files._temporary_for(pathlib.Path(sys.argv[1])).write_bytes(b'half')"
    )
    target = directory / "train" / "shard-00000.h5"
    subprocess.run([sys.executable, "-c", half_written, str(target)], cwd=ROOT, check=True)
    (directory / ".work").mkdir()
    (directory / ".work" / "train-shard-00000.h5.1.journal").write_bytes(b"half")
    assert len(litter(directory)) >= 2
    report = make(directory, workers=1)
    assert report.kept == 4
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed
