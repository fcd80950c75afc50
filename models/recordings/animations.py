"""Animations by Pillow: GIF, WebP and PNG files of several frames; GIF and PNG also cut short."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
from PIL import Image, WebPImagePlugin

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

# Pillow loads all of its plugins for a format whose plugin is not there yet.
_FORMATS = ("GIF", WebPImagePlugin.WebPImageFile.format, "PNG")
USUAL_DURATION_S = 0.1  # where a file states none, as browsers do


def is_animated(path: Path) -> bool:
    """Whether a .png or .webp file says that it holds several frames."""
    try:
        with explained("no image"), Image.open(path, formats=_FORMATS) as image:
            return getattr(image, "n_frames", 1) > 1
    except FrameError:
        return False


class Animation(Recording):
    """A `Recording` of the frames of a GIF, WebP or PNG file: (H, W), or (H, W, 3) BGR.

    is_grey: whether the file can hold grey alone.  loops: how often it is played; 0: for ever.
    """

    def _open(self) -> None:
        assert self._file is not None
        name = str(self.path)
        with explained(f"{name}: not a readable image; it is damaged or cut short"):
            self._image = Image.open(self._file, formats=_FORMATS)
            has_alpha = _has_alpha(self._image)
            self.count = self._counted()
        width, height = self._image.size
        ask_pixels(name, width, height)
        ask_bytes(name, self.count * width * height * 3, self.size, streamed=True)
        # Bits of a sample and kind of colours, behind the signature and the size (W3C PNG).
        is_deep = self._image.format == "PNG" and self.bytes_at(24, 2, "its header")[0] == 16
        if is_deep and self._image.mode != "I;16":
            raise FrameError(
                f"{name}: animated colours of 16 bits cannot be read; save the frames as PNG files"
            )
        self.is_grey = self._image.mode in ("L", "I;16", "1")
        self.loops = int(self._image.info.get("loop", 0))
        if not self._is_whole(self.count - 1):
            cut = (number for number in range(self.count) if not self._is_whole(number))
            self.count = next(cut, self.count - 1)
            self.warning = f"{name}: is cut short; its {self.count} whole frames are read"
        elif has_alpha:
            self.warning = f"{name}: {WITHOUT_ALPHA}"
        if self.count < 1:
            raise FrameError(
                f"{name}: ends within its first frame; the file is cut short or damaged"
            )

    def _counted(self) -> int:
        """How many frames begin; Pillow cannot count those of some GIFs that are cut short."""
        with suppress(IndexError):
            return int(getattr(self._image, "n_frames", 1))
        count = 0
        with suppress(IndexError, EOFError):
            while True:
                self._image.seek(count)
                count += 1
        return count

    def _is_whole(self, number: int) -> bool:
        try:
            self._read(number)
        except FrameError:
            return False
        return True

    def _read(self, number: int) -> SonarFrame:
        name = f"{self.path}: frame {number}"
        try:
            with explained(f"{name} cannot be read", passing=EOFError):
                self._image.seek(number)
                image = self._image.copy()
        except EOFError as error:
            raise Ended(f"{name} cannot be read") from error
        duration_s = float(image.info.get("duration", 0) or 0) / 1000 or USUAL_DURATION_S
        return SonarFrame(number, _samples_of(image), duration_s=duration_s)


def _samples_of(image: Image.Image) -> Array:
    if image.mode == "I;16":
        return np.array(image, np.uint16)
    if image.mode == "L":
        return np.array(image, np.uint8)
    return untinted(np.ascontiguousarray(swapped(np.asarray(image.convert("RGB")))))


def _has_alpha(image: Image.Image) -> bool:
    """Whether something of an image shows what is under it."""
    if not image.has_transparency_data:
        return False
    return int(np.asarray(image.convert("RGBA"))[..., 3].min()) < 255
