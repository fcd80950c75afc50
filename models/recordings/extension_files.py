"""Recordings that another package reads: its class gives frames, and each is checked here.

The checks are those that readers of this project make, so that a damaged file costs one line
whoever reads it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ...factory.common import extensions
from ...factory.common.errors import FactoryError, FrameError
from .base import (
    FULL_SCALE,
    MOST_BEAMS,
    MOST_PIXELS,
    MOST_RANGE_M,
    MOST_RANGES,
    Ended,
    Recording,
    SonarFrame,
    explained,
    range_problem,
)

KIND: extensions.Kind = "recording"
_MOST_FRAMES = 1 << 31


class RecordingReader(Protocol):
    """What a class of another package does: `len`, frames by number from 0, `close`.

    It is made of a path, reads no samples before it is asked for them, and raises any exception for
    what it cannot read.
    """

    def __init__(self, path: Path) -> None: ...

    def __len__(self) -> int: ...

    def __getitem__(self, number: int) -> SonarFrame: ...

    def close(self) -> None:
        """Close the file."""


@dataclass(frozen=True)
class RecordingEntry:
    """A reader of a recorder's files, as an extension.

    kind: its name.  suffixes: of its files, such as `(".son",)`, in lower case.
    reader: see `RecordingReader`.
    accepts: whether a file of such a suffix is the recorder's, by its first bytes; needed for
        suffixes that this program knows, and for those of several recorders.
    """

    kind: str
    suffixes: tuple[str, ...]
    reader: Callable[[Path], RecordingReader]
    accepts: Callable[[Path], bool] | None = None


def register_recording(entry: RecordingEntry) -> None:
    """Make a recorder's files known in this process.

    Raises ValueError for no name, and suffixes that are none or need `accepts`.
    """
    from . import READERS

    _check_entry(entry)
    if entry.kind in READERS:
        raise ValueError(f"recording {entry.kind!r}: there is one of that kind")
    extensions.register(KIND, entry.kind, entry)


def entries() -> list[RecordingEntry]:
    """All readers of other packages; those that cannot be loaded are left out."""
    loadable = []
    for name in extensions.names(KIND):
        with suppress(FactoryError):
            loadable.append(entry_of(name))
    return loadable


def entry_of(name: str) -> RecordingEntry:
    """The reader of a name.  Raises FactoryError where it cannot be loaded, or is none."""
    extension = extensions.find(KIND, name)
    entry = None if extension is None else extension.value
    if extension is None or not isinstance(entry, RecordingEntry) or entry.kind != name:
        raise FactoryError(
            f"recording {name}: is no `RecordingEntry` of that kind; report it to the author"
        )
    try:
        _check_entry(entry)
    except ValueError as error:
        raise FactoryError(f"{error}; report it to the author ({extension.source})") from error
    return entry


def entry_for(path: Path) -> RecordingEntry | None:
    """The reader of a file, by its suffix and what its package says of it; None: none."""
    suffix = path.suffix.lower()
    for entry in entries():
        if suffix not in entry.suffixes:
            continue
        if entry.accepts is None:
            return entry
        with suppress(Exception):  # the code of another package
            if path.is_file() and entry.accepts(path):
                return entry
    return None


def known_suffixes() -> list[str]:
    """The suffixes of all readers of other packages."""
    return [suffix for entry in entries() for suffix in entry.suffixes]


def _check_entry(entry: RecordingEntry) -> None:
    from . import READERS

    known = {suffix for _, suffixes in READERS.values() for suffix in suffixes}
    for suffix in entry.suffixes:
        if not suffix.startswith(".") or suffix != suffix.lower():
            raise ValueError(f"recording {entry.kind}: {suffix!r} is no suffix, such as '.son'")
        if suffix in known and entry.accepts is None:
            raise ValueError(
                f"recording {entry.kind}: {suffix} is read already; give `accepts`, which tells "
                "the files apart"
            )
    if not entry.suffixes:
        raise ValueError(f"recording {entry.kind}: has no suffixes")


class ExtensionFile(Recording):
    """A recording that another package reads; a `Recording`."""

    def __init__(self, path: Path, entry: RecordingEntry) -> None:
        """Raises FactoryError when it cannot be read."""
        self._entry = entry
        self._reader: RecordingReader | None = None
        super().__init__(path)

    def _open(self) -> None:
        with self._explained(f"{self.path}: cannot be read"):
            self._reader = self._entry.reader(self.path)
            count = len(self._reader)
        if not 0 < count < _MOST_FRAMES:
            raise FrameError(f"{self.path}: holds no frame that {self._entry.kind} reads")
        self.count = count
        warning = getattr(self._reader, "warning", "")
        self.warning = f"{self.path}: {' '.join(str(warning).split())}" if warning else ""

    def _read(self, number: int) -> SonarFrame:
        assert self._reader is not None
        name = f"{self.path}: frame {number}"
        with self._explained(f"{name} cannot be read"):
            frame = self._reader[number]
        return checked_frame(frame, number, name)

    def _explained(self, words: str) -> Any:
        source = extensions.source_of(KIND, self._entry.kind)
        return explained(f"{words} by {self._entry.kind} ({source})", reason=True, passing=Ended)

    def close(self) -> None:
        """Close the file."""
        super().close()
        if self._reader is not None:
            with suppress(Exception):  # the code of another package
                self._reader.close()


def checked_frame(frame: Any, number: int, name: str) -> SonarFrame:
    """A frame as readers of this project give it: in native byte order and in one piece.

    number: that it must have.  name: names it in errors.
    Raises FrameError for samples, beams or numbers that cannot be.
    """
    if not isinstance(frame, SonarFrame) or not isinstance(frame.samples, np.ndarray):
        raise FrameError(f"{name}: is no Frame with an array of samples")
    samples = np.ascontiguousarray(frame.samples, frame.samples.dtype.newbyteorder("="))
    checked: SonarFrame = replace(frame, samples=samples)
    problem = "" if frame.number == number else f"says that it is frame {frame.number}"
    problem = problem or _problem_of(checked)
    if problem:
        raise FrameError(f"{name}: {problem}")
    return checked


def _problem_of(frame: SonarFrame) -> str:
    """What cannot be in a frame; mostly empty."""
    samples = frame.samples
    if str(samples.dtype) not in FULL_SCALE:
        return f"samples are {samples.dtype}; expected {', '.join(FULL_SCALE)}"
    is_image = samples.ndim == 2 or (samples.ndim == 3 and samples.shape[2] <= 4)
    if not is_image or not 0 < samples.size <= 4 * MOST_PIXELS:
        return f"samples have the shape {samples.shape}"
    for part in (frame, frame.pose, frame.device):
        for field, value in vars(part).items():
            if isinstance(value, float | np.floating) and not math.isfinite(value):
                return f"{field} is {value}; expected a number or None"
    return range_problem(samples) or ("" if frame.beams is None else _beams_problem(frame))


def _beams_problem(frame: SonarFrame) -> str:
    beams = frame.beams
    assert beams is not None
    shape = frame.samples.shape
    count = len(beams.azimuths_rad)
    fits = shape[1:] == (count,) and 2 <= count <= MOST_BEAMS and 2 <= shape[0] <= MOST_RANGES
    if not fits:
        return (
            f"{count} beams and samples of the shape {shape}; expected (ranges, beams), up to "
            f"{MOST_RANGES} and {MOST_BEAMS}"
        )
    azimuths = np.asarray(beams.azimuths_rad, np.float64)
    if not (np.abs(azimuths).max() <= math.pi / 2 and (np.diff(azimuths) > 0).all()):
        return "bearings must ascend from -pi/2 to pi/2 at most"
    if not 0 <= beams.range_min_m < beams.range_max_m <= MOST_RANGE_M:
        return (
            f"ranges from {beams.range_min_m} to {beams.range_max_m} m cannot be (0 to "
            f"{MOST_RANGE_M:g})"
        )
    return ""
