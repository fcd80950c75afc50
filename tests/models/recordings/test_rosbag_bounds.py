"""Bags that unpack into much more than they are cost one line, and sound ones are read."""

from __future__ import annotations

import bz2
import sqlite3
import sys
from pathlib import Path

import lz4.frame
import numpy as np
import pytest

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.models.recordings import base, open_recording, rosbag_files
from simnfnd.models.recordings.ros_messages import IMAGE, typestore
from simnfnd.models.recordings.rosbag_files import unpacked_zstd
from tests.models.recordings.bag_files import image, write_bag

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

SIDE = 512
KINDS = [
    ("a.bag", "bz2"), ("a.bag", "lz4"), ("folder", "message"), ("folder", "file"), ("a.mcap", ""),
]  # fmt: skip


def black(path: Path, compression: str, count: int = 3) -> Path:
    """A bag of black pictures, which pack to next to nothing."""
    store = typestore(1 if path.suffix == ".bag" else 2)
    picture = np.zeros((SIDE, SIDE), np.uint8)
    messages = [image(store, number, picture) for number in range(count)]
    return write_bag(path, {"/sonar": (IMAGE, messages)}, compression=compression)


def read(path: Path) -> int:
    with open_recording(path) as recording:
        return len(list(recording))


@pytest.mark.parametrize(("name", "compression"), KINDS)
def test_what_a_bag_unpacks_into_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, compression: str
) -> None:
    path = black(tmp_path / name, compression)
    assert read(path) == 3
    monkeypatch.setattr(base, "RATIO", 0)
    # All messages together, then each alone.
    for most in (2.5, 0.5):
        monkeypatch.setattr(base, "ALWAYS_BYTES", int(most * SIDE * SIDE))
        with pytest.raises((FactoryError, FrameError)) as caught:
            read(path)
        said = str(caught.value)
        assert said.startswith(str(path))
        assert "unpacks to" in said
        assert "\n" not in said


def test_real_bombs_stop_at_the_bound() -> None:
    from rosbags.rosbag1.reader import decompressors
    from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

    rosbag_files._bound_the_library()
    zeros = bytes(base.ALWAYS_BYTES + 1)
    for content, unpack in (
        (zstd.compress(zeros), unpacked_zstd),
        (zstd.compress(zeros), lambda content: DECOMPRESSORS["zstd"](content, 10)),
        (lz4.frame.compress(zeros), lambda content: DECOMPRESSORS["lz4"](content, 10)),
        (lz4.frame.compress(zeros), decompressors["lz4"]),
    ):
        assert len(content) < len(zeros) / 200
        with pytest.raises(ValueError, match="unpacks to more"):
            unpack(content)
    both = bz2.compress(b"one ") + bz2.compress(b"two")
    assert decompressors["bz2"](both) == b"one two"
    assert decompressors["lz4"](lz4.frame.compress(b"sound")) == b"sound"
    with pytest.raises(ValueError, match="too early"):
        decompressors["bz2"](both[:-4])


@pytest.mark.parametrize(
    "change",
    [
        "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS WITH RECURSIVE n(id) AS "
        "(SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT id, 1 AS topic_id, id AS timestamp, "
        "zeroblob(1000000000) AS data FROM n",
        "CREATE VIRTUAL TABLE other USING fts5(a)",
        "ALTER TABLE messages ADD COLUMN more BLOB GENERATED ALWAYS AS (zeroblob(1000000000))",
    ],
)
def test_a_database_that_computes_is_refused(tmp_path: Path, change: str) -> None:
    path = black(tmp_path / "a.db3", "", 1)
    assert read(path) == 1
    database = sqlite3.connect(path)
    database.executescript(change)
    database.close()
    with pytest.raises(FactoryError, match=r"a\.db3: holds a (view|table) that computes"):
        read(path)
