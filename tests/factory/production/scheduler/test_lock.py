"""One run at a time in a folder, and what outlived its run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.production.scheduler.lock import LOCK_NAME, locked, owner_of
from tests.factory.production.scheduler.run_files import wait_for
from tests.run_fake import make

HOLD = """
import sys
from pathlib import Path
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.production.scheduler.lock import locked
try:
    with locked(Path(sys.argv[1]), sys.argv[2]):
        print("held", flush=True)
        sys.stdin.read()
except FactoryError:
    pass
"""


def holding(folder: Path, part: str = "", wait: bool = False) -> subprocess.Popen[str]:
    """A process that holds the lock, if it gets it, until its input ends."""
    command = [sys.executable, "-c", HOLD, str(folder), part]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert not wait or process.stdout.readline() == "held\n"
    return process


def test_a_second_run_is_refused_and_a_dead_owner_holds_nothing(tmp_path: Path) -> None:
    owner = holding(tmp_path, wait=True)
    assert (owner_of(tmp_path) or {})["pid"] == owner.pid
    with pytest.raises(FactoryError, match=f"process {owner.pid}") as caught:
        make(tmp_path, scheduler={"backend": "serial"})
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == [LOCK_NAME], "the refused run touched the folder"
    owner.kill()
    owner.wait()
    assert owner_of(tmp_path) is None
    with locked(tmp_path):
        assert json.loads((tmp_path / LOCK_NAME).read_text())["pid"] == os.getpid()
    assert not os.listdir(tmp_path)


def test_slices_run_side_by_side_and_not_beside_the_whole(tmp_path: Path) -> None:
    owner = holding(tmp_path, "0-of-2", wait=True)
    try:
        with locked(tmp_path, "1-of-2"):
            pass
        for part in ("", "0-of-2"):
            with pytest.raises(FactoryError, match=str(owner.pid)), locked(tmp_path, part):
                pass
    finally:
        owner.kill()
        owner.wait()


def test_of_many_that_come_at_once_one_gets_the_lock(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_text("{}")  # of somebody dead
    crowd = [holding(tmp_path) for _ in range(4)]
    wait_for(lambda: sum(process.poll() is not None for process in crowd) == 3)
    message = [process.communicate()[0] for process in crowd]
    assert message.count("held\n") == 1
    wait_for(lambda: not os.listdir(tmp_path))


@pytest.mark.parametrize("content", [b"", b"[]", b'{"pid": "1"}', b"{half a lo", b"[" * 9])
def test_a_file_that_no_process_holds_is_no_lock(tmp_path: Path, content: bytes) -> None:
    (tmp_path / LOCK_NAME).write_bytes(content)
    with locked(tmp_path):
        pass
    assert not os.listdir(tmp_path)
