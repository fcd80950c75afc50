"""Whole runs: the same bytes however the work went, and no frame costs more than itself."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import resource
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from simnfnd.factory.common import progress
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.workers.settings import ShardSlice
from simnfnd.factory.dataset.folder import open_folder
from simnfnd.factory.dataset.manifest import load_failures, load_manifest
from simnfnd.factory.dataset.schema import Provenance, config_hash
from tests.factory.dataset.flips import flip
from tests.factory.production.scheduler.run_files import failures, litter, shard_bytes, staged
from tests.fake_source import (
    BrokenSource,
    FakeConfig,
    GentleSource,
    LethalSource,
    prepared_file,
    refs,
)
from tests.run_fake import make
from tests.worker_processes import workers_of


def test_three_workers_give_the_bytes_of_one(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    # Each worker is replaced after every shard, which must not show either.
    report = make(tmp_path / "dataset", workers=3, recycle_frames=1)
    assert report.samples == 32
    assert shard_bytes(tmp_path / "dataset") == undisturbed


def test_frames_that_fail_kill_or_break_cost_themselves_alone(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    config = FakeConfig(
        bad=("reef/alpha/0000",),
        buggy=("reef/alpha/0001",),
        kills=("reef/alpha/0006",),
        killed_once=("reef/alpha/0009", "reef/beta/0003"),
        marks=str(tmp_path),
    )
    report = make(directory, config)
    message = failures(directory)
    assert {name: item["kind"] for name, item in message.items()} == {
        "reef/alpha/0000": "frame",
        "reef/alpha/0001": "error",
        "reef/alpha/0006": "crash",
    }
    assert message["reef/alpha/0000"]["reason"] == "reef/alpha/0000: depth has 3 NaN pixels"
    assert (
        "ZeroDivisionError: no such thing (fake_source.py:" in message["reef/alpha/0001"]["reason"]
    )
    assert "SIGKILL" in message["reef/alpha/0006"]["reason"]
    assert message["reef/alpha/0006"]["command"].endswith("frames.only=[reef/alpha/0006]")
    assert [failure.ref.name for failure in report.failures] == sorted(message)
    assert report.samples == 32 - 3 * 2
    manifest = load_manifest(directory)
    assert manifest is not None
    assert manifest.shards["train/shard-00001.h5"].failed == ("reef/alpha/0006",)
    bytes_of_shard = shard_bytes(directory)
    for path in ("train/shard-00002.h5", "test/shard-00000.h5"):
        assert bytes_of_shard[path] == undisturbed[path], "a worker that died once left a trace"
    assert litter(directory) == []

    # The shards that are as good as they can be stay as they are; cured frames come in.
    before = {path: (directory / path).stat().st_mtime_ns for path in bytes_of_shard}
    again = make(directory, FakeConfig(bad=config.bad, kills=config.kills, buggy=config.buggy))
    assert again.reused_shards == 4
    assert {path: (directory / path).stat().st_mtime_ns for path in bytes_of_shard} == before
    assert set(failures(directory)) == set(message)
    cured = make(directory)
    assert (cured.samples, cured.reused_shards, cured.failures) == (32, 2, ())
    assert failures(directory) == {}
    assert shard_bytes(directory) == undisturbed


def test_a_shard_without_any_good_frame_has_no_file(tmp_path: Path) -> None:
    bad = tuple(ref.name for ref in refs(4, "beta"))
    report = make(tmp_path / "dataset", FakeConfig(bad=bad))
    assert report.samples == 24
    assert not list((tmp_path / "dataset").glob("test/*"))
    assert len(report.failures) == 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"config": FakeConfig(fatal=("reef/alpha/0002",))}, "render.kind=cycles needs bpy"),
        ({"source": BrokenSource}, "use Python 3.11"),
        ({"source": LethalSource}, "no worker lives long enough to begin a frame"),
    ],
)
def test_what_no_frame_can_survive_ends_the_run_in_one_line(
    tmp_path: Path, changes: dict[str, object], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simnfnd.factory.production.scheduler.loop._MAX_BARREN_DEATHS", 3)
    with pytest.raises(FactoryError, match=message) as caught:
        make(tmp_path / "dataset", **changes)
    assert "\n" not in str(caught.value)
    assert not workers_of(os.getpid())


def test_damaged_shards_are_made_again_and_the_rest_kept(
    tmp_path: Path, undisturbed: dict[str, bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    directory = tmp_path / "dataset"
    make(directory)
    capfd.readouterr()
    first = directory / "train/shard-00000.h5"
    first.write_bytes(first.read_bytes()[:-100])
    flip(directory / "train/shard-00001.h5", 3000, 2)
    (directory / "test/shard-00000.h5").unlink()
    remaining = (directory / "train/shard-00002.h5").stat().st_mtime_ns
    report = make(directory)
    assert report.reused_shards == 1
    message = capfd.readouterr().err
    assert "train/shard-00000.h5: " in message
    assert "bytes, the manifest says" in message
    assert "train/shard-00001.h5: SHA-256 differs; it is made again" in message
    assert "test/shard-00000.h5: listed in the manifest but absent" in message
    assert shard_bytes(directory) == undisturbed
    assert (directory / "train/shard-00002.h5").stat().st_mtime_ns == remaining


def test_a_full_disk_is_said_in_one_line_and_cured_by_running_again(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    largest = max(map(len, undisturbed.values()))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The workers inherit it: a shard no longer fits, what else is written does.
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest // 2, limits[1]))
    try:
        with pytest.raises(FactoryError, match="no room to write") as caught:
            make(directory)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "\n" not in str(caught.value)
    assert litter(directory) == []
    assert make(directory).samples == 32
    assert shard_bytes(directory) == undisturbed


SERIAL = {"backend": "serial"}


def status(directory: Path) -> dict[str, object]:
    message: dict[str, object] = json.loads((directory / "status.json").read_text())
    return message


@pytest.mark.parametrize("backend", ["serial", "local"])
def test_frames_that_are_prepared_by_others_give_the_same_bytes(
    tmp_path: Path, undisturbed: dict[str, bytes], backend: str
) -> None:
    directory = tmp_path / "dataset"
    report = staged(directory, scheduler={"backend": backend, "render_workers": 1}, workers=3)
    assert (report.samples, report.failures) == (32, ())
    assert shard_bytes(directory) == undisturbed
    assert litter(directory) == []
    message = status(directory)
    assert message["state"] == "finished"
    assert message["frames"] == {"total": 16, "rendered": 16, "from_cache": 0, "failed": 0}
    if backend != "serial":
        makers = {file.read_text() for file in (tmp_path / "prepared").iterdir()}
        assert len(makers) == 1, "somebody else than the render worker prepared a frame"


@pytest.mark.slow
def test_frames_that_fail_or_kill_dasks_workers_cost_themselves_alone(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    config = FakeConfig(
        bad=("reef/alpha/0000",),
        kills=("reef/alpha/0006",),
        killed_once=("reef/beta/0003",),
        marks=str(tmp_path),
    )
    report = staged(directory, config, scheduler={"backend": "dask"})
    kinds = {name: item["kind"] for name, item in failures(directory).items()}
    assert kinds == {"reef/alpha/0000": "frame", "reef/alpha/0006": "crash"}
    assert report.samples == 32 - 2 * 2
    bytes_of_shard = shard_bytes(directory)
    for path in ("train/shard-00002.h5", "test/shard-00000.h5"):
        assert bytes_of_shard[path] == undisturbed[path]


@pytest.mark.slow
def test_a_frame_that_cannot_be_prepared_costs_itself_alone(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    config = FakeConfig(
        bad=("reef/alpha/0000",),
        buggy=("reef/alpha/0001",),
        kills=("reef/alpha/0006",),
        hangs=("reef/alpha/0010",),
        killed_once=("reef/beta/0003",),
        marks=str(tmp_path),
    )
    report = staged(directory, config, frame_timeout_s=1.0)
    message = failures(directory)
    assert {name: item["kind"] for name, item in message.items()} == {
        "reef/alpha/0000": "frame",
        "reef/alpha/0001": "error",
        "reef/alpha/0006": "crash",
        "reef/alpha/0010": "timeout",
    }
    assert message["reef/alpha/0010"]["shard"] == "train/shard-00002.h5"
    assert "in each of 2 tries" in message["reef/alpha/0006"]["reason"]
    assert "FakePreparer" not in message["reef/alpha/0001"]["reason"]
    assert report.samples == 32 - 4 * 2
    bytes_of_shard = shard_bytes(directory)
    assert bytes_of_shard["test/shard-00000.h5"] == undisturbed["test/shard-00000.h5"], (
        "killed once"
    )
    assert "took longer than scheduler.frame_timeout_s=1" in message["reef/alpha/0010"]["reason"]

    # Running again tries what failed, touches nothing else, and takes in what is cured.
    before = {path: (directory / path).stat().st_mtime_ns for path in bytes_of_shard}
    again = staged(directory, replace(config, hangs=(), kills=()), frame_timeout_s=1.0)
    assert {f.ref.name for f in again.failures} == {"reef/alpha/0000", "reef/alpha/0001"}
    assert again.reused_shards == 2
    after = {path: (directory / path).stat().st_mtime_ns for path in shard_bytes(directory)}
    changed = [path for path in before if before[path] != after[path]]
    assert changed == ["train/shard-00001.h5", "train/shard-00002.h5"]
    assert all(shard_bytes(directory)[path] == undisturbed[path] for path in changed)


def test_a_prepared_frame_that_vanishes_is_prepared_again(
    tmp_path: Path, undisturbed: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    ref = refs(12)[5]
    lost: list[int] = []

    def forgetful(
        self: GentleSource, requested_ref: object, variants: object, pairs=GentleSource.pairs
    ):
        if requested_ref == ref and not lost:
            lost.append(1)
            prepared_file(self.config, ref).unlink()
        return pairs(self, requested_ref, variants)

    monkeypatch.setattr(GentleSource, "pairs", forgetful)
    staged(tmp_path / "dataset", scheduler=SERIAL)
    assert lost
    assert shard_bytes(tmp_path / "dataset") == undisturbed
    assert prepared_file(FakeConfig(prepared=str(tmp_path / "prepared")), ref).exists()


def test_frames_that_never_stay_end_the_run_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GentleSource, "ready", lambda self, ref: False)
    with pytest.raises(FactoryError, match=r"not in the cache.*cache\.max_bytes.*vanishes"):
        staged(tmp_path / "dataset", scheduler=SERIAL)
    assert status(tmp_path / "dataset")["state"] == "broken"


PROVENANCE = Provenance({"seed": 0}, config_hash({"seed": 0}), "simnfnd test")
SLICES = 2
FOLDERS = 10


def test_slices_make_every_shard_once_and_the_whole_takes_them_up(tmp_path: Path) -> None:
    staged(tmp_path / "other" / "expected", scheduler=SERIAL)
    directory = tmp_path / "dataset"
    config = FakeConfig(bad=("reef/alpha/0000",))
    for index in (1, 0):
        staged(directory, config, scheduler=SERIAL, shard=ShardSlice(index, 2))
        assert not (directory / "README.md").exists()
    manifest = load_manifest(directory)
    assert manifest is not None
    assert manifest.samples() == 30
    assert [item["frame"] for item in load_failures(directory)] == ["reef/alpha/0000"]
    report = staged(directory, scheduler=SERIAL)
    assert (report.reused_shards, report.samples) == (3, 32)
    assert (directory / "README.md").exists()
    assert not list(directory.rglob("*-of-*"))
    assert not list(directory.glob("*/*.json")), "no results are left beside the shards"
    assert load_failures(directory) == []
    assert shard_bytes(directory) == shard_bytes(tmp_path / "other" / "expected")


def open_many(directory: Path, together: threading.Barrier) -> None:
    for number in range(FOLDERS):
        together.wait(60)
        open_folder(directory / str(number), {"seed": 0}, PROVENANCE)


@pytest.mark.slow
def test_slices_that_begin_at_once_are_all_let_in(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    together = context.Barrier(SLICES)
    processes = [
        context.Process(target=open_many, args=(tmp_path, together)) for _ in range(SLICES)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(90)
    assert [process.exitcode for process in processes] == [0] * SLICES
    for number in range(FOLDERS):
        names = {path.name for path in (tmp_path / str(number)).iterdir()}
        assert names == {"config.yaml", "manifest.json"}


COUNTS = re.compile(r"frames (\d+)/16.*, pairs (\d+)/32; \d+:\d\d elapsed(?:, \d+:\d\d left)?")


def test_a_run_counts_frames_and_pairs_from_the_first_one_on(tmp_path, capfd):
    staged(tmp_path / "dataset", FakeConfig(delay_s=0.01), scheduler={"backend": "serial"})
    lines = capfd.readouterr().err.splitlines()
    assert "32 pairs" in lines[0]
    counted = [COUNTS.fullmatch(line) for line in lines if line.startswith("frames")]
    assert counted[0] is not None
    assert counted[0].groups() == ("1", "0")
    assert "left" in counted[0].group()
    assert counted[-1] is not None
    assert counted[-1].groups() == ("16", "32")
    assert lines[-1] == "writing index, card"


def test_a_bar_in_a_file_is_a_few_whole_lines(capfd):
    with progress.Bar(total=5000, unit="step", desc="training") as bar:
        for step in range(5000):
            bar.set_postfix(f"loss={step / 3:.3g}")
            bar.update()
    text = capfd.readouterr().err
    assert "\r" not in text
    lines = text.splitlines()
    assert len(lines) <= 3
    assert lines[-1].startswith("training: 5000 of 5000 steps in 0:")
    assert lines[-1].endswith(", loss=1.67e+03")
