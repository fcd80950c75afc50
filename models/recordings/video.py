"""Videos that a sonar's program exported; their frames are pictures, whose fans must be found.

A file is opened only where its first bytes are those of a container for films: FFmpeg goes by the
content, and would take a playlist named `a.avi` for a list of other files and addresses to open.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np

from ...factory.errors import FrameError
from ...factory.quiet import quiet_stderr
from .base import FileOfFrames, Frame, Samples, ask_pixels, explained

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
        what = f"{self.path}: frame {number} cannot be read"
        with explained(what, reason=True), quiet_stderr():
            if number != self._next:
                self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
            there, picture = self._capture.read()
        self._next = number + 1 if there else -1
        if not there:
            raise FrameError(what)
        time_s = number / self.rate_hz if self.rate_hz else None
        return Frame(number, _plain(np.asarray(picture, np.uint8)), time_s=time_s)


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


def _plain(picture: Samples) -> Samples:
    """Grey pictures without their three nearly equal channels."""
    middle = picture[..., 1:2].astype(np.int16)
    if np.abs(picture - middle).max() > _MOST_TINT:
        return picture
    return np.ascontiguousarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
