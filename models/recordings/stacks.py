"""TIFF files of several pages, and those that hold several images behind one directory."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import cv2
import numpy as np
from PIL import Image

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
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
from .images import read_page, with_white_zero
from .page_axes import PageAxes
from .tiff import (
    BITS,
    DESCRIPTION,
    PHOTOMETRIC,
    RESOLUTION_UNIT,
    SAMPLES,
    STRIP_OFFSETS,
    WHITE_IS_ZERO,
    X_RESOLUTION,
    Y_RESOLUTION,
    Directory,
    Tags,
    directories_of,
)


def is_stack(path: Path) -> bool:
    """Whether a TIFF file holds several images of one size, or should."""
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            directories, is_cut = directories_of(file, size, most=2)
    except OSError:
        return False
    if not directories:
        return False
    if len(directories) == 1:
        return is_cut or directories[0].images_behind > 1
    return directories[1].size == directories[0].size


class StackFile(Recording):
    """A TIFF file; a `Recording` of images, (H, W) or (H, W, 3) BGR, one a page.

    ImageJ and tifffile may write one directory, and the images behind each other without
    compression; then as many are read as are there.  Channels are sequences of their own, and so
    are slices where there are times as well (`PageAxes`).

    tags: tag -> value, of the description and the resolution, which a copy keeps.
    """

    def _open(self) -> None:
        assert self._file is not None
        name = str(self.path)
        directories, is_cut = directories_of(self._file, self.size)
        if not directories:
            raise FrameError(f"{name}: not a readable TIFF; it is damaged or cut short")
        first = directories[0]
        ask_pixels(name, *first.size)
        self._first = first
        self._is_contiguous = first.images_behind > len(directories)
        stated = max(first.images_behind, len(directories))
        self.count = self._whole_images(directories)
        if self.count < 1:
            raise FrameError(
                f"{name}: ends within its first page; the file is cut short or damaged"
            )
        if is_cut or self.count < stated:
            self.warning = f"{name}: is cut short; its {self.count} whole pages are read"
        ask_bytes(name, self.count * first.page_bytes, self.size, streamed=True)
        axes = first.axes
        is_stated = axes is not None and axes.page_count == stated
        self._axes = axes if axes is not None and is_stated else PageAxes("T", (self.count,))
        # Pillow has 8 bits a colour alone.
        self._is_deep = first.number(SAMPLES, 1) >= 3 and first.number(BITS, 8) > 8
        is_for_pillow = not self._is_contiguous and not self._is_deep
        self._image = _opened(self._file) if is_for_pillow else None

    @property
    def tags(self) -> Tags:
        """See the class."""
        first = self._first
        tags: Tags = {}
        for tag in (X_RESOLUTION, Y_RESOLUTION):
            if tag in first.fractions:
                tags[tag] = first.fractions[tag]
        if RESOLUTION_UNIT in first.numbers:
            tags[RESOLUTION_UNIT] = first.number(RESOLUTION_UNIT)
        # Doubles are written as floats, of which such a text would say too much.
        axes = first.axes if first.number(BITS, 8) < 64 else None
        if axes is not None and axes.page_count == self.count:
            tags[DESCRIPTION] = first.text.encode("latin-1")
        return tags

    def _whole_images(self, directories: list[Directory]) -> int:
        if self._is_contiguous:
            (offset, *_) = self._first.numbers[STRIP_OFFSETS]
            page_bytes = max(self._first.page_bytes, 1)
            return min(self._first.images_behind, max(self.size - offset, 0) // page_bytes)
        count = len(directories)
        while count and directories[count - 1].end > self.size:
            count -= 1
        return count

    def _read(self, number: int) -> SonarFrame:
        name = f"{self.path}: page {number + 1}"
        page = self._contiguous(number, name) if self._is_contiguous else self._page(number, name)
        width, height = self._first.size
        if page.shape[:2] not in ((height, width), (width, height)):
            own = " x ".join(str(side) for side in page.shape[1::-1])
            raise FrameError(f"{name} has {own} pixels, the first {width} x {height}")
        samples = as_samples(page, name)
        time_s = self._axes.time_s(number)
        return SonarFrame(
            number,
            samples,
            time_s=time_s,
            duration_s=self._axes.interval_s,
            sequence=self._axes.sequence_of(number),
        )

    def _contiguous(self, number: int, name: str) -> Array:
        """A page of a file whose pages lie behind each other, without directories of their own."""
        first = self._first
        if not first.dtype:
            raise FrameError(f"{name}: samples of {first.number(BITS)} bits cannot be read")
        (offset, *_) = first.numbers[STRIP_OFFSETS]
        content = self.bytes_at(offset + number * first.page_bytes, first.page_bytes, name)
        width, height = first.size
        samples = first.number(SAMPLES, 1)
        page = np.frombuffer(content, first.dtype)
        if first.is_planar:
            page = np.moveaxis(page.reshape(samples, height, width), 0, -1)
        else:
            page = page.reshape(height, width, samples)
        page = page[..., 0] if samples == 1 else page
        if first.number(PHOTOMETRIC, 1) == WHITE_IS_ZERO and page.dtype.kind in "uf":
            page = with_white_zero(page)
        # The most significant byte may come first.
        return np.ascontiguousarray(swapped(page))

    def _page(self, number: int, name: str) -> Array:
        if self._is_deep and self._first.is_planar:
            return read_page(self.path, name, number)
        if self._image is None:
            page = self._by_opencv(number, name)
            return with_white_zero(page) if self._first.is_white_zero else page
        with explained(f"{name} cannot be read"), quiet_stderr():
            self._image.seek(number)
            is_palette = self._image.mode == "P"
            image = self._image.copy()
            page = np.asarray(image.convert("RGB") if is_palette else image)
        page = np.ascontiguousarray(swapped(page))
        if self._first.is_white_zero:
            page = with_white_zero(page)
        return untinted(page) if is_palette else page

    def _by_opencv(self, number: int, name: str) -> Array:
        """A page of a kind that Pillow does not know, such as floats of 64 bits."""
        with explained(f"{name} cannot be read"), quiet_stderr():
            path = str(self.path)
            _, pages = cv2.imreadmulti(path, start=number, count=1, flags=cv2.IMREAD_UNCHANGED)
        return np.asarray(pages[0]) if pages else read_page(self.path, name, number)


def _opened(file: IO[bytes]) -> Image.Image | None:
    """The opened TIFF; None for a kind that Pillow does not know."""
    try:
        with explained("not for Pillow"):
            file.seek(0)
            return Image.open(file, formats=("TIFF",))
    except FrameError:
        return None
