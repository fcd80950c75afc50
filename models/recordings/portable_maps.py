"""Portable maps (PGM, PPM) by pnm(5) of Netpbm: what a sample means depends on the largest one.

A camera of 12 bits writes 4095 as the number of white.  OpenCV takes the samples of such a file for
those of 16 bits, which are 16 times as dark.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from .base import FULL_SCALE, PORTABLE_SUFFIXES, ask_pixels, swapped

_SPACE = rb"(?:\s|#[^\n]*\n)+"
_COMMENT = re.compile(rb"#[^\n]*")
_HEADER = re.compile(rb"P([2356])" + 3 * (_SPACE + rb"(\d{1,9})") + rb"\s")
_HEADER_BYTES = 4096
_MOST = 65535


class PortableHeader(NamedTuple):
    """The header of a file.  largest: the sample that is white.  data: where samples begin."""

    is_text: bool
    is_grey: bool
    width: int
    height: int
    largest: int
    data: int


def portable_header(content: bytes) -> PortableHeader | None:
    """The header of a PGM or PPM file; None for other content."""
    match = _HEADER.match(content[:_HEADER_BYTES])
    if match is None:
        return None
    width, height, largest = (int(number) for number in match.groups()[1:])
    if not (width and height and 0 < largest <= _MOST):
        return None
    is_text = match[1] in b"23"
    is_grey = match[1] in b"25"
    return PortableHeader(is_text, is_grey, width, height, largest, match.end())


def white_of_file(path: Path) -> int | None:
    """The sample that is white in a portable map where that is not full scale; None for others."""
    if path.suffix.lower() not in PORTABLE_SUFFIXES:
        return None
    with path.open("rb") as file:
        header = portable_header(file.read(_HEADER_BYTES))
    return None if header is None or header.largest in (255, _MOST) else header.largest


def decode_portable(content: bytes, header: PortableHeader, name: str) -> Array:
    """(H, W) or (H, W, 3) BGR, uint8 or uint16, scaled so that white is full scale.

    Raises FrameError, also for a file of several images, of which other readers show the first.
    """
    ask_pixels(name, header.width, header.height)
    shape = (header.height, header.width) if header.is_grey else (header.height, header.width, 3)
    count = math.prod(shape)
    if header.is_text:
        text = _COMMENT.sub(b"", content[header.data :])
        words = text.split(maxsplit=count)[:count]
        is_whole = len(words) == count and all(word.isdigit() for word in words)
        samples = np.array([int(word) for word in words] if is_whole else [], np.int64)
    else:
        dtype = np.dtype(np.uint8 if header.largest < 256 else ">u2")
        end = header.data + count * dtype.itemsize
        if _HEADER.match(content[end : end + _HEADER_BYTES].lstrip()):
            raise FrameError(f"{name}: holds several images; write each to a file of its own")
        samples = np.frombuffer(content[header.data : end], dtype)
    if len(samples) < count:
        raise FrameError(f"{name}: not a readable image; it is damaged or cut short")
    full = 255 if header.largest < 256 else _MOST
    most = header.largest
    scaled = (np.minimum(samples, most).astype(np.int64) * full + most // 2) // most
    image: Array = scaled.astype(np.uint8 if full == 255 else np.uint16)
    return swapped(image.reshape(shape))


def encode_portable(image: Array, largest: int | None) -> bytes:
    """An image, (H, W) or (H, W, 3) BGR of full scale, as a binary file.

    largest: the sample that is white; None: full scale.
    """
    full = int(FULL_SCALE[str(image.dtype)])
    largest = largest or full
    scaled = (image.astype(np.int64) * largest + full // 2) // full
    scaled = swapped(scaled)
    height, width = image.shape[:2]
    kind = 5 if image.ndim == 2 else 6
    header = f"P{kind}\n{width} {height}\n{largest}\n".encode()
    return header + scaled.astype(np.uint8 if largest < 256 else ">u2").tobytes()
