"""Videos to look at, in any player: H.264 in 8 bits with halved colours, which is lossy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...factory.common.array_types import UInt8s
from ...factory.common.files import whole_file
from .animations import USUAL_DURATION_S

SUFFIX = ".mp4"
_CODECS = ("libopenh264", "libx264", "mpeg4")  # the first that this FFmpeg has
_MOST_WIDTH = 1920
_MOST_HEIGHT = 1080
_TICK_S = Fraction(1, 90_000)
_STEPS_S = (1 / 60, 1.0)  # shortest and longest: a pause of the recorder is no pause of the talk


@contextmanager
def plain_video(path: Path) -> Iterator[PlainVideo]:
    """A video that is at `path` when the block ends without an error.

    Raises FactoryError when it cannot be written.
    """
    av: Any = import_module("av")
    options = {"movflags": "faststart", "fflags": "+bitexact"}
    with (
        whole_file(path) as partial,
        av.open(str(partial), "w", format="mp4", options=options) as output,
    ):
        video = PlainVideo(av, output)
        yield video
        video.finish()


class PlainVideo:
    """A video that is being written; the first image decides its size."""

    def __init__(self, av: Any, output: Any) -> None:
        """output: an open container of PyAV."""
        self._av = av
        self._output = output
        self._stream: Any = None
        self._size = (0, 0)
        self._tick = 0
        self._last_time_s: float | None = None

    def add(self, image: UInt8s, time_s: float | None = None) -> None:
        """The next image, (H, W, 3) uint8, blue first.

        time_s: when it was taken; None: unknown.
        """
        if self._stream is None:
            self._begin(image.shape[0], image.shape[1])
        else:
            self._tick += round(self._step_s(time_s) / _TICK_S)
        self._last_time_s = time_s
        fitted = np.ascontiguousarray(_fitted(image, self._size))
        frame = self._av.VideoFrame.from_ndarray(fitted, format="bgr24").reformat(format="yuv420p")
        frame.pts = self._tick
        frame.time_base = _TICK_S
        self._output.mux(self._stream.encode(frame))

    def finish(self) -> None:
        """Write what the encoder still holds."""
        if self._stream is not None:
            self._output.mux(self._stream.encode(None))

    def _begin(self, height: int, width: int) -> None:
        scale = min(1.0, _MOST_WIDTH / width, _MOST_HEIGHT / height)
        # Halved colours need even sides.
        self._size = _even(scale * height), _even(scale * width)
        name = next(name for name in _CODECS if name in self._av.codecs_available)
        self._stream = self._output.add_stream(name, rate=round(1 / USUAL_DURATION_S))
        self._stream.height, self._stream.width = self._size
        self._stream.pix_fmt = "yuv420p"
        self._stream.time_base = self._stream.codec_context.time_base = _TICK_S
        self._stream.codec_context.thread_count = 1  # the same bytes on any machine
        if name == "libx264":
            self._stream.options = {"crf": "18", "preset": "veryfast"}
        else:
            self._stream.bit_rate = 8_000_000

    def _step_s(self, time_s: float | None) -> float:
        """Time since the image before."""
        if time_s is None or self._last_time_s is None:
            return USUAL_DURATION_S
        shortest, longest = _STEPS_S
        return min(max(time_s - self._last_time_s, shortest), longest)


def _even(side: float) -> int:
    return max(2, 2 * round(side / 2))


def _fitted(image: UInt8s, size: tuple[int, int]) -> UInt8s:
    """(H, W, 3) uint8 scaled into (height, width), black around it."""
    scale = min(size[0] / image.shape[0], size[1] / image.shape[1])
    height, width = (max(1, round(scale * side)) for side in image.shape[:2])
    height, width = min(height, size[0]), min(width, size[1])
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    scaled = cv2.resize(image, (width, height), interpolation=method)
    canvas = np.zeros((*size, 3), np.uint8)
    top, left = (size[0] - height) // 2, (size[1] - width) // 2
    canvas[top : top + height, left : left + width] = scaled
    return canvas
