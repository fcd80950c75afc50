"""How the denoised frames of a recording become its file, or a folder of images."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.files import explain_os_errors, remove_stale_temporaries
from ..recordings import SEQUENCES, Recording, SonarFrame
from ..recordings.base import FULL_SCALE
from ..recordings.videos import VideoFile
from ..recordings.views import fan_of, grey_of
from .video_writer import TimedImage, target_of
from .writers import write_frames, write_image

_PING = re.compile(r"(\d{6})(_polar)?\.png")


class ResultFrame(NamedTuple):
    """A frame and what became of its samples."""

    frame: SonarFrame
    image: Array

    @property
    def timed(self) -> TimedImage:
        """The denoised image at the time of the frame."""
        return TimedImage(self.image, self.frame.time_s, self.frame.duration_s)


class Result(NamedTuple):
    """Where a result was written, and a line where it is not what was expected; mostly empty."""

    path: Path
    note: str = ""


def write_result(
    recording: Recording, kind: str, path: Path, frames: Iterable[ResultFrame]
) -> Result:
    """Write the denoised frames of a recording in order.

    kind: of the recording.  path: of the result, which appears once it is whole; of a folder each
    image does.  Raises FactoryError where it cannot be written.
    """
    if kind in SEQUENCES or isinstance(recording, VideoFile):
        note = write_frames(path, (frame.timed for frame in frames), recording)
        if isinstance(recording, VideoFile):
            path = target_of(path, recording.properties)[0]
        return Result(path, note)
    rewrite: Any = getattr(recording, "rewrite", None)  # of .aris and bags
    if rewrite is None:
        _write_pings(path, frames)
        return Result(path)
    with explain_os_errors(path, "--out"):
        path.parent.mkdir(parents=True, exist_ok=True)
    rewrite((frame.image for frame in frames), path)
    return Result(path)


def _write_pings(folder: Path, frames: Iterable[ResultFrame]) -> None:
    """Write a fan and the samples of each ping, or its image; removes those of a longer run."""
    remove_stale_temporaries(folder)
    written = set()
    for frame, image in frames:
        name = f"{frame.number:06d}.png"
        if frame.beams is not None:
            write_image(folder / name, _fan_image(frame, image))
            written.add(name)
            name = f"{frame.number:06d}_polar.png"
        write_image(folder / name, image)
        written.add(name)
    for path in folder.glob("*.png"):
        if _PING.fullmatch(path.name) and path.name not in written:
            path.unlink()


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
