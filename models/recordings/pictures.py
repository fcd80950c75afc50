"""Picture files, one or a folder of them by name, and files of pages: TIFF and animated GIF."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt
from PIL import Image

from ...factory.errors import FactoryError, FrameError
from ...factory.quiet import quiet_stderr
from .arrays import is_table, read_array
from .base import (
    ARRAY_SUFFIX,
    FULL_SCALE,
    PICTURE_SUFFIXES,
    TOO_LARGE,
    FileOfFrames,
    Frame,
    Recording,
    Samples,
    ask_bytes,
    ask_pixels,
    explained,
    swapped,
)
from .palettes import grey_of_colours

_PAGES = {"L": "grey of 8 bits", "I;16": "of 16 bits", "F": "of floats", "RGB": "colours of 8 bits"}
_FORMATS = ("TIFF", "GIF")


class Pictures(Recording):
    """A `Recording` of pictures as they are stored, (H, W) or (H, W, colours)."""

    def __init__(self, path: Path) -> None:
        """A file, or a folder with files right in it.  Raises FactoryError when there are none."""
        super().__init__(path)
        self.files = [path]
        if path.is_dir():
            found = sorted(path.iterdir())
            self.files = [
                one
                for one in found
                if one.suffix.lower() in PICTURE_SUFFIXES and one.is_file() and not is_table(one)
            ]
        if not self.files or not self.files[0].is_file():
            raise FactoryError(f"{path}: holds no picture ({', '.join(PICTURE_SUFFIXES)})")

    def __len__(self) -> int:
        return len(self.files)

    def _read(self, number: int) -> Frame:
        return Frame(number, read_picture(self.files[number]))


def read_picture(path: Path) -> Samples:
    """The pixels of a file as stored, (H, W) or (H, W, colours).  Raises FrameError; see `decoded`.

    Of a TIFF of several pages, and of an array of several pictures, the first.
    """
    if path.suffix.lower() == ARRAY_SUFFIX:
        return read_array(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path}: not a readable picture ({error.strerror})") from error
    return decoded(content, str(path))


def decoded(content: bytes, what: str) -> Samples:
    """The pixels of a picture file, (H, W) or (H, W, colours).

    what: names it in errors.  Raises FrameError when it cannot be read or is too large.
    """
    import cv2  # an extra

    # Its size first: a small file can decode to gigabytes.
    kinds = ", ".join(FULL_SCALE)
    with _opened(BytesIO(content), what, f"picture of {kinds}") as header:
        ask_pixels(what, *header.size)
    # libjpeg and libtiff write to the terminal about damage that they pass over.
    with explained(f"{what}: not a readable picture"), quiet_stderr():
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise FrameError(f"{what}: not a readable picture")
    if str(picture.dtype) not in FULL_SCALE:
        raise FrameError(f"{what}: pixels are {picture.dtype}; expected {kinds}")
    return np.asarray(picture)


def _opened(
    file: IO[bytes], what: str, kind: str, formats: tuple[str, ...] | None = None
) -> Image.Image:
    """A picture whose pixels are not read yet.  Raises FrameError."""
    with explained(f"{what}: not a readable {kind}"):
        try:
            return Image.open(file, formats=formats)
        except Image.DecompressionBombError as error:
            raise FrameError(f"{what}: {TOO_LARGE}") from error


def in_unit_range(picture: Samples, what: str) -> npt.NDArray[np.float32]:
    """Float32 with full scale 1, of the same shape.  Raises FrameError for floats outside 0..1."""
    scaled = picture.astype(np.float32) / np.float32(FULL_SCALE[str(picture.dtype)])
    if not (scaled.min() >= 0 and scaled.max() <= 1):
        raise FrameError(f"{what}: float pixels must lie in 0..1; divide by full scale")
    return np.asarray(scaled)


def read_grey(path: Path) -> npt.NDArray[np.float32]:
    """(H, W) float32 in 0..1 of a file; of colours see `grey_of_colours`.  Raises FrameError."""
    picture = read_picture(path)
    grey = in_unit_range(picture, str(path))
    return grey if picture.ndim == 2 else grey_of_colours(picture)


def is_stack(path: Path) -> bool:
    """Whether a file is a TIFF whose second page is as large as the first (no smaller copy)."""
    try:
        with explained("no stack"), Image.open(path, formats=_FORMATS[:1]) as image:
            first = image.size
            image.seek(1)
            return image.size == first
    except FrameError:
        return False


class StackFile(FileOfFrames):
    """A TIFF or GIF file; a `Recording` of pictures, (H, W) or (H, W, 3) BGR, one a page."""

    def _open(self) -> None:
        self._image = _opened(self._file, str(self.path), "TIFF or GIF file", _FORMATS)
        with explained(f"{self.path}: not a readable TIFF or GIF file"):
            self._count = int(getattr(self._image, "n_frames", 1))
        width, height = self._first = self._image.size
        ask_pixels(str(self.path), width, height)
        mode = self._image.mode
        wide = 2 if "16" in mode else 4 if mode in ("I", "F") else len(self._image.getbands())
        ask_bytes(str(self.path), self._count * width * height * wide, self.size, streamed=True)

    def __len__(self) -> int:
        return self._count

    def _read(self, number: int) -> Frame:
        page = self._page(number)
        if page.dtype == np.float32:
            in_unit_range(page, f"{self.path}: page {number + 1}")
        return Frame(number, page)

    def _page(self, number: int) -> Samples:
        """A page as it is stored, colours in BGR order.  Raises FrameError."""
        with explained(f"{self.path}: page {number + 1} cannot be read"), quiet_stderr():
            self._image.seek(number)
            # ImageJ writes 16 bits with the most significant byte first.
            size, mode = self._image.size, self._image.mode.replace("I;16B", "I;16")
            if self._image.format == "GIF":
                return _plain(np.asarray(self._image.convert("RGB")))
            if size == self._first and mode in _PAGES:
                return np.ascontiguousarray(swapped(np.asarray(self._image)))
        if size != self._first:
            raise FrameError(
                f"{self.path}: page {number + 1} has {size[0]} x {size[1]} pixels, the first "
                f"{self._first[0]} x {self._first[1]}; split the file"
            )
        raise FrameError(
            f"{self.path}: page {number + 1} is of kind {mode}; expected "
            f"{', '.join(_PAGES.values())}; convert it"
        )

    def close(self) -> None:
        """See `Recording`."""
        if hasattr(self, "_image"):
            self._image.close()
        super().close()


def _plain(colours: Samples) -> Samples:
    """(H, W) of colours that are grey, else (H, W, 3) BGR."""
    grey = (colours == colours[..., :1]).all()
    return np.ascontiguousarray(colours[..., 0] if grey else swapped(colours))
