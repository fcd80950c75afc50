"""Animations without loss: GIF, WebP and PNG, frame by frame, whatever two frames have in common.

Libraries drop a frame that equals the one before.  Here each frame is encoded as an image of its
own and put into the container.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from PIL import GifImagePlugin
from PIL import Image as PillowImage

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from ..recordings.animations import USUAL_DURATION_S, Animation
from ..recordings.base import swapped
from .video_writer import TimedImage

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_MOST_MS = (1 << 24) - 1
_LOSSLESS = 101  # OpenCV's quality of WebP


def write_animation(
    file: Path, suffix: str, images: Iterable[TimedImage], source: Animation
) -> None:
    """Write frames, (H, W) or (H, W, 3) BGR; of PNG also uint16 of grey.

    GIF holds 256 colours per frame: grey is exact, and colours become the nearest of 256.
    suffix: .gif, .webp, .png or .apng.  Raises OSError, and FrameError where sizes differ.
    """
    writers = {".gif": _write_gif, ".webp": _write_webp, ".png": _write_png, ".apng": _write_png}
    with file.open("w+b") as output:
        writers[suffix](output, _of_one_size(images), source)


def _of_one_size(images: Iterable[TimedImage]) -> Iterator[TimedImage]:
    size: tuple[int, ...] | None = None
    for number, timed in enumerate(images):
        size = size or timed.image.shape[:2]
        if timed.image.shape[:2] != size:
            raise FrameError(
                f"frame {number} has another size than the first; an animation has one"
            )
        yield timed


def _milliseconds(timed: TimedImage) -> int:
    return min(max(1, round(1000 * (timed.duration_s or USUAL_DURATION_S))), _MOST_MS)


def _write_gif(output: IO[bytes], images: Iterable[TimedImage], source: Animation) -> None:
    plugin: Any = GifImagePlugin
    for number, timed in enumerate(images):
        image = _with_palette(timed.image)
        if number == 0:
            header, _ = plugin.getheader(image, info={"loop": source.loops, "optimize": False})
            output.write(b"".join(header))
        blocks = plugin.getdata(image, duration=_milliseconds(timed), include_color_table=True)
        output.write(b"".join(blocks))
    output.write(b";")


def _with_palette(image: Array) -> PillowImage.Image:
    """The image with a palette of all 256 greys, or of the 256 colours nearest to its own."""
    if image.ndim == 2:
        height, width = image.shape
        indexed = PillowImage.frombytes("P", (width, height), image.tobytes())
        indexed.putpalette(bytes(level for level in range(256) for _ in range(3)))
        return indexed
    coloured = PillowImage.fromarray(np.ascontiguousarray(swapped(image)))
    return coloured.quantize(256, dither=PillowImage.Dither.NONE)


def _write_webp(output: IO[bytes], images: Iterable[TimedImage], source: Animation) -> None:
    """The extended format of https://developers.google.com/speed/webp/docs/riff_container."""
    output.write(b"RIFF\0\0\0\0WEBP")
    for number, timed in enumerate(images):
        height, width = timed.image.shape[:2]
        if number == 0:
            animated = 2
            size = _three_bytes(width - 1) + _three_bytes(height - 1)
            _write_riff_chunk(output, b"VP8X", bytes([animated, 0, 0, 0]) + size)
            loops = struct.pack("<H", min(source.loops, 0xFFFF))
            _write_riff_chunk(output, b"ANIM", bytes(4) + loops)
        overwrites = 2  # without blending
        place = (
            _three_bytes(0) + _three_bytes(0) + _three_bytes(width - 1) + _three_bytes(height - 1)
        )
        frame_control = place + _three_bytes(_milliseconds(timed)) + bytes([overwrites])
        _write_riff_chunk(output, b"ANMF", frame_control + _webp_data(timed.image))
    length = output.tell()
    output.seek(4)
    output.write(struct.pack("<I", length - 8))


def _webp_data(image: Array) -> bytes:
    """The chunk with the pixels of a WebP file without loss."""
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    done, content = cv2.imencode(".webp", image, (cv2.IMWRITE_WEBP_QUALITY, _LOSSLESS))
    encoded = content.tobytes()
    place = encoded.find(b"VP8L", 12) if done else -1
    if place < 0:
        raise FrameError("WebP cannot hold these pixels")
    length = int.from_bytes(encoded[place + 4 : place + 8], "little")
    return encoded[place : place + 8 + (length + 1) // 2 * 2]


def _write_riff_chunk(output: IO[bytes], kind: bytes, content: bytes) -> None:
    output.write(kind + struct.pack("<I", len(content)) + content + bytes(len(content) % 2))


def _three_bytes(value: int) -> bytes:
    return struct.pack("<I", value)[:3]


def _write_png(output: IO[bytes], images: Iterable[TimedImage], source: Animation) -> None:
    """Animated PNG of the third edition of the PNG specification (W3C 2025)."""
    output.write(_PNG_SIGNATURE)
    control = sequence = count = 0
    for timed in images:
        image = timed.image
        if image.ndim == 2 and not source.is_grey:
            image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        done, content = cv2.imencode(".png", image)
        assert done
        chunks = list(_png_chunks(content.tobytes()))
        if count == 0:
            output.write(_png_chunk(b"IHDR", chunks[0][1]))
            control = output.tell()
            output.write(_png_chunk(b"acTL", struct.pack(">2I", 0, source.loops)))
        height, width = image.shape[:2]
        place = (width, height, 0, 0)
        frame_control = struct.pack(
            ">5I2H2B", sequence, *place, _milliseconds_16(timed), 1000, 0, 0
        )
        output.write(_png_chunk(b"fcTL", frame_control))
        sequence += 1
        for kind, body in chunks:
            if kind == b"IDAT" and count == 0:
                output.write(_png_chunk(b"IDAT", body))
            elif kind == b"IDAT":
                output.write(_png_chunk(b"fdAT", struct.pack(">I", sequence) + body))
                sequence += 1
        count += 1
    output.write(_png_chunk(b"IEND", b""))
    output.seek(control)
    output.write(_png_chunk(b"acTL", struct.pack(">2I", count, source.loops)))


def _milliseconds_16(timed: TimedImage) -> int:
    return min(_milliseconds(timed), 0xFFFF)


def _png_chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of each chunk of a PNG file."""
    offset = len(_PNG_SIGNATURE)
    while offset < len(content):
        length = int.from_bytes(content[offset : offset + 4], "big")
        yield content[offset + 4 : offset + 8], content[offset + 8 : offset + 8 + length]
        offset += 12 + length


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    """A chunk of a PNG file with its length and checksum."""
    checksum = struct.pack(">I", zlib.crc32(kind + content))
    return struct.pack(">I", len(content)) + kind + content + checksum
