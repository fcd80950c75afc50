"""Slices of one dataset: each shard once, in any order and at the same moment."""

from __future__ import annotations

import multiprocessing
import threading
from pathlib import Path

from simnfnd.factory.dataset.folder import open_folder
from simnfnd.factory.dataset.manifest import load_failures, load_manifest
from simnfnd.factory.dataset.schema import Provenance, config_hash
from simnfnd.factory.scheduler.settings import ShardSlice
from tests.factory.scheduler.run_files import shard_bytes
from tests.factory.scheduler.staged import staged
from tests.fake_source import FakeConfig

PROVENANCE = Provenance({"seed": 0}, config_hash({"seed": 0}), "simnfnd test")
SLICES, FOLDERS = 3, 10
SERIAL = {"backend": "serial"}


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
    assert (report.kept, report.samples) == (3, 32)
    assert (directory / "README.md").exists()
    assert not list(directory.rglob("*-of-*"))
    assert not list(directory.glob("*/*.json")), "the results beside the shards have gone"
    assert load_failures(directory) == []
    assert shard_bytes(directory) == shard_bytes(tmp_path / "other" / "expected")


def open_many(directory: Path, together: threading.Barrier) -> None:
    for number in range(FOLDERS):
        together.wait(60)
        open_folder(directory / str(number), {"seed": 0}, PROVENANCE)


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
