"""Containers of videos by their first bytes, and whether a file ends before its content does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import IO

_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")
_MATROSKA = b"\x1a\x45\xdf\xa3"
_MOST_PARTS = 100_000
"""Top-level parts that are looked at: a fragmented recording has one a second."""


def container_of(head: bytes) -> str | None:
    """FFmpeg's name of the reader for a file that begins so; None for no known container."""
    if head[:4] == b"RIFF" and head[8:12] == b"AVI ":
        return "avi"
    if head[4:8] in _BOXES:
        return "mov"
    if head[:4] == _MATROSKA:
        return "matroska"
    return None


def is_cut_short(file: IO[bytes], size: int, container: str) -> bool:
    """Whether a part of an AVI, MP4 or MOV file says to end beyond the file's `size` bytes."""
    ends = {"avi": _end_of_riff, "mov": _end_of_boxes}
    return container in ends and ends[container](file, size) > size


def _end_of_riff(file: IO[bytes], size: int) -> int:
    """Where the chunks of an AVI file end (Microsoft RIFF; each is padded to an even length)."""
    offset = 0
    for _ in range(_MOST_PARTS):
        header = _bytes_at(file, offset, 12)
        if len(header) < 12 or header[:4] != b"RIFF":
            break
        length = int.from_bytes(header[4:8], "little")
        if length == 0:  # of a recorder that was stopped; its index is missing, too
            return size + 1
        offset += 8 + length + length % 2
        if offset - length % 2 > size:
            return offset
    return min(offset, size)


def has_index(file: IO[bytes], size: int) -> bool:
    """Whether an MP4 or MOV file holds the box that says where its frames lie."""
    return any(kind == b"moov" for kind, _ in _boxes(file, size))


def _end_of_boxes(file: IO[bytes], size: int) -> int:
    return max((end for _, end in _boxes(file, size)), default=0)


def _boxes(file: IO[bytes], size: int) -> Iterator[tuple[bytes, int]]:
    """Kind and end of each box of an MP4 or MOV file (ISO/IEC 14496-12)."""
    offset = 0
    for _ in range(_MOST_PARTS):
        header = _bytes_at(file, offset, 16)
        length = int.from_bytes(header[:4], "big")
        if length == 0:  # to the end of the file
            length = size - offset
        elif length == 1:
            length = int.from_bytes(header[8:16], "big")
        if len(header) < 8 or length < 8:
            return
        offset += length
        yield header[4:8], offset
        if offset >= size:
            return


def _bytes_at(file: IO[bytes], offset: int, count: int) -> bytes:
    file.seek(offset)
    return file.read(count)
