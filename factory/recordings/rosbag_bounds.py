"""Bags that were made to unpack into gigabytes: refused before they do.

The library rosbags unpacks whatever it is given.  Here its tables of decompressors are filled with
ones that stop, files and messages are unpacked or counted by ourselves, and what a whole bag may
give is bounded by its size.
"""

from __future__ import annotations

import bz2
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from simnfnd.factory.errors import FrameError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MOST_CHUNK = 256 * 2**20
"""Bytes that one chunk or message may unpack into; writers of bags make chunks of about 1 MB."""
MOST_RATIO = 200
"""How many times its size on disk, beyond MOST_CHUNK, a bag may give.

Raw pictures of a sonar are black for the most part and pack 5 to 50 times.
"""
_STEP = 2**20


def allowance(size: int) -> int:
    """Bytes that a bag of `size` bytes may unpack into."""
    return MOST_CHUNK + MOST_RATIO * size


def bound_the_library() -> None:
    """Let no chunk that rosbags reads from now on unpack into more than MOST_CHUNK bytes."""
    from rosbags.rosbag1.reader import decompressors
    from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

    decompressors.update(bz2=_unpacked_bz2, lz4=_unpacked_lz4)
    DECOMPRESSORS.update(
        lz4=lambda content, _: _unpacked_lz4(content),
        zstd=lambda content, _: unpacked_zstd(content),
    )


def unpacked_zstd(content: bytes) -> bytes:
    """A chunk or message.  Raises ValueError when it is larger than MOST_CHUNK, or damaged."""
    return _unpacked(content, zstd.ZstdDecompressor)


def _unpacked_bz2(content: bytes) -> bytes:
    return _unpacked(content, bz2.BZ2Decompressor)


def _unpacked_lz4(content: bytes) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    return _unpacked(content, LZ4FrameDecompressor)


def _unpacked(content: bytes, kind: Any) -> bytes:
    """All streams of `content`, one after another."""
    parts, total = [], 0
    while content:
        one = kind()
        part = one.decompress(content, max_length=MOST_CHUNK - total + 1)
        total += len(part)
        if total > MOST_CHUNK:
            raise ValueError(f"it unpacks into more than {MOST_CHUNK:,} bytes")
        if not one.eof:
            raise ValueError("compressed data end too early")
        parts.append(part)
        content = one.unused_data or b""
    return b"".join(parts)


def check_files(path: Path) -> None:
    """Refuse files that make much of little before the library opens them.

    Raises FrameError for a bag whose files, packed as a whole, unpack beyond `allowance`, and for a
    database whose tables are no tables: a view can go on for ever.
    """
    files = [path] if path.is_file() else sorted(one for one in path.iterdir() if one.is_file())
    for file in files:
        if file.suffix == ".zstd":
            _count(file)
        elif file.suffix == ".db3":
            _check_tables(file)


def _count(file: Path) -> None:
    most, total = allowance(file.stat().st_size), 0
    try:
        with zstd.open(file, "rb") as opened:
            while part := opened.read(_STEP):
                total += len(part)
                if total > most:
                    raise FrameError(
                        f"{file}: unpacks into more than {most:,} bytes, {MOST_RATIO} times its "
                        "size; if it is sound, unpack it with `zstd -d` and take the result"
                    )
    except (zstd.ZstdError, EOFError, OSError) as error:
        raise FrameError(f"{file}: cannot be read, it is damaged or no bag ({error})") from error


def _check_tables(file: Path) -> None:
    try:
        with file.open("rb") as opened:
            if opened.read(16) != b"SQLite format 3\0":
                return
        database = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)
        try:
            found = database.execute("SELECT type, sql FROM sqlite_master LIMIT 100").fetchall()
        finally:
            database.close()
    except (sqlite3.Error, OSError) as error:
        raise FrameError(f"{file}: cannot be read, it is damaged or no bag ({error})") from error
    for kind, sql in found:
        words = " ".join(str(sql).upper().replace("(", " ( ").split())
        if kind not in ("table", "index") or "VIRTUAL TABLE" in words or " AS ( " in words:
            raise FrameError(f"{file}: holds a {kind} that computes; no bag has that")


def counted(path: Path, size: int, contents: Iterator[Any]) -> Iterator[Any]:
    """The same (connection, time, content), while together they keep to `allowance`.

    Raises FrameError at the first beyond.
    """
    most = allowance(size)
    for message in contents:
        most -= len(message[2])
        if most < 0:
            raise FrameError(
                f"{path}: its messages are more than {allowance(size):,} bytes, {MOST_RATIO} times "
                "its size; it was made to fill memory or disk"
            )
        yield message
