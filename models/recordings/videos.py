"""Videos, decoded by FFmpeg through PyAV: every frame that decodes, with its own time.

A video is opened only where its first bytes are those of a known container, and only by the reader
of that container: FFmpeg goes by the content, and would take a playlist named `a.avi` for a list of
other files and addresses to open.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from ...factory.common.extras import Need, require
from .base import (
    MOST_PIXELS,
    WITHOUT_ALPHA,
    Ended,
    Recording,
    SonarFrame,
    ask_pixels,
    explained,
    untinted,
)
from .orientation import UPRIGHT, Orientation, orientation_of_matrix

_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip", b"pnot")  # of MP4 and MOV
_MATROSKA = b"\x1a\x45\xdf\xa3"
_NEUTRAL = 128  # chroma of grey
_SEEK_BEYOND = 32  # frames ahead up to which decoding them is quicker than seeking
_USUAL_RATE = Fraction(25)  # FFmpeg's, where a file says nothing of its rate


KEPT_TEXTS = (
    *("creation_time", "date", "title", "comment", "description", "artist", "copyright"),
    *("location", "location-eng"),
)
"""Metadata of a container that say what was recorded, when, where and by whom."""


@dataclass(frozen=True)
class VideoProperties:
    """What a copy of a video keeps.

    bits: of a sample as stored.  is_grey: whether its pixels can hold grey alone.
    time_base_s: unit of its time stamps.  rate: mean frames per second.
    start_s: stamp of its first frame.  pixel_aspect: width of a pixel by its height.
    texts: name -> text of the container's metadata, of `KEPT_TEXTS`.
    """

    bits: int
    is_grey: bool
    time_base_s: Fraction
    rate: Fraction
    start_s: float = 0.0
    pixel_aspect: Fraction = Fraction(1)
    texts: Mapping[str, str] = field(default_factory=dict)


@dataclass
class _Reading:
    """What one pass through the file met.

    frames: decoded.  damaged: packets that did not decode.  ended_early: whether the container
    broke off.  end_s: when the last frame ends, in the file's own time.
    """

    frames: int = 0
    damaged: int = 0
    ended_early: bool = False
    end_s: float = 0.0
    stamps: list[int | None] = field(default_factory=list)


class _Timing(NamedTuple):
    """When a frame is shown, and for how long; None: unknown."""

    time_s: float | None
    duration_s: float | None


class VideoFile(Recording):
    """A video; a `Recording` of images.  Grey ones come as (H, W), others as (H, W, 3) BGR.

    Samples of more than 8 bits come as uint16 whose full scale is 65535, whatever their depth.

    rate_hz: mean frames per second; None where the file does not say.
    """

    def _open(self) -> None:
        head = self.bytes_at(0, min(16, self.size), "its first bytes")
        container = container_of(head)
        if container is None:
            raise FrameError(
                f"{self.path}: not a readable video (no AVI, MP4, MOV, Matroska or WebM)"
            )
        require([Need(f"{self.path}", "av")])
        self._av: Any = import_module("av")
        self._container = container
        with self._opened() as (_, stream):
            codec = stream.codec_context
            ask_pixels(str(self.path), codec.width, codec.height)
            rate = stream.average_rate or stream.guessed_rate
            is_rate = bool(rate) and rate > 0
            self.rate_hz = float(rate) if is_rate else None
            self._stated_s = self._duration_s(stream)
            stated = stream.frames or round((self._stated_s or 0) * (self.rate_hz or 0))
            first = self._first_frame(stream)
            self._has_alpha = _has_alpha(first)
            self.properties = VideoProperties(
                bits=max(8, *(component.bits for component in first.format.components)),
                is_grey=_is_grey_format(first.format),
                time_base_s=stream.time_base,
                rate=Fraction(rate) if is_rate else _USUAL_RATE,
                start_s=float((first.pts or 0) * stream.time_base),
                pixel_aspect=_pixel_aspect_of(stream, first),
                texts={
                    name: text
                    for name, text in stream.container.metadata.items()
                    if name.lower() in KEPT_TEXTS
                },
            )
        # A frame takes a byte at least, whatever the file says.
        self.count = min(stated, self.size)
        self._cursor: Iterator[tuple[int, Any]] | None = None
        self._next = 0

    def _is_cut_riff(self) -> bool:
        """Whether a part of an AVI file says to end beyond it, or was never ended.

        Microsoft RIFF; each part is padded to an even length.  FFmpeg estimates the duration.
        """
        end = 0
        while end + 8 <= self.size:
            head = self.bytes_at(end, 8, "a header")
            length = int.from_bytes(head[4:], "little")
            if head[:4] != b"RIFF" or length == 0:
                return head[:4] == b"RIFF"
            end += 8 + length + length % 2
        return end > self.size + 1

    def _duration_s(self, stream: Any) -> float | None:
        """How long the file says that its frames last; None where it does not, or counts sound."""
        if stream.duration:
            seconds: Fraction = stream.duration * stream.time_base
            return float(seconds)
        container = stream.container
        if not container.duration or len(container.streams) > 1:
            return None
        units_a_second: int = self._av.time_base
        return float(container.duration) / units_a_second

    def _first_frame(self, stream: Any) -> Any:
        """Raises FrameError when no frame decodes at all."""
        for frame in self._decoded(stream, _Reading()):
            return frame
        raise FrameError(
            f"{self.path}: not a readable video: no frame decodes (codec "
            f"{stream.codec_context.name}); it is cut short or damaged"
        )

    @contextmanager
    def _opened(self) -> Iterator[tuple[Any, Any]]:
        """The open container and its stream of images."""
        problem = f"{self.path}: not a readable video; it is damaged or cut short"
        if self._container == "mov":
            problem += (
                "; if the recording was not ended, its index (moov) is missing: repair it by the "
                "recorder's own program, or by untrunc"
            )
        with explained(problem):
            # As a file: no name is an address then, as tcp:127.0.0.1:80.avi would be.
            container = self._av.open(
                f"file:{self.path.absolute()}",
                format=self._container,
                options={"protocol_whitelist": "file", "format_whitelist": self._container},
                metadata_errors="replace",
            )
        with container:
            streams = [
                stream
                for stream in container.streams.video
                if not _is_cover(stream) and stream.codec_context is not None
            ]
            if not streams:
                raise FrameError(f"{self.path}: not a readable video: it holds no images")
            streams[0].codec_context.options = {"max_pixels": str(MOST_PIXELS)}
            yield container, streams[0]

    def _decoded(self, stream: Any, reading: _Reading) -> Iterator[Any]:
        """Every frame that decodes from where the stream stands; damaged packets are passed over.

        Keeps in `reading` what it meets.
        """
        errors: Any = self._av.error.FFmpegError
        packets = stream.container.demux(stream)
        while True:
            try:
                packet = next(packets, None)
            except errors:
                reading.ended_early = True
                packet = None
            if packet is not None and packet.is_corrupt:
                continue  # the file ends within it
            try:
                frames = stream.codec_context.decode(packet)
            except EOFError:
                frames = []
            except errors:
                reading.damaged += 1
                frames = []
            for frame in frames:
                self._note(frame, reading)
                yield frame
            if packet is None:
                return

    def _note(self, frame: Any, reading: _Reading) -> None:
        reading.frames += 1
        reading.stamps.append(frame.pts)
        if frame.pts is not None:
            end = (frame.pts + (frame.duration or 0)) * frame.time_base
            reading.end_s = max(reading.end_s, float(end))

    def __len__(self) -> int:
        """How many frames decode: all of them are decoded to know it, once."""
        return len(self._stamps)

    @cached_property
    def _stamps(self) -> list[int | None]:
        """The time stamp of each frame that decodes."""
        reading = _Reading()
        with explained(f"{self.path}: not a readable video", reason=True), self._opened() as opened:
            for _ in self._decoded(opened[1], reading):
                pass
        self.warning = self._warning(reading)
        return reading.stamps

    def __iter__(self) -> Iterator[SonarFrame]:
        """All frames that decode, in order; `warning` says afterwards whether some are missing."""
        yield from self.frames_from(0)

    def frames_from(self, first: int) -> Iterator[SonarFrame]:
        """The frames from number `first` on; earlier ones are decoded, too."""
        reading = _Reading()
        timing: _Timing | None = None
        with self._opened() as (_, stream):
            for number, decoded in enumerate(self._decoded(stream, reading)):
                timing = self._timing(number, decoded, timing)
                if number >= first:
                    yield self._frame(number, decoded, timing)
        self.warning = self._warning(reading)

    def __getitem__(self, number: int) -> SonarFrame:
        """One frame.  Raises IndexError, and FrameError when it cannot be used."""
        if not 0 <= number < len(self):
            raise IndexError(f"{self.path}: frame {number} of {len(self)}")
        return self._read(number)

    def _read(self, number: int) -> SonarFrame:
        is_near = self._next <= number <= self._next + _SEEK_BEYOND
        if self._cursor is None or not is_near:
            self._cursor = self._decoded_from(number)
        for place, decoded in self._cursor:
            self._next = place + 1
            if place == number:
                return self._frame(number, decoded, self._timing(number, decoded, None))
        self._cursor = None
        raise Ended(f"{self.path}: frame {number} cannot be read")

    def _decoded_from(self, number: int) -> Iterator[tuple[int, Any]]:
        """Frames with their numbers from one at or before `number`."""
        stamps = self._stamps
        numbers = {stamp: place for place, stamp in enumerate(stamps) if stamp is not None}
        if number > _SEEK_BEYOND and len(numbers) == len(stamps):
            with self._opened() as (container, stream):
                container.seek(stamps[number], stream=stream, backward=True)
                decoded = self._decoded(stream, _Reading())
                first = next(decoded, None)
                place = None if first is None else numbers.get(first.pts)
                if place is not None and place <= number:
                    yield place, first
                    yield from enumerate(decoded, start=place + 1)
                    return
        with self._opened() as (_, stream):
            yield from enumerate(self._decoded(stream, _Reading()))

    def _frame(self, number: int, decoded: Any, timing: _Timing) -> SonarFrame:
        ask_pixels(str(self.path), decoded.width, decoded.height)
        with explained(f"{self.path}: frame {number} cannot be read", reason=True):
            samples = _orientation_of(decoded).upright(samples_of(decoded))
        return SonarFrame(number, samples, time_s=timing.time_s, duration_s=timing.duration_s)

    def _timing(self, number: int, decoded: Any, before: _Timing | None) -> _Timing:
        """The time of a frame.

        before: that of the previous frame, which dates this one if the file does not.
        """
        time_s: float | None = None
        if decoded.pts is not None:
            time_s = float(decoded.pts * self.properties.time_base_s) - self.properties.start_s
        elif before is not None and before.time_s is not None and before.duration_s:
            time_s = before.time_s + before.duration_s
        elif self.rate_hz:
            time_s = number / self.rate_hz
        duration = float((decoded.duration or 0) * self.properties.time_base_s)
        if not duration and self.rate_hz:
            duration = 1 / self.rate_hz
        return _Timing(time_s, duration or None)

    def _warning(self, reading: _Reading) -> str:
        """What is wrong with the file and what is lost, in one line; mostly empty."""
        problems = [self._damage(reading)]
        if self._has_alpha:
            problems.append(WITHOUT_ALPHA)
        text = "; ".join(filter(None, problems))
        return f"{self.path}: {text}" if text else ""

    def _damage(self, reading: _Reading) -> str:
        whole = f"its {reading.frames} whole frames are read"
        if reading.ended_early or (self._container == "avi" and self._is_cut_riff()):
            return f"is cut short; {whole}"
        if reading.damaged:
            return f"{reading.damaged} damaged frames are left out; {whole}"
        frame_s = 1 / self.rate_hz if self.rate_hz else 0.1
        if self._stated_s is not None and self._stated_s > reading.end_s + 2 * frame_s + 0.01:
            return (
                f"says that it lasts {self._stated_s:.2f} s and ends after "
                f"{reading.end_s:.2f} s; {whole}"
            )
        return ""


def container_of(head: bytes) -> str | None:
    """FFmpeg's name of the reader for a file that begins so; None for no known container."""
    if head[:4] == b"RIFF" and head[8:12] == b"AVI ":
        return "avi"
    if head[4:8] in _BOXES:
        return "mov"
    return "matroska" if head[:4] == _MATROSKA else None


def _is_cover(stream: Any) -> bool:
    """Whether a stream is one still image that belongs to the file, not its video."""
    return "attached_pic" in str(getattr(stream, "disposition", "")).lower()


def _is_grey_format(pixel_format: Any) -> bool:
    return len(pixel_format.components) == 1 and pixel_format.name.startswith(("gray", "mono"))


def _has_alpha(first: Any) -> bool:
    """Whether something of a frame shows what is under it."""
    if not any(component.is_alpha for component in first.format.components):
        return False
    return int(first.to_ndarray(format="rgba")[..., 3].min()) < 255


def _pixel_aspect_of(stream: Any, first: Any) -> Fraction:
    """Width of a pixel by its height, as the file says, of its images turned upright."""
    stated = stream.sample_aspect_ratio
    if not stated or stated <= 0:
        return Fraction(1)
    aspect = Fraction(stated)
    return 1 / aspect if _orientation_of(first).is_transposed else aspect


def _orientation_of(decoded: Any) -> Orientation:
    for data in decoded.side_data:
        if "DISPLAYMATRIX" in str(data.type):
            return orientation_of_matrix(bytes(data))
    return UPRIGHT


def samples_of(decoded: Any) -> Array:
    """(H, W) or (H, W, 3) BGR of a decoded frame; uint16 for more than 8 bits a sample."""
    bits = max(component.bits for component in decoded.format.components)
    if _is_grey_format(decoded.format):
        return _grey_samples(decoded, bits)
    if bits > 8:
        red_first = np.asarray(decoded.to_ndarray(format="rgb48le"), np.uint16)
        return untinted(np.ascontiguousarray(red_first[..., ::-1]))
    luma = _neutral_luma(decoded)
    if luma is not None:
        return luma
    image = decoded.to_ndarray(format="bgr24")
    return untinted(np.asarray(image, np.uint8))


def _grey_samples(decoded: Any, bits: int) -> Array:
    if bits <= 8:
        return np.array(decoded.to_ndarray(format="gray"), np.uint8)
    # Converted to the byte order of this machine.
    name = f"gray{bits}le"
    values = np.array(decoded.to_ndarray(format=name), np.uint16)
    return widened(values, bits)


def _neutral_luma(decoded: Any) -> Array | None:
    """The grey values of a frame whose colour planes say grey throughout; None for others.

    Of full range alone, where they are what is stored.
    """
    is_full = decoded.format.name.startswith("yuvj") or int(decoded.color_range) == 2
    planes = decoded.planes
    if not is_full or len(planes) != 3 or not decoded.format.name.startswith("yuv"):
        return None
    for plane in planes[1:]:
        if (_pixels_of(plane) != _NEUTRAL).any():
            return None
    return _pixels_of(planes[0]).copy()


def _pixels_of(plane: Any) -> Array:
    """(height, width) uint8 of a plane with one byte a pixel."""
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    return rows[: plane.height, : plane.width]


def widened(values: Array, bits: int) -> Array:
    """Samples of this many bits as uint16 of full scale 65535; `narrowed` is the exact inverse."""
    if bits == 16:
        return values
    most = (1 << bits) - 1
    return ((values.astype(np.uint32) * 65535 + most // 2) // most).astype(np.uint16)


def narrowed(samples: Array, bits: int) -> Array:
    """uint16 samples of full scale 65535 as whole numbers of this many bits."""
    if bits == 16:
        return samples
    most = (1 << bits) - 1
    return ((samples.astype(np.uint32) * most + 32767) // 65535).astype(np.uint16)
