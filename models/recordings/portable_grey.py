"""Portable grey maps (PGM) by pgm(5) of Netpbm: what a sample means depends on the largest one.

A camera of 12 bits writes 4095 as the number of white.  OpenCV takes the samples of such a file for
those of 16 bits, which are 16 times as dark.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from .base import FULL_SCALE, ask_pixels

_SPACE = rb"(?:\s|#[^\n]*\n)+"
_HEADER = re.compile(rb"P([25])" + 3 * (_SPACE + rb"(\d{1,9})") + rb"\s")
_HEADER_BYTES = 4096
_MOST = 65535


class PortableGreyHeader(NamedTuple):
    """The header of a PGM file.  largest: the sample that is white.  data: where samples begin."""

    is_text: bool
    width: int
    height: int
    largest: int
    data: int


def portable_grey_header(content: bytes) -> PortableGreyHeader | None:
    """The header of a PGM file; None for other content."""
    match = _HEADER.match(content[:_HEADER_BYTES])
    if match is None:
        return None
    width, height, largest = (int(number) for number in match.groups()[1:])
    if not (width and height and 0 < largest <= _MOST):
        return None
    return PortableGreyHeader(match[1] == b"2", width, height, largest, match.end())


def white_of_file(path: Path) -> int | None:
    """The sample that is white in a PGM file where that is not full scale; None for others."""
    if path.suffix.lower() != ".pgm":
        return None
    with path.open("rb") as file:
        header = portable_grey_header(file.read(_HEADER_BYTES))
    return None if header is None or header.largest in (255, _MOST) else header.largest


def decode_portable_grey(content: bytes, header: PortableGreyHeader, name: str) -> Array:
    """(H, W) uint8 or uint16, scaled so that white is full scale.  Raises FrameError."""
    ask_pixels(name, header.width, header.height)
    count = header.width * header.height
    if header.is_text:
        words = content[header.data :].split(maxsplit=count)[:count]
        is_whole = len(words) == count and all(word.isdigit() for word in words)
        samples = np.array([int(word) for word in words] if is_whole else [], np.int64)
    else:
        dtype = np.dtype(np.uint8 if header.largest < 256 else ">u2")
        samples = np.frombuffer(content[header.data :][: count * dtype.itemsize], dtype)
    if len(samples) < count:
        raise FrameError(f"{name}: not a readable image; it is damaged or cut short")
    full = 255 if header.largest < 256 else _MOST
    most = header.largest
    scaled = (np.minimum(samples, most).astype(np.int64) * full + most // 2) // most
    image: Array = scaled.astype(np.uint8 if full == 255 else np.uint16)
    return image.reshape(header.height, header.width)


def encode_portable_grey(image: Array, largest: int) -> bytes:
    """An image, (H, W) of full scale, as a binary PGM file in which `largest` is white."""
    full = int(FULL_SCALE[str(image.dtype)])
    scaled = (image.astype(np.int64) * largest + full // 2) // full
    height, width = image.shape
    header = f"P5\n{width} {height}\n{largest}\n".encode()
    return header + scaled.astype(np.uint8 if largest < 256 else ">u2").tobytes()
