"""Two kinds of workers, backends, slices, the lock: whatever happens, the same bytes come out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from simnfnd.factory.errors import FactoryError
from tests.factory.scheduler.run_files import failures, litter, shard_bytes
from tests.factory.scheduler.staged import staged
from tests.fake_source import FakeConfig, GentleSource, prepared_file, refs

SERIAL = {"backend": "serial"}


def status(directory: Path) -> dict[str, object]:
    told: dict[str, object] = json.loads((directory / "status.json").read_text())
    return told


@pytest.mark.parametrize("backend", ["serial", "local"])
def test_frames_that_are_prepared_by_others_give_the_same_bytes(
    tmp_path: Path, undisturbed: dict[str, bytes], backend: str
) -> None:
    directory = tmp_path / "dataset"
    report = staged(directory, scheduler={"backend": backend, "render_workers": 1}, workers=3)
    assert (report.samples, report.failures) == (32, ())
    assert shard_bytes(directory) == undisturbed
    assert litter(directory) == []
    told = status(directory)
    assert told["state"] == "finished"
    assert told["frames"] == {"total": 16, "rendered": 16, "from_cache": 0, "failed": 0}
    assert told["workers"] == {"render": 1, "noise": 2}
    if backend != "serial":
        makers = {file.read_text() for file in (tmp_path / "prepared").iterdir()}
        assert len(makers) == 1, "somebody else than the render worker prepared a frame"


@pytest.mark.parametrize("backend", ["local", "dask"])
def test_a_frame_that_cannot_be_prepared_costs_itself_alone(
    tmp_path: Path, undisturbed: dict[str, bytes], backend: str
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
    report = staged(directory, config, scheduler={"backend": backend}, frame_timeout_s=1.0)
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
    made = shard_bytes(directory)
    assert made["test/shard-00000.h5"] == undisturbed["test/shard-00000.h5"], "killed once"
    assert "took longer than scheduler.frame_timeout_s=1" in told["reef/alpha/0010"]["reason"]

    # Running again tries what failed, touches nothing else, and takes in what is cured.
    before = {path: (directory / path).stat().st_mtime_ns for path in made}
    again = staged(directory, replace(config, hangs=(), kills=()), frame_timeout_s=1.0)
    assert {f.ref.name for f in again.failures} == {"reef/alpha/0000", "reef/alpha/0001"}
    assert again.kept == 2
    after = {path: (directory / path).stat().st_mtime_ns for path in shard_bytes(directory)}
    changed = [path for path in before if before[path] != after[path]]
    assert changed == ["train/shard-00001.h5", "train/shard-00002.h5"]
    assert all(shard_bytes(directory)[path] == undisturbed[path] for path in changed)


def test_a_prepared_frame_that_vanishes_is_prepared_again(
    tmp_path: Path, undisturbed: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
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
    assert shard_bytes(tmp_path / "dataset") == undisturbed
    assert prepared_file(FakeConfig(prepared=str(tmp_path / "prepared")), ref).exists()


def test_frames_that_never_stay_end_the_run_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(GentleSource, "ready", lambda self, ref: False)
    with pytest.raises(FactoryError, match=r"not in the cache.*cache\.max_bytes.*vanishes"):
        staged(tmp_path / "dataset", scheduler=SERIAL)
    assert status(tmp_path / "dataset")["state"] == "broken"
