"""Shards that nobody has looked at are opened by another process first."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.models.denoise import shards
from simnfnd.models.denoise.inputs import Item, find_items
from simnfnd.models.denoise.shards import made_of_points, opened_shard
from tests.factory.export.export_dataset import write


def test_each_is_looked_at_once_and_those_of_a_dataset_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "data")
    (item, *_) = find_items([tmp_path / "data"], tmp_path / "out")
    looked: list[Path] = []
    monkeypatch.setattr(shards, "check_in_isolation", looked.extend)
    opened_shard(item).close()
    assert item.checked
    assert looked == []
    alone = Item(item.source, Path("a.h5"))
    for _ in range(3):
        opened_shard(alone).close()
    assert looked == [item.source]
    os.utime(item.source, (1, 1))
    opened_shard(alone).close()
    assert looked == [item.source] * 2, "another file may lie there now"


def test_one_that_crashes_the_library_is_skipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "data")
    path = next((tmp_path / "data").glob("t*/*.h5"))
    crash = FactoryError(f"{path}: crashes the HDF5 library; it is damaged")

    def look(paths: list[Path]) -> None:
        raise crash

    monkeypatch.setattr(shards, "check_in_isolation", look)
    with pytest.raises(FrameError, match="crashes the HDF5 library"):
        made_of_points(Item(path, Path("a.h5")))
