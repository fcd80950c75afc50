"""Animations: GIF, WebP and PNG files of several frames, whole or cut short.

Each format is a row of parts that say how long they are.  What ends within a frame is closed behind
the last whole one before a library reads it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO

import numpy as np
from PIL import Image

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from .base import (
    WITHOUT_ALPHA,
    Ended,
    Recording,
    SonarFrame,
    ask_bytes,
    ask_pixels,
    explained,
    swapped,
    untinted,
)

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEAD_BYTES = 4096  # within which a PNG says that it is animated
_GIF_HEADS = (b"GIF87a", b"GIF89a")
_EXTENSION = 0x21
_IMAGE = 0x2C
_END = 0x3B
_USUAL_DURATION_S = 0.1  # where a file states none, as browsers do


@dataclass(frozen=True)
class _Whole:
    """The whole frames of a file.

    count: how many.  end: where the last one ends.  is_cut: whether the file ends within another.
    """

    count: int
    end: int
    is_cut: bool


def is_animated(path: Path) -> bool:
    """Whether a .png or .webp file says that it holds several frames."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return False
    if head.startswith(PNG_SIGNATURE):
        return b"acTL" in head.partition(b"IDAT")[0]
    has_features = head[:4] == b"RIFF" and head[8:16] == b"WEBPVP8X"
    return has_features and len(head) > 20 and bool(head[20] & 2)


class Animation(Recording):
    """A `Recording` of the frames of a GIF, WebP or PNG file: (H, W), or (H, W, 3) BGR.

    is_grey: whether the file can hold grey alone.  loops: how often it is played; 0: for ever.
    """

    def _open(self) -> None:
        assert self._file is not None
        name = str(self.path)
        head = self.bytes_at(0, min(self.size, 32), "its first bytes")
        whole = self._whole(head)
        if whole.count < 1:
            raise FrameError(
                f"{name}: ends within its first frame; the file is cut short or damaged"
            )
        self._file.seek(0)
        source: IO[bytes] = self._file
        if whole.is_cut:
            source = BytesIO(_closed(self._file.read(whole.end), whole.count))
            self.warning = f"{name}: is cut short; its {whole.count} whole frames are read"
        with explained(f"{name}: not a readable image"):
            self._image = Image.open(source, formats=("GIF", "WEBP", "PNG"))
            self.count = int(getattr(self._image, "n_frames", 1))
        width, height = self._image.size
        ask_pixels(name, width, height)
        ask_bytes(name, self.count * width * height * 3, self.size, streamed=True)
        if self._image.format == "PNG" and head[24] == 16 and head[25] != 0:
            raise FrameError(
                f"{name}: animated colours of 16 bits cannot be read; save the frames as PNG files"
            )
        self.is_grey = self._image.mode in ("L", "I;16", "1")
        if self._image.has_transparency_data and not self.warning:
            self.warning = f"{name}: {WITHOUT_ALPHA}"
        self.loops = int(self._image.info.get("loop", 0))

    def _whole(self, head: bytes) -> _Whole:
        assert self._file is not None
        if head[:6] in _GIF_HEADS:
            return _frames_of_gif(self._file, self.size)
        if head.startswith(PNG_SIGNATURE):
            return _frames_of_png(self._file)
        if head[:4] == b"RIFF" and head[8:12] == b"WEBP":
            return _frames_of_webp(self._file)
        raise FrameError(f"{self.path}: not a readable image (no GIF, WebP or PNG)")

    def _read(self, number: int) -> SonarFrame:
        name = f"{self.path}: frame {number}"
        try:
            with explained(f"{name} cannot be read", passing=EOFError):
                self._image.seek(number)
                image = self._image.copy()
        except EOFError as error:
            raise Ended(f"{name} cannot be read") from error
        duration_s = float(image.info.get("duration", 0) or 0) / 1000 or _USUAL_DURATION_S
        return SonarFrame(number, _samples_of(image), duration_s=duration_s)


def _samples_of(image: Image.Image) -> Array:
    if image.mode == "I;16":
        return np.array(image, np.uint16)
    if image.mode == "L":
        return np.array(image, np.uint8)
    return untinted(np.ascontiguousarray(swapped(np.asarray(image.convert("RGB")))))


def _frames_of_gif(file: IO[bytes], size: int) -> _Whole:
    """GIF89a: blocks; an image is a descriptor, perhaps colours, and pieces of data."""
    file.seek(10)
    packed = file.read(3)
    if len(packed) < 3:
        return _Whole(0, 0, True)
    file.seek(13 + _colour_bytes(packed[0]))
    count = 0
    end = file.tell()
    while True:
        kind = file.read(1)
        if not kind:
            return _Whole(count, end, True)
        if kind[0] == _END:
            return _Whole(count, end, False)
        if kind[0] == _EXTENSION:
            file.seek(1, 1)
        elif kind[0] == _IMAGE:
            descriptor = file.read(9)
            if len(descriptor) < 9:
                return _Whole(count, end, True)
            file.seek(_colour_bytes(descriptor[8]) + 1, 1)
        else:  # what follows is damaged, or no part of the animation
            return _Whole(count, end, count == 0)
        if not _skips_pieces(file, size):
            return _Whole(count, end, True)
        if kind[0] == _IMAGE:
            count = count + 1
            end = file.tell()


def _colour_bytes(packed: int) -> int:
    """Bytes of the table of colours that a packed field announces."""
    return 3 << (packed & 7) + 1 if packed & 0x80 else 0


def _skips_pieces(file: IO[bytes], size: int) -> bool:
    """Moves behind pieces of data; False where the file ends within them."""
    while True:
        length = file.read(1)
        if not length:
            return False
        file.seek(length[0], 1)
        if file.tell() > size:
            return False
        if length[0] == 0:
            return True


def _chunks_of_png(file: IO[bytes]) -> Iterator[tuple[bytes, int, int]]:
    """Kind, start and end of each whole chunk."""
    offset = len(PNG_SIGNATURE)
    file.seek(0, 2)
    size = file.tell()
    while True:
        file.seek(offset)
        header = file.read(8)
        if len(header) < 8:
            return
        end = offset + 12 + int.from_bytes(header[:4], "big")
        if end > size:
            return
        yield header[4:], offset, end
        offset = end


def _frames_of_png(file: IO[bytes]) -> _Whole:
    """A frame of an animated PNG is whole where another one, or the end, follows."""
    count = end = 0
    is_begun = False
    for kind, start, _ in _chunks_of_png(file):
        if kind not in (b"fcTL", b"IEND"):
            continue
        if is_begun:
            count = count + 1
            end = start
        if kind == b"IEND":
            return _Whole(count, end, False)
        is_begun = True
    return _Whole(count, end, True)


def _frames_of_webp(file: IO[bytes]) -> _Whole:
    """Chunks of a RIFF file, each padded to an even length."""
    file.seek(0, 2)
    size = file.tell()
    offset = 12
    file.seek(4)
    stated = 8 + int.from_bytes(file.read(4), "little")
    count = end = 0
    while offset + 8 <= min(size, stated):
        file.seek(offset)
        header = file.read(8)
        after = offset + 8 + (int.from_bytes(header[4:], "little") + 1) // 2 * 2
        if after > size:
            return _Whole(count, end, True)
        if header[:4] == b"ANMF":
            count = count + 1
            end = after
        offset = after
    return _Whole(count, end, stated > size)


def _closed(content: bytes, count: int) -> bytes:
    """The first bytes of a file, up to the end of a frame, as a file of this many frames."""
    if content.startswith(b"RIFF"):
        return content[:4] + struct.pack("<I", len(content) - 8) + content[8:]
    if not content.startswith(PNG_SIGNATURE):
        return content + bytes([_END])
    place = content.index(b"acTL")
    control = struct.pack(">I", count) + content[place + 8 : place + 12]
    return (
        content[: place - 4]
        + png_chunk(b"acTL", control)
        + content[place + 16 :]
        + png_chunk(b"IEND", b"")
    )


def png_chunk(kind: bytes, content: bytes) -> bytes:
    """A chunk of a PNG file with its length and checksum."""
    checksum = struct.pack(">I", zlib.crc32(kind + content))
    return struct.pack(">I", len(content)) + kind + content + checksum
