"""Videos that a sonar's program exported; their frames are pictures, whose fans must be found."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from ...factory.errors import FrameError
from .base import FileOfFrames, Frame, Samples

MOST_PIXELS = 1 << 26
_MOST_TINT = 6  # of 255: codecs tint grey pictures by a few levels, and by others in each frame


class VideoFile(FileOfFrames):
    """A video; a `Recording` of pictures.  Grey ones come as (H, W), others as (H, W, 3) BGR.

    rate_hz: frames a second; None where the file does not say.
    """

    def _open(self) -> None:
        self._capture = cv2.VideoCapture(str(self.path))
        width = self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)
        height = self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
        count = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        if not (width >= 1 and height >= 1 and width * height <= MOST_PIXELS):
            raise FrameError(f"{self.path}: not a readable video")
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
        if number != self._next:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
        try:
            there, picture = self._capture.read()
        except cv2.error as error:
            raise FrameError(f"{self.path}: frame {number} cannot be read ({error.err})") from error
        self._next = number + 1
        if not there:
            self._next = -1
            raise FrameError(f"{self.path}: frame {number} cannot be read")
        time_s = number / self.rate_hz if self.rate_hz else None
        return Frame(number, _plain(np.asarray(picture, np.uint8)), time_s=time_s)


def _plain(picture: Samples) -> Samples:
    """Grey pictures without their three nearly equal channels."""
    middle = picture[..., 1:2].astype(np.int16)
    if np.abs(picture - middle).max() > _MOST_TINT:
        return picture
    return np.ascontiguousarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
