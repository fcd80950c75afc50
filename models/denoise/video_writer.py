"""Videos without loss: every frame at its own time, in as many bits as the source has.

Containers limit what can be kept.  AVI and Matroska hold FFV1, MP4 and MOV hold PNG, WebM holds
VP9 without loss.  What a container cannot hold becomes Matroska with FFV1 (RFC 9043), which holds
all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from ..recordings.videos import VideoProperties, narrowed


@dataclass(frozen=True, eq=False)
class TimedImage:
    """An image of a sequence, (H, W) or (H, W, 3) BGR, and when it is shown; None: unknown."""

    image: Array
    time_s: float | None = None
    duration_s: float | None = None


@dataclass(frozen=True)
class Codec:
    """A codec without loss.

    grey, colour: bits of a sample -> FFmpeg's name of the pixel format that holds them.
    options: of the encoder; those of FFV1 make the same bytes on any number of threads.
    """

    name: str
    grey: dict[int, str]
    colour: dict[int, str]
    options: dict[str, str]

    def depth_for(self, bits: int) -> int | None:
        """The least depth that holds this many bits; None where none does."""
        return min((depth for depth in self.grey if depth >= bits), default=None)


_BIT_EXACT = {"fflags": "+bitexact"}
"""Without the time of writing and random identifiers: the same images make the same bytes."""
_FULL_RANGE = 2
"""FFmpeg's number of the range in which grey values run from 0 to their largest."""

_FFV1 = Codec(
    "ffv1",
    {8: "gray", 10: "gray10le", 12: "gray12le", 16: "gray16le"},
    {8: "bgr0", 10: "gbrp10le", 12: "gbrp12le", 16: "gbrp16le"},
    {"level": "3", "slices": "4", "slicecrc": "1"},
)
_PNG = Codec("png", {8: "gray", 16: "gray16be"}, {8: "rgb24", 16: "rgb48be"}, {})
_VP9 = Codec(
    "libvpx-vp9",
    {8: "yuv420p"},
    {8: "gbrp"},
    {
        "lossless": "1",
        "lag-in-frames": "0",
        "auto-alt-ref": "0",
        "deadline": "good",
        "cpu-used": "4",
    },
)

CONTAINERS: dict[str, tuple[str, Codec]] = {
    ".avi": ("avi", _FFV1),
    ".mkv": ("matroska", _FFV1),
    ".mov": ("mov", _PNG),
    ".mp4": ("mp4", _PNG),
    ".m4v": ("mp4", _PNG),
    ".webm": ("webm", _VP9),
}
"""Suffix -> FFmpeg's name of the container, and the codec that is written into it."""
FALLBACK = ".mkv"
_EQUAL_TIMES = ("matroska",)


def target_of(path: Path, video: VideoProperties) -> tuple[Path, str]:
    """The file that can hold a video, and a line that says why it is not `path`; mostly empty."""
    container = CONTAINERS.get(path.suffix.lower())
    if container is not None and container[1].depth_for(video.bits) is not None:
        return path, ""
    target = path.with_name(path.name + FALLBACK)
    if container is None:
        return target, f"{path}: no codec without loss fits {path.suffix}; written as {target.name}"
    most = max(container[1].grey)
    return target, (
        f"{path}: {path.suffix} holds {most} bits without loss, this video has {video.bits}; "
        f"written as {target.name}"
    )


def write_video(
    file: Path, suffix: str, images: Iterable[TimedImage], video: VideoProperties
) -> str:
    """Write a video without loss; returns what the container cannot state, mostly empty.

    file: to write, whatever its name.  suffix: of the container, one of `CONTAINERS`.
    Raises OSError when it cannot be written, FrameError where the size of the images changes.
    """
    av: Any = import_module("av")
    container, codec = CONTAINERS[suffix]
    # Without the time of writing and random identifiers: the same images make the same bytes.
    with av.open(str(file), "w", format=container, options=_BIT_EXACT) as output:
        output.metadata.update(_texts_for(container, video))
        writer: _StreamWriter | None = None
        for number, timed in enumerate(images):
            if writer is None:
                height, width = timed.image.shape[:2]
                size = height, width
                writer = _StreamWriter(av, output, codec, video, size, output.mux)
            writer.write(number, timed)
        if writer is not None:
            writer.finish()
    return "" if writer is None else _lost_shape(av, file, container, video.pixel_aspect)


def _texts_for(container: str, video: VideoProperties) -> dict[str, str]:
    """The texts of a video; AVI has a date for the time at which it was recorded."""
    texts = dict(video.texts)
    if container == "avi" and "date" not in texts and "creation_time" in texts:
        texts["date"] = texts["creation_time"]
    return texts


def _lost_shape(av: Any, file: Path, container: str, aspect: Fraction) -> str:
    """A line where a written file does not state the shape of its pixels; mostly empty."""
    if aspect == 1:
        return ""
    with av.open(str(file), format=container) as written:
        stated = written.streams.video[0].sample_aspect_ratio or 1
    if stated == aspect:
        return ""
    return (
        f"the shape of its pixels ({aspect.numerator}:{aspect.denominator}, width by height) is "
        f"lost: {container} does not state it for this codec"
    )


class _StreamWriter:
    """The stream of a video that is being written.

    size: height and width of its images.
    """

    def __init__(
        self,
        av: Any,
        output: Any,
        codec: Codec,
        video: VideoProperties,
        size: tuple[int, int],
        emit: Callable[[Any], None],
    ) -> None:
        """size: (H, W) of the images.  emit: gets each packet."""
        self._av = av
        self._emit = emit
        self._video = video
        self._depth = codec.depth_for(video.bits) or max(codec.grey)
        self._format = (codec.grey if video.is_grey else codec.colour)[self._depth]
        self.size = size
        # The frame rate of an AVI file is the unit of its time stamps.
        is_avi = output.format.name == "avi"
        rate = 1 / video.time_base_s if is_avi else video.rate
        stream = output.add_stream(codec.name, rate=rate)
        stream.height, stream.width = self.size
        stream.pix_fmt = self._format
        if video.pixel_aspect != 1:
            stream.codec_context.sample_aspect_ratio = video.pixel_aspect
        stream.options = dict(codec.options)
        if self._format.startswith("yuv"):
            stream.codec_context.color_range = _FULL_RANGE
        stream.time_base = stream.codec_context.time_base = video.time_base_s
        self.stream = stream
        # Matroska alone may show two frames at one time.
        self._least_step = 0 if output.format.name in _EQUAL_TIMES else 1
        self.last_tick = -self._least_step
        self._durations: dict[int, int] = {}

    def write(self, number: int, timed: TimedImage) -> None:
        if timed.image.shape[:2] != self.size:
            height, width = timed.image.shape[:2]
            raise FrameError(
                f"frame {number} has {width} x {height} pixels, the first {self.size[1]} x "
                f"{self.size[0]}; a video has one size, so cut it before frame {number}"
            )
        frame = self._frame(timed.image)
        frame.pts = self._tick(number, timed)
        frame.time_base = self._video.time_base_s
        duration_s = timed.duration_s or float(1 / self._video.rate)
        self._durations[frame.pts] = max(1, self._ticks(duration_s))
        self._mux(self.stream.encode(frame))

    def finish(self) -> None:
        self._mux(self.stream.encode(None))

    def _mux(self, packets: Iterable[Any]) -> None:
        for packet in packets:
            # Encoders forget how long a frame lasts, of which the last one tells the video's end.
            packet.duration = self._durations.pop(packet.pts, 1)
            self._emit(packet)

    def _ticks(self, seconds: float) -> int:
        return round(seconds / float(self._video.time_base_s))

    def _tick(self, number: int, timed: TimedImage) -> int:
        """When a frame is shown, in units of the time base; not before the one before."""
        time_s = timed.time_s
        if time_s is None:
            time_s = number / float(self._video.rate)
        tick = self._ticks(self._video.start_s + time_s)
        self.last_tick = max(tick, self.last_tick + self._least_step)
        return self.last_tick

    def _frame(self, image: Array) -> Any:
        """The frame of an image, in the pixel format of the stream."""
        if image.dtype != np.uint8:
            image = narrowed(image, self._depth)
        if self._format.startswith("yuv"):
            height, width = self.size
            chroma = np.full(((height + 1) // 2, (width + 1) // 2), 1 << (self._depth - 1))
            return self._of_planes([image, chroma, chroma])
        if self._video.is_grey:
            little_endian = "gray" if self._depth == 8 else f"gray{self._depth}le"
            return self._av.VideoFrame.from_ndarray(image, format=little_endian)
        if image.ndim == 2:
            image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        if self._format.startswith("gbr"):
            return self._of_planes([image[..., channel] for channel in (1, 0, 2)])
        if self._depth == 8:
            return self._av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
        red_first = np.ascontiguousarray(image[..., ::-1])
        return self._av.VideoFrame.from_ndarray(red_first, format="rgb48le")

    def _of_planes(self, planes: list[Array]) -> Any:
        height, width = self.size
        frame = self._av.VideoFrame(width, height, self._format)
        dtype = np.dtype(np.uint8 if self._depth == 8 else "<u2")
        for plane, values in zip(frame.planes, planes, strict=True):
            rows = np.zeros((plane.height, plane.line_size // dtype.itemsize), dtype)
            rows[:, : values.shape[1]] = values
            plane.update(rows)
        return frame
