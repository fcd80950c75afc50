"""Whole runs: the same bytes however the work went, and no frame costs more than itself."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest

from simnfnd.factory.dataset.manifest import load_manifest
from simnfnd.factory.errors import FactoryError
from tests.factory.scheduler.run_files import failures, litter, shard_bytes
from tests.fake_source import BrokenSource, FakeConfig, LethalSource, refs
from tests.run_fake import make
from tests.worker_processes import workers_of


def test_three_workers_give_the_bytes_of_one(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    # Each worker is replaced after every shard, which must not show either.
    report = make(tmp_path / "dataset", workers=3, recycle_frames=1)
    assert report.samples_by_split == {"train": 24, "test": 8}
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
    told = failures(directory)
    assert {name: item["kind"] for name, item in told.items()} == {
        "reef/alpha/0000": "frame",
        "reef/alpha/0001": "error",
        "reef/alpha/0006": "crash",
    }
    assert told["reef/alpha/0000"]["reason"] == "reef/alpha/0000: depth has 3 NaN pixels"
    assert "ZeroDivisionError: no such thing (fake_source.py:" in told["reef/alpha/0001"]["reason"]
    assert "SIGKILL" in told["reef/alpha/0006"]["reason"]
    assert told["reef/alpha/0006"]["command"].endswith("frames.only=[reef/alpha/0006]")
    assert [failure.ref.name for failure in report.failures] == sorted(told)
    assert report.samples == 32 - 3 * 2
    manifest = load_manifest(directory)
    assert manifest is not None
    assert manifest.shards["train/shard-00001.h5"].failed == ("reef/alpha/0006",)
    made = shard_bytes(directory)
    for path in ("train/shard-00002.h5", "test/shard-00000.h5"):
        assert made[path] == undisturbed[path], "a worker that died once left a trace"
    assert litter(directory) == []

    # The shards that are as good as they can be stay as they are; cured frames come in.
    before = {path: (directory / path).stat().st_mtime_ns for path in made}
    again = make(directory, FakeConfig(bad=config.bad, kills=config.kills, buggy=config.buggy))
    assert again.kept == 4
    assert {path: (directory / path).stat().st_mtime_ns for path in made} == before
    assert set(failures(directory)) == set(told)
    cured = make(directory)
    assert (cured.samples, cured.kept, cured.failures) == (32, 2, ())
    assert failures(directory) == {}
    assert shard_bytes(directory) == undisturbed


def test_a_shard_without_any_good_frame_has_no_file(tmp_path: Path) -> None:
    bad = tuple(ref.name for ref in refs(4, "beta"))
    report = make(tmp_path / "dataset", FakeConfig(bad=bad))
    assert report.samples_by_split == {"train": 24, "test": 0}
    assert not list((tmp_path / "dataset").glob("test/*"))
    assert len(report.failures) == 4


def test_a_frame_that_hangs_is_given_up(tmp_path: Path) -> None:
    config = FakeConfig(hangs=("reef/alpha/0002",))
    report = make(tmp_path / "dataset", config, frame_timeout_s=1.0, retries=0)
    (failure,) = report.failures
    assert (failure.kind, failure.ref.name) == ("timeout", "reef/alpha/0002")
    assert "scheduler.frame_timeout_s=1" in failure.reason
    assert report.samples == 30


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
    monkeypatch.setattr("simnfnd.factory.scheduler.loop._MAX_BARREN_DEATHS", 3)
    with pytest.raises(FactoryError, match=message) as caught:
        make(tmp_path / "dataset", **changes)
    assert "\n" not in str(caught.value)
    assert not workers_of(os.getpid())


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip_a_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def test_damaged_shards_are_made_again_and_the_rest_kept(
    tmp_path: Path, undisturbed: dict[str, bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    directory = tmp_path / "dataset"
    make(directory)
    capfd.readouterr()
    truncate(directory / "train/shard-00000.h5")
    flip_a_bit(directory / "train/shard-00001.h5")
    (directory / "test/shard-00000.h5").unlink()
    kept = (directory / "train/shard-00002.h5").stat().st_mtime_ns
    report = make(directory)
    assert report.kept == 1
    told = capfd.readouterr().err
    assert "train/shard-00000.h5: " in told
    assert "bytes instead of" in told
    assert "train/shard-00001.h5: SHA-256 differs; it is made again" in told
    assert "test/shard-00000.h5: absent" in told
    assert shard_bytes(directory) == undisturbed
    assert (directory / "train/shard-00002.h5").stat().st_mtime_ns == kept


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
