"""Hashes of input files: kept while a file is the same, computed anew when it is not."""

from __future__ import annotations

import hashlib
import os
import time
from pathlib import Path

import pytest

from simnfnd.factory.production.scheduler.plan import InputDigests


def test_unchanged_files_are_not_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "table.json"
    file = tmp_path / "a.npy"
    file.write_bytes(b"first")
    times = os.stat(file)
    inputs = InputDigests(table)
    before = inputs.digest(str(file))
    inputs.save()
    assert len(before) == 32
    with monkeypatch.context() as patch:
        patch.setattr(hashlib, "file_digest", lambda *_: 1 / 0)
        assert InputDigests(table).digest(str(file)) == before
    for damaged in ("{", "[3]", '{"/a": 3}'):
        table.write_text(damaged)
        assert InputDigests(table).digest(str(file)) == before

    # Another content of the same size, with the time of modification put back.
    inputs.save()
    time.sleep(0.02)
    file.write_bytes(b"other")
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert InputDigests(table).digest(str(file)) not in ("", before)


def test_what_cannot_be_read_has_no_hash(tmp_path: Path) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (loop, pipe, tmp_path / "absent"):
        assert InputDigests(None).digest(str(path)) == ""
