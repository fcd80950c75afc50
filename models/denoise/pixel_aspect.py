"""The shape of pixels in Matroska files, which PyAV cannot state where the codec does not.

FFmpeg leaves room (a Void element) in the entry of a track.  The size at which a player shows the
video (RFC 9559, DisplayWidth and DisplayHeight) is put there, so that nothing behind it moves.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import IO, NamedTuple

from ..recordings.containers import SEGMENT, Element, element_at

_CRC = b"\xbf"
_TRACKS = b"\x16\x54\xae\x6b"
_TRACK_ENTRY = b"\xae"
_VIDEO = b"\xe0"
_VOID = b"\xec"
_DISPLAY_WIDTH = b"\x54\xb0"
_DISPLAY_HEIGHT = b"\x54\xba"
_DISPLAY_UNIT = b"\x54\xb2"
_LEAST_VOID = 2  # bytes of the smallest element
_MOST_SHORT = 126  # length that a field of one byte states


class _Child(NamedTuple):
    """An element in another one.  end: where the next one begins."""

    element: Element
    start: int
    end: int


def state_pixel_aspect(path: Path, size: tuple[int, int], pixel_aspect: Fraction) -> bool:
    """State the width of a pixel by its height in a Matroska file that FFmpeg has written.

    size: height and width, pixels.  Returns whether there was room for it; else the file stays as
    it is.
    """
    with path.open("r+b") as file:
        entry = _entry_of_video(file)
        if entry is None:
            return False
        tracks, track, video = entry
        display = _display_size(size, pixel_aspect)
        content = _with_display(file, track, video, display)
        if content is None:
            return False
        file.seek(track.element.content)
        file.write(content)
        _renew_checksum(file, tracks)
    return True


def _display_size(size: tuple[int, int], pixel_aspect: Fraction) -> tuple[int, int]:
    """Width and height in whole numbers whose ratio is exact, and about the size of the video."""
    height, width = size
    ratio = width * pixel_aspect / height
    times = math.ceil(Fraction(height, ratio.denominator))
    return ratio.numerator * times, ratio.denominator * times


def _entry_of_video(file: IO[bytes]) -> tuple[_Child, _Child, _Child] | None:
    """The tracks, the entry of the track with images, and what that says of them."""
    header = element_at(file, 0)
    if header is None or header.length is None:
        return None
    segment = element_at(file, header.content + header.length)
    if segment is None or segment.identifier != SEGMENT or segment.length is None:
        return None
    end = segment.content + segment.length
    tracks = _child(file, segment.content, end, _TRACKS)
    track = _child_of(file, tracks, _TRACK_ENTRY)
    video = _child_of(file, track, _VIDEO)
    if tracks is None or track is None or video is None:
        return None
    return tracks, track, video


def _children(file: IO[bytes], start: int, end: int) -> Iterator[_Child]:
    while start < end:
        element = element_at(file, start)
        if element is None or element.length is None:
            return
        after = element.content + element.length
        yield _Child(element, start, after)
        start = after


def _child(file: IO[bytes], start: int, end: int, identifier: bytes) -> _Child | None:
    children = _children(file, start, end)
    return next((child for child in children if child.element.identifier == identifier), None)


def _child_of(file: IO[bytes], parent: _Child | None, identifier: bytes) -> _Child | None:
    if parent is None:
        return None
    return _child(file, parent.element.content, parent.end, identifier)


def _with_display(
    file: IO[bytes], track: _Child, video: _Child, display: tuple[int, int]
) -> bytes | None:
    """The content of a track's entry with the display size of its images; None for no room."""
    void = _child_of(file, track, _VOID)
    if void is None:
        return None
    # FFmpeg states an unknown unit; without a unit, both numbers are pixels.
    video_content = b"".join(
        _bytes_of(file, child.start, child.end)
        for child in _children(file, video.element.content, video.end)
        if child.element.identifier not in (_DISPLAY_UNIT, _DISPLAY_WIDTH, _DISPLAY_HEIGHT)
    )
    room = void.end - void.start + video.end - video.start - 2 - len(video_content)
    stated = _stated(display, room)
    if stated is None or len(video_content) + len(stated) > _MOST_SHORT:
        return None
    rest = room - len(stated)
    parts = []
    for child in _children(file, track.element.content, track.end):
        content = _bytes_of(file, child.start, child.end)
        if child.start == video.start:
            content = _VIDEO + bytes([0x80 | len(video_content) + len(stated)])
            content += video_content + stated
        elif child.start == void.start:
            content = b"" if rest == 0 else _VOID + bytes([0x80 | rest - 2]) + bytes(rest - 2)
        parts.append(content)
    changed = b"".join(parts)
    return changed if len(changed) == track.end - track.element.content else None


def _stated(display: tuple[int, int], room: int) -> bytes | None:
    """Both numbers as elements that leave nothing of the room, or enough for an element."""
    width, height = display
    for width_bytes in range(_least_bytes(width), 9):
        stated = _number(_DISPLAY_WIDTH, width, width_bytes)
        stated += _number(_DISPLAY_HEIGHT, height, _least_bytes(height))
        rest = room - len(stated)
        if rest == 0 or _LEAST_VOID <= rest <= _MOST_SHORT:
            return stated
    return None


def _least_bytes(number: int) -> int:
    return max(1, (number.bit_length() + 7) // 8)


def _number(identifier: bytes, number: int, length: int) -> bytes:
    return identifier + bytes([0x80 | length]) + number.to_bytes(length, "big")


def _renew_checksum(file: IO[bytes], parent: _Child) -> None:
    """Write the CRC-32 of an element that begins with one anew."""
    first = element_at(file, parent.element.content)
    if first is None or first.identifier != _CRC or first.length != 4:
        return
    content = _bytes_of(file, first.content + 4, parent.end)
    file.seek(first.content)
    file.write(zlib.crc32(content).to_bytes(4, "little"))


def _bytes_of(file: IO[bytes], start: int, end: int) -> bytes:
    file.seek(start)
    return file.read(end - start)
