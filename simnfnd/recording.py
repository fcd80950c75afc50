"""Recordings of sonars as an iterator of pictures: `open_recording` of `simnfnd`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

if TYPE_CHECKING:
    from .factory.sonar.geometry import FanGeometry
    from .models.recordings import Frame, Recording


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """One frame of a recording.

    picture: (H, W) float32 in 0..1, a fan with far range on top; or, of a picture or video, its
        pixels as they are stored, (H, W) or (H, W, colours).
    geometry: where range and bearing are in it: as the file says, else as found in the picture
        (range_fraction without metres); None where there is no fan.
    time_s: seconds since 1970 (UTC), or since the start where the file has no clock; None: unknown.
    frame: all that the file says: samples as stored, beams, pose and device.
    """

    picture: npt.NDArray[Any]
    geometry: FanGeometry | None
    time_s: float | None
    frame: Frame


class OpenRecording:
    """An opened recording: iterate, index or measure it; close it, or use it in `with`."""

    def __init__(self, recording: Recording) -> None:
        from .models.recordings.pictures import Pictures

        self._recording = recording
        # Pictures of a folder may have a fan each.
        self._moves = isinstance(recording, Pictures)
        self._found: dict[tuple[int, ...], FanGeometry | None] = {}

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, number: int) -> RecordedFrame:
        """One frame, from 0.  Raises IndexError, and FrameError when it is damaged."""
        return self._shown(self._recording[number])

    def __iter__(self) -> Iterator[RecordedFrame]:
        """All frames in order.  Raises FrameError at one that is damaged."""
        return map(self._shown, self._recording)

    @property
    def warning(self) -> str:
        """What is wrong with the file though its frames can be read; mostly empty."""
        return self._recording.warning

    def close(self) -> None:
        """Let go of the file."""
        self._recording.close()

    def __enter__(self) -> OpenRecording:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _shown(self, frame: Frame) -> RecordedFrame:
        from .models.recordings.views import fan_of, grey_of

        if frame.beams is not None:
            return RecordedFrame(*fan_of(grey_of(frame), frame.beams), frame.time_s, frame)
        from .models.recordings.fan_finder import find_geometry  # of the extra sonar

        # As `simnfnd denoise` does it: a video's fan stays where it was found first.
        shape = frame.samples.shape
        if self._moves or shape not in self._found:
            self._found[shape] = find_geometry(frame.samples)
        return RecordedFrame(frame.samples, self._found[shape], frame.time_s, frame)


def open_recording(path: str | Path) -> OpenRecording:
    """Open the recording of a sonar, a bag, a video, or a folder of pictures.

    path: `.aris`, `.ddf`, Oculus `.raw`, bags of ROS 1 and 2 (extra `ros`), `.avi` and other
        videos, pictures; docs/recordings.md has them all.

    Frames are read when they are asked for.  Raises FactoryError, one line, for a file that is not
    there, of no known kind, or damaged.
    """
    from .models.recordings import open_recording as opened

    return OpenRecording(opened(path))
