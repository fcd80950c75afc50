"""PGM and PPM files, whose largest sample need not be that of 8 or 16 bits.

A camera of 12 bits writes 4095 as the number of white.  OpenCV takes the samples of such a file for
those of 16 bits, which are 16 times as dark.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from .base import FULL_SCALE, PORTABLE_SUFFIXES, ask_pixels, explained, swapped

_SPACE = rb"(?:\s|#[^\n]*\n)+"
_COMMENT = re.compile(rb"#[^\n]*")
_HEADER = re.compile(rb"P([2356])" + 3 * (_SPACE + rb"(\d{1,9})") + rb"\s")
_HEADER_BYTES = 4096
_DTYPES: dict[int, np.dtype[Any]] = {255: np.dtype(np.uint8), 65535: np.dtype(">u2")}
"""Full scale -> type of the samples of a binary file."""


class PortableHeader(NamedTuple):
    """The header of a file.  largest: the sample that is white.  data: where samples begin."""

    is_text: bool
    is_grey: bool
    width: int
    height: int
    largest: int
    data: int

    @property
    def full(self) -> int:
        """The largest sample that the type of its samples can hold."""
        return 255 if self.largest <= 255 else 65535


def portable_header(content: bytes) -> PortableHeader | None:
    """The header of a PGM or PPM file; None for other content."""
    match = _HEADER.match(content[:_HEADER_BYTES])
    if match is None:
        return None
    width, height, largest = (int(number) for number in match.groups()[1:])
    if not (width and height and 0 < largest <= max(_DTYPES)):
        return None
    return PortableHeader(match[1] in b"23", match[1] in b"25", width, height, largest, match.end())


def white_of_file(path: Path) -> int | None:
    """The sample that is white in a portable map where that is not full scale; None for others."""
    if path.suffix.lower() not in PORTABLE_SUFFIXES:
        return None
    with path.open("rb") as file:
        header = portable_header(file.read(_HEADER_BYTES))
    return None if header is None or header.largest == header.full else header.largest


def decode_portable(content: bytes, header: PortableHeader, name: str) -> Array:
    """(H, W) or (H, W, 3) BGR, uint8 or uint16, scaled so that white is full scale.

    Raises FrameError, also for a file of several images, of which other readers show the first.
    """
    ask_pixels(name, header.width, header.height)
    shape = (header.height, header.width, *(() if header.is_grey else (3,)))
    count = math.prod(shape)
    dtype = _DTYPES[header.full]
    with explained(f"{name}: not a readable image; it is damaged or cut short"):
        if header.is_text:
            words = _COMMENT.sub(b"", content[header.data :]).split(maxsplit=count)
            samples = np.array(words[:count]).astype(np.int64).reshape(shape)
        else:
            samples = np.frombuffer(content, dtype, count, header.data).reshape(shape)
    if not header.is_text:
        rest = content[header.data + samples.nbytes :][:_HEADER_BYTES]
        if _HEADER.match(rest.lstrip()):
            raise FrameError(f"{name}: holds several images; write each to a file of its own")
    most = header.largest
    scaled = (np.clip(samples, 0, most).astype(np.int64) * header.full + most // 2) // most
    return swapped(scaled.astype(dtype))


def encode_portable(image: Array, largest: int | None) -> bytes:
    """An image, (H, W) or (H, W, 3) BGR of full scale, as a binary file.

    largest: the sample that is white; None: full scale.
    """
    full = int(FULL_SCALE[str(image.dtype)])
    most = largest or full
    scaled = swapped((image.astype(np.int64) * most + full // 2) // full)
    height, width = image.shape[:2]
    header = f"P{5 if image.ndim == 2 else 6}\n{width} {height}\n{most}\n"
    dtype = _DTYPES[255 if most <= 255 else 65535]
    return header.encode() + bytes(scaled.astype(dtype).tobytes())
