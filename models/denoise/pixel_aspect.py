"""The shape of pixels in Matroska, WebM and AVI files, which PyAV cannot state for some codecs.

FFmpeg leaves room (Void elements, a JUNK chunk) in the headers of these files.  What states the
shape is put there, so that the frames stay where they are: in Matroska and WebM the size at which a
player shows the video (RFC 9559, DisplayWidth and DisplayHeight), in AVI the video properties
header of OpenDML (version 1.02) with the aspect ratio of the frame.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import IO, NamedTuple

from ..recordings.containers import SEGMENT, Element, element_at

_CRC = b"\xbf"
_SEEK_HEAD = b"\x11\x4d\x9b\x74"
_SEEK_POSITION = b"\x53\xac"
_TRACKS = b"\x16\x54\xae\x6b"
_TRACK_ENTRY = b"\xae"
_VIDEO = b"\xe0"
_VOID = b"\xec"
_DISPLAY_WIDTH = b"\x54\xb0"
_DISPLAY_HEIGHT = b"\x54\xba"
_DISPLAY_UNIT = b"\x54\xb2"
_LEAST_VOID = 2  # bytes of the smallest element
_MOST_SHORT = 126  # length that a field of one byte states

_HEADER_LIST = b"hdrl"
_STREAM_LIST = b"strl"
_JUNK = b"JUNK"
_PROPERTIES = b"vprp"
_PROPERTIES_LAYOUT = struct.Struct("<5I2H11I")
_MOST_RATIO = 0xFFFF


class _Child(NamedTuple):
    """An element in another one.  end: where the next one begins."""

    element: Element
    start: int
    end: int


class _Entry(NamedTuple):
    """The segment of a file, its tracks, the one with images, and what that says of them."""

    segment: _Child
    tracks: _Child
    track: _Child
    video: _Child


def state_pixel_aspect(
    path: Path, container: str, size: tuple[int, int], pixel_aspect: Fraction
) -> bool:
    """State the width of a pixel by its height in a file that FFmpeg has written.

    container: FFmpeg's name of it, `matroska`, `webm` or `avi`.  size: height and width, pixels.
    Returns whether there was room for it; else the file stays as it is.
    """
    with path.open("r+b") as file:
        if container == "avi":
            return _state_in_avi(file, size, pixel_aspect)
        entry = _entry_of_video(file)
        if entry is None:
            return False
        display = _display_size(size, pixel_aspect)
        content = _with_display(file, entry.track, entry.video, display)
        if content is None:
            return _state_behind_void(file, entry, display)
        file.seek(entry.track.element.content)
        file.write(content)
        _renew_checksum(file, entry.tracks)
    return True


def _state_in_avi(file: IO[bytes], size: tuple[int, int], pixel_aspect: Fraction) -> bool:
    """Put the video properties header in front of the padding of the stream's headers."""
    height, width = size
    frame_aspect = Fraction(width, height) * pixel_aspect
    junk = _padding_of_stream(file)
    is_small = max(frame_aspect.numerator, frame_aspect.denominator) <= _MOST_RATIO
    if junk is None or not is_small:
        return False
    place, length = junk
    ratio = frame_aspect.denominator, frame_aspect.numerator
    field = (height, width, height, width, 0, 0, 0, 0)
    # Format, standard and rate are not stated; one field makes a frame.
    properties = _PROPERTIES_LAYOUT.pack(0, 0, 0, width, height, *ratio, width, height, 1, *field)
    chunk = _PROPERTIES + struct.pack("<I", len(properties)) + properties
    if length < len(chunk):
        return False
    file.seek(place)
    file.write(chunk + _JUNK + struct.pack("<I", length - len(chunk)))
    return True


def _padding_of_stream(file: IO[bytes]) -> tuple[int, int] | None:
    """Where the padding of the first stream's headers begins, and its length."""
    start, end = 12, 1 << 16
    lists = [_HEADER_LIST, _STREAM_LIST]
    while start < end:
        head = _bytes_of(file, start, start + 12)
        if len(head) < 12:
            return None
        length = int.from_bytes(head[4:8], "little")
        if head[:4] == _JUNK and not lists:
            return start, length
        if head[:4] == b"LIST" and lists and head[8:12] == lists[0]:
            lists.pop(0)
            end = start + 8 + length
            start += 12
            continue
        start += 8 + length + length % 2
    return None


def _state_behind_void(file: IO[bytes], entry: _Entry, display: tuple[int, int]) -> bool:
    """State the display size in room that is left in front of the tracks, which move to there."""
    segment, tracks, track, video = entry
    start = segment.element.content
    voids = [
        child for child in _children(file, start, tracks.start) if child.element.identifier == _VOID
    ]
    content = _video_content(file, video)
    stated = _stated(display, None)
    assert stated is not None
    moved = len(content) + len(stated) - (video.end - video.element.content)
    if not voids or (voids[-1].element.length or 0) < moved:
        return False
    void = voids[-1]
    new_video = _resized(video, content + stated)
    new_track = _resized(track, _replaced(file, track, video, new_video))
    new_tracks = _resized(tracks, _replaced(file, tracks, track, new_track))
    new_void = _resized(void, bytes((void.element.length or 0) - moved))
    between = _bytes_of(file, void.end, tracks.start)
    moved_content = new_void + between + new_tracks
    if len(moved_content) != tracks.end - void.start:  # a length needs more bytes
        return False
    file.seek(void.start)
    file.write(moved_content)
    _correct_positions(file, segment, range(void.end - start, tracks.end - start), moved)
    moved_tracks = _child(file, start, tracks.end, _TRACKS)
    if moved_tracks is not None:
        _renew_checksum(file, moved_tracks)
    return True


def _correct_positions(file: IO[bytes], segment: _Child, moved: range, by: int) -> None:
    """Correct what the index of a segment says of parts that moved ahead."""
    index = _child(file, segment.element.content, segment.end, _SEEK_HEAD)
    if index is None:
        return
    for seek in _children(file, index.element.content, index.end):
        position = _child_of(file, seek, _SEEK_POSITION)
        if position is None:
            continue
        field = _bytes_of(file, position.element.content, position.end)
        place = int.from_bytes(field, "big")
        if place in moved:
            file.seek(position.element.content)
            file.write((place - by).to_bytes(len(field), "big"))
    _renew_checksum(file, index)


def _resized(child: _Child, content: bytes) -> bytes:
    """An element with other content, its length in as many bytes as before where these suffice."""
    identifier = child.element.identifier
    width = child.element.content - child.start - len(identifier)
    while len(content) >= (1 << 7 * width) - 1:
        width += 1
    return identifier + (1 << 7 * width | len(content)).to_bytes(width, "big") + content


def _replaced(file: IO[bytes], parent: _Child, child: _Child, new: bytes) -> bytes:
    """The content of an element with another child in place of one."""
    before = _bytes_of(file, parent.element.content, child.start)
    return before + new + _bytes_of(file, child.end, parent.end)


def _display_size(size: tuple[int, int], pixel_aspect: Fraction) -> tuple[int, int]:
    """Width and height in whole numbers whose ratio is exact, and about the size of the video."""
    height, width = size
    ratio = width * pixel_aspect / height
    times = math.ceil(Fraction(height, ratio.denominator))
    return ratio.numerator * times, ratio.denominator * times


def _entry_of_video(file: IO[bytes]) -> _Entry | None:
    header = element_at(file, 0)
    if header is None or header.length is None:
        return None
    segment_start = header.content + header.length
    element = element_at(file, segment_start)
    if element is None or element.identifier != SEGMENT or element.length is None:
        return None
    end = element.content + element.length
    tracks = _child(file, element.content, end, _TRACKS)
    track = _child_of(file, tracks, _TRACK_ENTRY)
    video = _child_of(file, track, _VIDEO)
    if tracks is None or track is None or video is None:
        return None
    return _Entry(_Child(element, segment_start, end), tracks, track, video)


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
    video_content = _video_content(file, video)
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


def _video_content(file: IO[bytes], video: _Child) -> bytes:
    """What a track says of its images, without the size at which they are shown."""
    # FFmpeg states an unknown unit; without a unit, both numbers are pixels.
    return b"".join(
        _bytes_of(file, child.start, child.end)
        for child in _children(file, video.element.content, video.end)
        if child.element.identifier not in (_DISPLAY_UNIT, _DISPLAY_WIDTH, _DISPLAY_HEIGHT)
    )


def _stated(display: tuple[int, int], room: int | None) -> bytes | None:
    """Both numbers as elements that leave nothing of the room, or enough for an element.

    room: bytes; None: as many as it takes.
    """
    width, height = display
    for width_bytes in range(_least_bytes(width), 9):
        stated = _number(_DISPLAY_WIDTH, width, width_bytes)
        stated += _number(_DISPLAY_HEIGHT, height, _least_bytes(height))
        rest = 0 if room is None else room - len(stated)
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
