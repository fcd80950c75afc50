"""How the denoised frames of a recording become its file: kept as they come, joined at the end.

Each writer can say how far it is and go on from there, so that no finished frame is denoised again
after an interruption.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.files import explain_os_errors, remove_stale_temporaries, whole_file
from ..recordings import SEQUENCES, Recording, SonarFrame
from ..recordings.base import FULL_SCALE
from ..recordings.videos import VideoFile
from ..recordings.views import fan_of, grey_of
from .spool import Spool
from .unfinished import Unfinished
from .video_writer import TimedImage, VideoPackets, join_packets, target_of
from .writers import write_frames, write_image

State = dict[str, Any]
_PING = re.compile(r"(\d{6})(_polar)?\.png")


class ResultWriter(ABC):
    """Takes the denoised frames of one recording in order.

    path: of the result.
    """

    path: Path

    @abstractmethod
    def add(self, frame: SonarFrame, image: Array) -> None:
        """Keep the next frame.  image: what became of its samples.  Raises FactoryError."""

    @abstractmethod
    def state(self) -> State:
        """What another writer needs to go on from here."""

    @abstractmethod
    def finish(self) -> str:
        """Write the result; returns a line where it is not what was expected, mostly empty."""


def open_result(
    recording: Recording, kind: str, path: Path, unfinished: Unfinished, state: State | None
) -> ResultWriter:
    """The writer of a recording's result.

    kind: of the recording.  path: of the result.  state: of the writer that was interrupted.
    """
    if isinstance(recording, VideoFile):
        return _VideoResult(recording, path, unfinished, state)
    if kind in SEQUENCES or hasattr(recording, "rewrite"):
        return _SpooledResult(recording, kind, path, unfinished, state)
    return _PingImages(path, state)


class _PingImages(ResultWriter):
    """A folder with a fan and the samples of each ping, or its image."""

    def __init__(self, folder: Path, state: State | None) -> None:
        self.path = folder
        self._has_samples = False
        self._count = 0
        if state is not None:
            self._has_samples = state["has_samples"]
            self._count = state["count"]
        remove_stale_temporaries(folder)

    def add(self, frame: SonarFrame, image: Array) -> None:
        name = f"{frame.number:06d}"
        self._count = frame.number + 1
        if frame.beams is None:
            write_image(self.path / f"{name}.png", image)
            return
        self._has_samples = True
        write_image(self.path / f"{name}.png", _fan_image(frame, image))
        write_image(self.path / f"{name}_polar.png", image)

    def state(self) -> State:
        return {"has_samples": self._has_samples, "count": self._count}

    def finish(self) -> str:
        """Remove the images of a longer run before."""
        for path in self.path.glob("*.png"):
            ping = _PING.fullmatch(path.name)
            if ping is None:
                continue
            is_foreign = ping[2] is not None and not self._has_samples
            if int(ping[1]) >= self._count or is_foreign:
                path.unlink()
        return ""


class _SpooledResult(ResultWriter):
    """A file that is written from all samples at once: ARIS, bags, stacks, animations, arrays."""

    def __init__(
        self, recording: Recording, kind: str, path: Path, unfinished: Unfinished,
        state: State | None,
    ) -> None:  # fmt: skip
        self._recording = recording
        self._kind = kind
        self.path = path
        self._spool = _spool_of(unfinished, state)

    def add(self, frame: SonarFrame, image: Array) -> None:
        samples = np.ascontiguousarray(image)
        header = {
            "dtype": str(samples.dtype),
            "shape": samples.shape,
            "time_s": frame.time_s,
            "duration_s": frame.duration_s,
        }
        _append(self._spool, self.path, header, samples.data)

    def state(self) -> State:
        return {"spooled": self._spool.length}

    def finish(self) -> str:
        if self._kind in SEQUENCES:
            return write_frames(self.path, self._images(), self._recording)
        with explain_os_errors(self.path, "--out"):
            self.path.parent.mkdir(parents=True, exist_ok=True)
        rewrite: Any = getattr(self._recording, "rewrite")  # noqa: B009 of .aris and bags
        rewrite((timed.image for timed in self._images()), self.path)
        return ""

    def _images(self) -> Iterator[TimedImage]:
        for header, content in self._spool:
            image = np.frombuffer(content, header["dtype"]).reshape(header["shape"])
            yield TimedImage(image, header["time_s"], header["duration_s"])


class _VideoResult(ResultWriter):
    """A video: frames are encoded as they come, and their packets joined."""

    def __init__(
        self, video: VideoFile, path: Path, unfinished: Unfinished, state: State | None
    ) -> None:
        self._video = video.properties
        self.path, self._note = target_of(path, video.properties)
        self._spool = _spool_of(unfinished, state)
        self._packets = VideoPackets(self.path.suffix.lower(), self._video, self._keep)
        if state is not None:
            self._packets.restore(state["packets"])

    def _keep(self, header: State, content: memoryview) -> None:
        _append(self._spool, self.path, header, content)

    def add(self, frame: SonarFrame, image: Array) -> None:
        self._packets.add(TimedImage(image, frame.time_s, frame.duration_s))

    def state(self) -> State:
        # Encoders keep frames back: what another one goes on from has none in it.
        self._packets.flush()
        return {"packets": self._packets.state(), "spooled": self._spool.length}

    def finish(self) -> str:
        self._packets.flush()
        with whole_file(self.path) as partial:
            lost = join_packets(
                partial, self.path.suffix.lower(), self._spool, self._video, self._packets.size
            )
        return self._note or lost


def _spool_of(unfinished: Unfinished, state: State | None) -> Spool:
    return unfinished.open_spool(0 if state is None else state["spooled"])


def _append(spool: Spool, path: Path, header: State, content: memoryview) -> None:
    with explain_os_errors(path, "--out"):
        spool.append(header, content)


def _fan_image(frame: SonarFrame, samples: Array) -> Array:
    """The fan of a ping's samples, in their dtype."""
    full = FULL_SCALE[str(samples.dtype)]
    fan = view_of(frame, samples)
    return np.rint(fan * full).astype(samples.dtype) if full > 1 else fan


def view_of(frame: SonarFrame, samples: Array) -> Array:
    """Samples of a frame as they are looked at: of a ping a fan, float32 in 0..1."""
    if frame.beams is None:
        return samples
    return fan_of(grey_of(replace(frame, samples=samples)), frame.beams)[0]
