"""Two kinds of workers, backends, slices, the lock: whatever happens, the same bytes come out."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.ownership import myself
from simnfnd.factory.scheduler.lock import LOCK_NAME, Lock, owner_of
from simnfnd.factory.scheduler.pending import PendingFrame, backoff_s
from simnfnd.factory.scheduler.settings import ShardSlice
from simnfnd.factory.settings import build
from tests.factory.scheduler.run_files import failures, litter, shard_bytes, wait_for
from tests.factory.scheduler.staged import staged
from tests.fake_source import FakeConfig, GentleSource, prepared_file, refs
from tests.run_fake import make

SERIAL = {"backend": "serial"}


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The shards as one process makes them in one stage."""
    directory = tmp_path_factory.mktemp("expected") / "dataset"
    make(directory, scheduler=SERIAL)
    return shard_bytes(directory)


def status(directory: Path) -> dict[str, object]:
    told: dict[str, object] = json.loads((directory / "status.json").read_text())
    return told


@pytest.mark.parametrize("backend", ["serial", "local", "dask"])
def test_frames_that_are_prepared_by_others_give_the_same_bytes(
    tmp_path: Path, expected: dict[str, bytes], backend: str
) -> None:
    directory = tmp_path / "dataset"
    report = staged(directory, scheduler={"backend": backend, "render_workers": 1}, workers=3)
    assert (report.samples, report.failures) == (32, ())
    assert shard_bytes(directory) == expected
    assert litter(directory) == []
    told = status(directory)
    assert told["state"] == "finished"
    assert told["frames"] == {"total": 16, "rendered": 16, "from_cache": 0, "failed": 0}
    assert told["workers"] == {"render": 1, "noise": 2}
    if backend != "serial":
        makers = {file.read_text() for file in (tmp_path / "prepared").iterdir()}
        assert len(makers) == 1, "somebody else than the render worker prepared a frame"


def test_a_second_dataset_of_the_same_frames_prepares_none(tmp_path: Path) -> None:
    staged(tmp_path / "one", scheduler=SERIAL)
    staged(tmp_path / "two", scheduler=SERIAL)
    assert status(tmp_path / "two")["frames"] == {
        "total": 16,
        "rendered": 0,
        "from_cache": 16,
        "failed": 0,
    }


@pytest.mark.parametrize("backend", ["local", "dask"])
def test_a_frame_that_cannot_be_prepared_costs_itself_alone(tmp_path: Path, backend: str) -> None:
    directory = tmp_path / "dataset"
    config = FakeConfig(
        bad=("reef/alpha/0000",),
        buggy=("reef/alpha/0001",),
        kills=("reef/alpha/0006",),
        hangs=("reef/alpha/0010",),
        killed_once=("reef/beta/0003",),
        marks=str(tmp_path),
    )
    report = staged(directory, config, scheduler={"backend": backend}, frame_timeout_s=2.0)
    told = failures(directory)
    assert {name: item["kind"] for name, item in told.items()} == {
        "reef/alpha/0000": "frame",
        "reef/alpha/0001": "error",
        "reef/alpha/0006": "crash",
        "reef/alpha/0010": "timeout",
    }
    assert told["reef/alpha/0010"]["shard"] == "train/shard-00002.h5"
    assert "in each of 2 tries" in told["reef/alpha/0006"]["reason"]
    assert "FakePreparer" not in told["reef/alpha/0001"]["reason"]
    assert report.samples == 32 - 4 * 2
    log = (directory / "logs/train-shard-00002.log").read_text()
    # On Dask it may first have waited behind a frame that kills, which is no try of its own.
    assert re.search(r"preparing reef/alpha/0010, try \d: took longer", log)
    assert "in prepare" in log, "the traceback of a frame that hangs"
    assert "settled: 6 samples" in log

    # Running again tries what failed, touches nothing else, and takes in what is cured.
    before = {path: (directory / path).stat().st_mtime_ns for path in shard_bytes(directory)}
    again = staged(directory, replace(config, hangs=()), frame_timeout_s=2.0)
    assert {f.ref.name for f in again.failures} == set(told) - {"reef/alpha/0010"}
    assert again.kept == 3
    after = {path: (directory / path).stat().st_mtime_ns for path in shard_bytes(directory)}
    assert [path for path in before if before[path] != after[path]] == ["train/shard-00002.h5"]


def test_a_prepared_frame_that_vanishes_is_prepared_again(
    tmp_path: Path, expected: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    ref = refs(12)[5]
    lost: list[int] = []

    def forgetful(self: GentleSource, asked: object, variants: object, pairs=GentleSource.pairs):
        if asked == ref and not lost:
            lost.append(1)
            prepared_file(self.config, ref).unlink()
        return pairs(self, asked, variants)

    monkeypatch.setattr(GentleSource, "pairs", forgetful)
    staged(tmp_path / "dataset", scheduler=SERIAL)
    assert lost
    assert shard_bytes(tmp_path / "dataset") == expected
    assert status(tmp_path / "dataset")["frames"]["rendered"] == 17  # type: ignore[index]


def test_frames_that_never_stay_end_the_run_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GentleSource, "ready", lambda self, ref: False)
    with pytest.raises(FactoryError, match=r"vanishes from the cache.*cache\.max_bytes"):
        staged(tmp_path / "dataset", scheduler=SERIAL)
    assert status(tmp_path / "dataset")["state"] == "broken"


def test_tries_wait_longer_each_time_and_come_to_an_end() -> None:
    assert [backoff_s(0.5, deaths) for deaths in (1, 2, 3, 20)] == [0.5, 1.0, 2.0, 30.0]
    frame = PendingFrame(refs(1)[0], retries=2)
    assert frame.died("crash", "killed") is None
    assert frame.died("crash", "killed") is None
    failure = frame.died("timeout", "took longer")
    assert failure is not None
    assert (failure.kind, failure.reason) == (
        "timeout",
        "reef/alpha/0000: took longer, in each of 3 tries",
    )


# --- slices -----------------------------------------------------------------------------------


def test_slices_make_every_shard_once_and_the_whole_takes_them_up(
    tmp_path: Path, expected: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    for index in (1, 0):
        report = staged(directory, scheduler=SERIAL, shard=ShardSlice(index, 2))
        assert (report.shards, report.samples) == (2, 16)
        assert not (directory / "README.md").exists()
        assert not (directory / "manifest.json").exists()
    assert shard_bytes(directory) == expected
    report = staged(directory, scheduler=SERIAL)
    assert (report.kept, report.samples) == (4, 32)
    assert (directory / "README.md").exists()
    assert not list(directory.glob("manifest.*-of-*"))
    assert not list(directory.glob("failed.*-of-*"))
    assert shard_bytes(directory) == expected


def test_a_slice_must_be_one_of_those_that_there_are() -> None:
    with pytest.raises(FactoryError, match=r"shard: index must be 0 to count - 1 = 3, got 4"):
        build(ShardSlice, {"index": 4, "count": 4}, "shard")


def test_overwrite_makes_another_dataset_in_the_folder(
    tmp_path: Path, expected: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    make(directory, FakeConfig(shape=(30, 20)), scheduler=SERIAL, config_hash="0ther")
    with pytest.raises(FactoryError, match="another configuration"):
        make(directory, scheduler=SERIAL)
    (directory / "notes.txt").write_text("mine")
    over = DatasetSettings(preview_pairs=0, on_existing="overwrite")
    assert make(directory, scheduler=SERIAL, dataset=over).kept == 0
    assert shard_bytes(directory) == expected
    assert (directory / "notes.txt").read_text() == "mine"


def test_overwrite_never_touches_a_folder_that_is_no_dataset(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("mine")
    over = DatasetSettings(preview_pairs=0, on_existing="overwrite")
    with pytest.raises(FactoryError, match="no dataset"):
        make(tmp_path, scheduler=SERIAL, dataset=over)
    assert (tmp_path / "README.md").read_text() == "mine"


# --- lock -------------------------------------------------------------------------------------

HOLD = """
import sys, time
from pathlib import Path
from typing import Any
from simnfnd.factory.scheduler.lock import Lock
with Lock(Path(sys.argv[1]), sys.argv[2]):
    print("held", flush=True)
    time.sleep(60)
"""


def hold(folder: Path, part: str = "") -> subprocess.Popen[str]:
    command = [sys.executable, "-c", HOLD, str(folder), part]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_second_run_is_refused_and_a_dead_owner_holds_nothing(tmp_path: Path) -> None:
    owner = hold(tmp_path)
    assert owner_of(tmp_path) is not None
    with pytest.raises(FactoryError, match=f"written by process {owner.pid} on") as caught:
        make(tmp_path, scheduler=SERIAL)
    assert "\n" not in str(caught.value)
    assert os.listdir(tmp_path) == [LOCK_NAME], "the refused run touched the folder"
    owner.kill()
    owner.wait()
    assert owner_of(tmp_path) is None
    with Lock(tmp_path):
        assert json.loads((tmp_path / LOCK_NAME).read_text())["pid"] == os.getpid()
    assert not os.listdir(tmp_path)


def test_slices_run_side_by_side_and_not_beside_the_whole(tmp_path: Path) -> None:
    owner = hold(tmp_path, "0-of-2")
    try:
        with Lock(tmp_path, "1-of-2"):
            pass
        for part in ("", "0-of-2"):
            with pytest.raises(FactoryError, match=str(owner.pid)), Lock(tmp_path, part):
                pass
    finally:
        owner.kill()
        owner.wait()


def test_a_lock_of_another_machine_holds_while_it_is_touched(tmp_path: Path) -> None:
    lock = tmp_path / LOCK_NAME
    lock.write_text(json.dumps({"host": "elsewhere", "pid": 1, "started": 0.0}))
    with pytest.raises(FactoryError, match="process 1 on elsewhere"), Lock(tmp_path):
        pass
    old = time.time() - 3600
    os.utime(lock, (old, old))
    with Lock(tmp_path):
        assert json.loads(lock.read_text())["pid"] == os.getpid()


def test_a_number_that_another_process_got_since_is_no_owner(tmp_path: Path) -> None:
    me = myself()
    (tmp_path / LOCK_NAME).write_text(json.dumps({**me, "started": me["started"] - 100}))
    with Lock(tmp_path):
        pass
    (tmp_path / LOCK_NAME).write_text("{half a lo")
    with Lock(tmp_path):
        pass


def test_of_many_that_come_at_once_one_gets_the_lock(tmp_path: Path) -> None:
    (tmp_path / LOCK_NAME).write_text("{}")  # of somebody dead
    code = HOLD.replace("time.sleep(60)", "time.sleep(3)")
    command = [sys.executable, "-c", code, str(tmp_path), ""]
    crowd = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for _ in range(4)
    ]
    told = [process.communicate()[0] for process in crowd]
    assert told.count("held\n") == 1
    wait_for(lambda: not os.listdir(tmp_path))
