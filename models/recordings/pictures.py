"""Picture files, one or a folder of them by name, files of pages (TIFF, animated GIF), and videos.

A video is opened only where its first bytes are those of a container for films: FFmpeg goes by the
content, and would take a playlist named `a.avi` for a list of other files and addresses to open.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt
from PIL import Image

from ...factory.errors import FactoryError, FrameError
from ...factory.quiet import quiet_stderr
from .arrays import ArrayFile, is_table
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
        with explained(f"{path}: not a readable array"), ArrayFile(path) as array:
            return array[0].samples
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
                return _untinted(swapped(np.asarray(self._image.convert("RGB"))))
            if size == self._first and mode in _PAGES:
                return np.ascontiguousarray(swapped(np.asarray(self._image)))
        raise FrameError(
            f"{self.path}: page {number + 1} has {size[0]} x {size[1]} pixels of kind {mode}, the "
            f"first {self._first[0]} x {self._first[1]}; expected one size and "
            f"{', '.join(_PAGES.values())}"
        )

    def close(self) -> None:
        """See `Recording`."""
        if hasattr(self, "_image"):
            self._image.close()
        super().close()


_MOST_TINT = 6  # of 255: codecs tint grey pictures by a few levels, and by others in each frame
_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")
_MATROSKA = b"\x1a\x45\xdf\xa3"
# Read by OpenCV when it opens a file; only whole files, by the readers of these containers.
_OPTIONS = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_ONLY = "protocol_whitelist;file|format_whitelist;avi,mov,matroska"


class VideoFile(FileOfFrames):
    """A video; a `Recording` of pictures.  Grey ones come as (H, W), others as (H, W, 3) BGR.

    rate_hz: frames a second; None where the file does not say.
    """

    def _open(self) -> None:
        import cv2  # an extra

        if not _is_film(self.bytes_at(0, min(16, self.size), "its first bytes")):
            raise FrameError(f"{self.path}: not a readable video (no AVI, MP4, MOV or Matroska)")
        # An absolute path is never an address, as tcp:127.0.0.1:80.avi is.
        with _only_files(), quiet_stderr():
            self._capture = cv2.VideoCapture(str(self.path.absolute()), cv2.CAP_FFMPEG)
        width = self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)
        height = self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
        count = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        if not (width >= 1 and height >= 1):
            raise FrameError(f"{self.path}: not a readable video")
        ask_pixels(str(self.path), width, height)
        # A frame takes a byte at least, whatever the file says.
        self._count = int(min(max(count, 0), self.size))
        self.rate_hz = rate if 0 < rate < 1e4 else None
        self._next = 0
        if not self._count:
            raise FrameError(f"{self.path}: not a readable video (it has no frames)")

    def __len__(self) -> int:
        return self._count

    def close(self) -> None:
        """See `Recording`."""
        if hasattr(self, "_capture"):
            self._capture.release()
        super().close()

    def __iter__(self) -> Iterator[Frame]:
        """All frames that are there: the number in a video's header is often too large."""
        for number in range(self._count):
            try:
                yield self[number]
            except FrameError:
                if number == 0:
                    raise
                self.warning = f"{self.path}: ends after {number} of {self._count} frames"
                return

    def _read(self, number: int) -> Frame:
        import cv2

        what = f"{self.path}: frame {number} cannot be read"
        with explained(what, reason=True), quiet_stderr():
            if number != self._next:
                self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
            there, picture = self._capture.read()
        self._next = number + 1 if there else -1
        if not there:
            raise FrameError(what)
        time_s = number / self.rate_hz if self.rate_hz else None
        return Frame(number, _untinted(np.asarray(picture, np.uint8)), time_s=time_s)


def _is_film(head: bytes) -> bool:
    """Whether a file begins as AVI, MP4 and MOV, or Matroska and WebM do."""
    if head[:4] == b"RIFF":
        return head[8:12] == b"AVI "
    return head[4:8] in _BOXES or head[:4] == _MATROSKA


@contextmanager
def _only_files() -> Iterator[None]:
    before = os.environ.get(_OPTIONS)
    os.environ[_OPTIONS] = _ONLY
    try:
        yield
    finally:
        os.environ.pop(_OPTIONS)
        if before is not None:
            os.environ[_OPTIONS] = before


def _untinted(picture: Samples) -> Samples:
    """Grey pictures without their three nearly equal channels."""
    import cv2

    middle = picture[..., 1:2].astype(np.int16)
    if np.abs(picture - middle).max() > _MOST_TINT:
        return picture
    return np.ascontiguousarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
