"""Slices of one dataset that begin at the same moment, and what they leave behind."""

from __future__ import annotations

import multiprocessing
import threading
from pathlib import Path
from typing import Any

import pytest

from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.write import folder
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.scheduler.settings import ShardSlice
from tests.run_fake import make

PROVENANCE = Provenance({"seed": 0}, "c0ffee0123456789", "simnfnd test")
SLICES, FOLDERS = 4, 20


def open_part(directory: Path, part: str) -> None:
    folder.open_folder(directory, {"seed": 0}, PROVENANCE, part)


@pytest.mark.parametrize("after", ["save_manifest", "write_atomically"])
def test_a_slice_opens_a_new_folder_while_another_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: str
) -> None:
    write, others = getattr(folder, after), ["1-of-2"]

    def write_and_let_the_other_begin(*args: Any) -> None:
        write(*args)
        if others:
            open_part(tmp_path / "dataset", others.pop())

    monkeypatch.setattr(folder, after, write_and_let_the_other_begin)
    open_part(tmp_path / "dataset", "0-of-2")
    names = {path.name for path in (tmp_path / "dataset").iterdir()}
    assert names == {"config.yaml", "manifest.0-of-2.json", "manifest.1-of-2.json"}


def open_many(directory: Path, part: str, together: threading.Barrier) -> None:
    for number in range(FOLDERS):
        together.wait(60)
        open_part(directory / str(number), part)


def test_slices_that_begin_at_once_are_all_let_in(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    together = context.Barrier(SLICES)
    processes = [
        context.Process(target=open_many, args=(tmp_path, f"{index}-of-{SLICES}", together))
        for index in range(SLICES)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join(90)
    assert [process.exitcode for process in processes] == [0] * SLICES
    for number in range(FOLDERS):
        assert len(list((tmp_path / str(number)).glob("manifest.*.json"))) == SLICES


def test_a_folder_of_something_else_is_still_refused(tmp_path: Path) -> None:
    (tmp_path / "manifest.txt").write_text("mine")
    with pytest.raises(FactoryError, match=r"holds other files \(manifest.txt\)"):
        open_part(tmp_path, "0-of-2")


def test_the_whole_leaves_nothing_of_its_slices(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    for index in range(2):
        make(directory, scheduler={"backend": "serial"}, shard=ShardSlice(index, 2))
    assert list(directory.glob("*-of-*"))
    make(directory, scheduler={"backend": "serial"})
    assert not list(directory.glob("*-of-*"))
