"""TIFF files: images, and stacks of pages, whole or cut short.

tifffile reads the directories, Pillow and OpenCV what it cannot unpack.  Pages that are marked as
smaller copies or masks, and those smaller than the largest one, are no frames.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import cv2
import numpy as np
from PIL import Image

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.quiet import quiet_stderr
from .base import (
    Recording,
    SonarFrame,
    as_samples,
    ask_bytes,
    ask_pixels,
    explained,
    swapped,
    untinted,
)
from .orientation import orientation_of_exif

if TYPE_CHECKING:
    import tifffile

TIFF_HEADS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
DESCRIPTION = 270
_KEPT_TAGS = ("XResolution", "YResolution", "ResolutionUnit")
_UNPACKED = ("NONE", "ADOBE_DEFLATE", "DEFLATE")  # by tifffile without further packages
_SHOWN_MODES = {"1": "L", **dict.fromkeys(("P", "CMYK", "YCbCr", "LAB"), "RGB")}
"""Pillow's mode of pixels that are no grey values or colours -> the mode that they are shown in."""
_SECONDS_OF_UNIT = {
    "": 1.0, "s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "\u00b5s": 1e-6, "min": 60.0, "h": 3600.0,
}  # fmt: skip
_NAMES = {"C": "channel", "Z": "slice", "I": "image"}

Tags = dict[int, bytes | int | tuple[int, int]]
"""Tag -> its text, whole number, or fraction."""

# It writes to the terminal about damage that it passes over.
logging.getLogger("tifffile").setLevel(logging.CRITICAL)


@dataclass(frozen=True)
class PageAxes:
    """The axes along which the pages of a file are counted, the slowest first.

    names: a letter each: T time, C channel, Z slice, I image; others are unknown.  sizes: of each.
    interval_s: between two times; None: unknown.
    """

    names: str = "T"
    sizes: tuple[int, ...] = (1,)
    interval_s: float | None = None

    def sequence_of(self, page: int) -> str:
        """Which sequence a page belongs to, such as `channel 2`; empty where there is one."""
        time_axis = self._time_axis
        parts = [
            f"{_NAMES.get(name, 'part')} {index + 1}"
            for axis, (name, size, index) in enumerate(
                zip(self.names, self.sizes, np.unravel_index(page, self.sizes), strict=True)
            )
            if axis != time_axis and size > 1
        ]
        return ", ".join(parts)

    def time_s(self, page: int) -> float | None:
        """When a page was taken, seconds since the first; None: unknown."""
        if self.interval_s is None:
            return None
        return int(np.unravel_index(page, self.sizes)[self._time_axis]) * self.interval_s

    @property
    def _time_axis(self) -> int:
        """The axis of time; ImageJ calls it slices where nobody told it better."""
        named = [self.names.find(name) for name in "TZ"]
        varying = [axis for axis in named if axis >= 0 and self.sizes[axis] > 1]
        if varying:
            return varying[0]
        unnamed = [axis for axis, name in enumerate(self.names) if name != "C"]
        return max(unnamed, key=lambda axis: self.sizes[axis], default=0)


@dataclass(frozen=True)
class _Layout:
    """The pages of a file that are images of its largest size.

    numbers: of these pages among all.  count: of whole images.  stated: images that the file says
    it has.  is_cut: whether it ends before its last page.  left_out: pages of other sizes.
    axes: of the images.  first: the first page.
    """

    numbers: tuple[int, ...]
    count: int
    stated: int
    is_cut: bool
    left_out: int
    axes: PageAxes
    first: tifffile.TiffPage

    @property
    def is_contiguous(self) -> bool:
        """Whether images lie one after the other behind a single directory.

        ImageJ writes more than 4 GB so, and tifffile the pixels before the other directories.
        """
        return self.stated > len(self.numbers)


def is_stack(path: Path) -> bool:
    """Whether a TIFF file holds several images of one size, or should."""
    try:
        return _is_stack(path, path.stat().st_mtime_ns)
    except OSError:
        return False


@lru_cache(maxsize=4096)
def _is_stack(path: Path, changed_ns: int) -> bool:
    try:
        with path.open("rb") as file, _opened(file, str(path)) as tiff:
            layout = _layout_of(tiff, path.stat().st_size, most=4)
    except FactoryError:
        return False
    return layout.stated > 1 or layout.is_cut


def read_tiff(path: Path) -> Array:
    """The first image of a file, as `read_image` gives it.  Raises FrameError."""
    name = str(path)
    with path.open("rb") as file, _opened(file, name) as tiff:
        layout = _layout_of(tiff, path.stat().st_size)
        ask_pixels(name, layout.first.imagewidth, layout.first.imagelength)
        return as_samples(_read_page(tiff, path, layout.numbers[0], name), name)


class StackFile(Recording):
    """A TIFF file; a `Recording` of images, (H, W) or (H, W, 3) BGR, one a page.

    Channels are sequences of their own, and so are slices where there are times as well.

    tags: tag -> value, of the description and the resolution, which a copy keeps.
    """

    def _open(self) -> None:
        assert self._file is not None
        name = str(self.path)
        with _opened(self._file, name) as self._tiff:
            layout = self._layout = _layout_of(self._tiff, self.size)
        first = layout.first
        ask_pixels(name, first.imagewidth, first.imagelength)
        self.count = layout.count
        if self.count < 1:
            raise FrameError(
                f"{name}: ends within its first page; the file is cut short or damaged"
            )
        if layout.is_cut or self.count < layout.stated:
            self.warning = f"{name}: is cut short; its {self.count} whole pages are read"
        elif layout.left_out:
            self.warning = (
                f"{name}: {layout.left_out} pages are left out, marked as copies or smaller than "
                f"{first.imagewidth} x {first.imagelength} pixels"
            )
        ask_bytes(name, self.count * first.nbytes, self.size, streamed=True)

    @property
    def tags(self) -> Tags:
        """See the class."""
        first = self._layout.first
        tags: Tags = {
            first.tags[name].code: first.tags[name].value
            for name in _KEPT_TAGS
            if name in first.tags
        }
        # Doubles are written as floats, of which such a text would say too much.
        is_described = first.is_imagej or first.is_shaped or first.is_ome
        if is_described and first.bitspersample < 64 and self.count == self._layout.stated:
            tags[DESCRIPTION] = first.description.encode()
        return tags

    def _read(self, number: int) -> SonarFrame:
        name = f"{self.path}: page {number + 1}"
        if self._layout.is_contiguous:
            page = self._contiguous(number, name)
        else:
            page_number = self._layout.numbers[number]
            page = _read_page(self._tiff, self.path, page_number, name)
        axes = self._layout.axes
        return SonarFrame(
            number,
            as_samples(page, name),
            time_s=axes.time_s(number),
            duration_s=axes.interval_s,
            sequence=axes.sequence_of(number),
        )

    def _contiguous(self, number: int, name: str) -> Array:
        """An image of a file whose images have no directories of their own."""
        first = self._layout.first
        content = self.bytes_at(first.dataoffsets[0] + number * first.nbytes, first.nbytes, name)
        with explained(f"{name}: samples of {first.bitspersample} bits cannot be read"):
            dtype = np.dtype(first.dtype).newbyteorder(self._tiff.byteorder)
            return _upright(np.frombuffer(content, dtype).reshape(first.shape), first)


@contextmanager
def _opened(file: IO[bytes], name: str) -> Iterator[tifffile.TiffFile]:
    with explained(f"{name}: not a readable TIFF; it is damaged or cut short", passing=FrameError):
        file.seek(0)
        # Without the files that its text names.
        import tifffile  # half a unit of the time that a short command takes

        yield tifffile.TiffFile(file, name=name, _multifile=False)


def _layout_of(tiff: tifffile.TiffFile, size: int, most: int | None = None) -> _Layout:
    """The pages of an open file of `size` bytes; with `most` as many as tell whether it is a stack.

    Raises ValueError where there are none.
    """
    sides: dict[tuple[int, int], list[int]] = {}
    ends: list[int] = []
    last: Any = None
    pages: Any = tiff.pages
    for number, page in enumerate(islice(pages, most)):
        last = page
        ends.append(_end_of(page))
        if not (page.is_reduced or page.is_mask):
            sides.setdefault((page.imagelength, page.imagewidth), []).append(number)
    if not sides:
        raise ValueError("no page is an image")
    numbers = sides[max(sides, key=math.prod)]
    first = pages.get(numbers[0])
    is_whole = _next_offset(tiff, last) == 0 or (most is not None and len(ends) == most)
    axes = _axes_of(tiff, first)
    stated = len(numbers)
    if axes is not None and len(numbers) == 1 and first.compression == 1:
        stated = max(stated, math.prod(axes.sizes))
    if stated > len(numbers):
        count = min(stated, max(size - first.dataoffsets[0], 0) // max(first.nbytes, 1))
    else:
        count = next((i for i, number in enumerate(numbers) if ends[number] > size), stated)
    if axes is None or math.prod(axes.sizes) != stated:
        axes = PageAxes("T", (stated,))
    left_out = len(ends) - len(numbers)
    return _Layout(tuple(numbers), count, stated, not is_whole, left_out, axes, first)


def _end_of(page: Any) -> int:
    """Where the last strip or tile of a page ends in the file."""
    parts = zip(page.dataoffsets, page.databytecounts, strict=False)
    return max((offset + count for offset, count in parts), default=0)


def _next_offset(tiff: tifffile.TiffFile, page: Any) -> int:
    """Where the directory behind that of a page lies; 0: it is the last one, as tifffile reads."""
    form = tiff.tiff
    file = tiff.filehandle
    file.seek(page.offset)
    count = int.from_bytes(file.read(form.tagnosize), _ORDERS[form.byteorder])
    file.seek(count * form.tagsize, 1)
    offset = int.from_bytes(file.read(form.offsetsize), _ORDERS[form.byteorder])
    return offset if offset >= file.size else 0


_ORDERS: Any = {"<": "little", ">": "big"}


def _axes_of(tiff: tifffile.TiffFile, first: Any) -> PageAxes | None:
    """The axes that the description of a file states; None where it says nothing of pages."""
    with suppress(Exception):  # the text may be damaged, or of any program
        if first.is_imagej and tiff.imagej_metadata is not None:
            return _axes_of_imagej(tiff.imagej_metadata)
        if first.is_shaped and tiff.shaped_metadata:
            return _axes_of_shape(tiff.shaped_metadata[0], first.shape)
        if first.is_ome:
            return _axes_of_ome(tiff, first.description)
    return None


def _axes_of_imagej(values: dict[str, Any]) -> PageAxes:
    images = int(values.get("images", 1))
    sizes = [int(values.get(name, 1)) for name in ("frames", "slices", "channels")]
    if math.prod(sizes) != images:
        sizes = [images, 1, 1]
    interval_s = _seconds(values.get("finterval", 0), str(values.get("tunit", "")))
    rate_hz = float(values.get("fps", 0))
    if interval_s is None and rate_hz > 0:
        interval_s = 1 / rate_hz
    return PageAxes("TZC", tuple(sizes), interval_s)


def _axes_of_shape(values: dict[str, Any], page_shape: tuple[int, ...]) -> PageAxes | None:
    """The axes of the pages by the JSON of tifffile; None where it does not fit the pages."""
    shape = [int(side) for side in values["shape"]]
    sides = list(page_shape)
    if shape[-1] == 1 and sides[-1] != 1:
        sides.append(1)
    count = len(shape) - len(sides)
    if count < 0 or shape[count:] != sides:
        return None
    names = str(values.get("axes", ""))[:count]
    return PageAxes(names if len(names) == count else "Q" * count, tuple(shape[:count]))


def _axes_of_ome(tiff: tifffile.TiffFile, text: str) -> PageAxes:
    series = tiff.series
    pairs = zip(series[0].axes, series[0].shape, strict=True)
    counted = [(name, size) for name, size in pairs if name not in "YXS"]
    if len(series) > 1:  # one behind the other
        counted.insert(0, ("I", len(series)))
    interval = re.search(r'TimeIncrement="([\d.eE+-]+)"', text)
    unit = re.search(r'TimeIncrementUnit="([^"]+)"', text)
    interval_s = _seconds(interval[1] if interval else 0, unit[1] if unit else "s")
    names = "".join(name for name, _ in counted)
    return PageAxes(names or "T", tuple(size for _, size in counted) or (1,), interval_s)


def _seconds(number: Any, unit: str) -> float | None:
    """An interval in seconds; None where it is none."""
    seconds = float(number) * _SECONDS_OF_UNIT.get(unit, 0.0)
    return seconds if 0 < seconds < math.inf else None


def _read_page(tiff: tifffile.TiffFile, path: Path, number: int, name: str) -> Array:
    """A page, upright, (H, W) or (H, W, C) BGR, black as 0.  Raises FrameError."""
    with explained(f"{name}: cannot be read", reason=True), quiet_stderr():
        page: Any = tiff.pages.get(number)
        is_plain = page.photometric <= 2 and page.bitspersample >= 8
        if is_plain and page.compression.name in _UNPACKED:
            return _upright(np.asarray(page.asarray()), page)
        if page.bitspersample > 8 and page.samplesperpixel > 1:  # Pillow has 8 bits a colour alone
            _, pages = cv2.imreadmulti(str(path), number, 1, flags=cv2.IMREAD_UNCHANGED)
            return np.asarray(pages[0])
        with Image.open(path, formats=("TIFF",)) as image:
            image.seek(number)
            is_palette = image.mode == "P"
            shown = image.convert(_SHOWN_MODES.get(image.mode, image.mode))
            pixels = np.ascontiguousarray(swapped(np.asarray(shown)))
        # Pillow turns pages upright, and inverts those of 8 bits.
        if page.photometric == 0 and pixels.dtype != np.uint8:
            pixels = _inverted(pixels)
        return untinted(pixels) if is_palette else pixels


def _upright(pixels: Array, page: Any) -> Array:
    """The pixels of a page as stored, upright, blue first and with black as 0."""
    if page.photometric == 0:
        pixels = _inverted(pixels)
    if page.axes.startswith("S"):  # a plane for each colour
        pixels = np.moveaxis(pixels, 0, -1)
    tag = page.tags.get("Orientation")
    upright = orientation_of_exif(1 if tag is None else int(tag.value)).upright(pixels)
    return np.ascontiguousarray(swapped(upright))


def _inverted(page: Array) -> Array:
    """A page in which 0 is white as one in which it is black; floats are in 0..1."""
    white = np.iinfo(page.dtype).max if page.dtype.kind == "u" else page.dtype.type(1)
    return np.asarray(white - page, page.dtype)
