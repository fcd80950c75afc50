"""Recordings that another package reads: its class gives frames, and each is checked here.

The checks are those that readers of this project make, so that a damaged file costs one line
whoever reads it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import numpy as np

from ...factory.common import extensions
from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from .base import (
    FULL_SCALE,
    MOST_BEAMS,
    MOST_PIXELS,
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
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
    if not isinstance(frame, SonarFrame):
        raise FrameError(f"{name}: is a {type(frame).__name__}, no Frame")
    if frame.number != number:
        raise FrameError(f"{name}: says that it is frame {frame.number}")
    samples = _checked_samples(frame.samples, name)
    if frame.beams is not None:
        _check_beams(frame.beams, samples, name)
    numbers = {"time_s": frame.time_s, "duration_s": frame.duration_s}
    for part in (frame.pose, frame.device):
        numbers |= {field.name: getattr(part, field.name) for field in fields(part)}
    for quantity, value in numbers.items():
        is_number = isinstance(value, int | float | np.number)
        if quantity != "name" and value is not None and not (is_number and math.isfinite(value)):
            raise FrameError(
                f"{name}: {quantity} is {str(value)[:40]!r}; expected a number or None"
            )
    return SonarFrame(
        number, samples, frame.beams, frame.time_s, frame.duration_s, frame.pose, frame.device,
        frame.geometry,
    )  # fmt: skip


def _checked_samples(samples: Any, name: str) -> Array:
    if not isinstance(samples, np.ndarray):
        raise FrameError(f"{name}: samples are a {type(samples).__name__}, no array")
    native = np.ascontiguousarray(samples, samples.dtype.newbyteorder("="))
    if str(native.dtype) not in FULL_SCALE:
        raise FrameError(f"{name}: samples are {native.dtype}; expected {', '.join(FULL_SCALE)}")
    is_image = native.ndim == 2 or (native.ndim == 3 and native.shape[2] <= 4)
    if not is_image or not 0 < native.size <= 4 * MOST_PIXELS:
        raise FrameError(f"{name}: samples have the shape {native.shape}")
    problem = range_problem(native)
    if problem:
        raise FrameError(f"{name}: {problem}")
    return native


def _check_beams(beams: Beams, samples: Array, name: str) -> None:
    fits = samples.ndim == 2 and 2 <= len(samples) <= MOST_RANGES
    count = len(beams.azimuths_rad)
    if not fits or samples.shape[1] != count or not 2 <= count <= MOST_BEAMS:
        raise FrameError(
            f"{name}: {count} beams and samples of the shape {samples.shape}; expected "
            f"(ranges, beams), up to {MOST_RANGES} and {MOST_BEAMS}"
        )
    azimuths = np.asarray(beams.azimuths_rad, np.float64)
    is_sector = np.isfinite(azimuths).all() and np.abs(azimuths).max() <= math.pi / 2
    if not is_sector or (np.diff(azimuths) <= 0).any():
        raise FrameError(f"{name}: bearings must ascend from -pi/2 to pi/2 at most")
    if not 0 <= beams.range_min_m < beams.range_max_m <= MOST_RANGE_M:
        raise FrameError(
            f"{name}: ranges from {beams.range_min_m} to {beams.range_max_m} m cannot be (0 to "
            f"{MOST_RANGE_M:g})"
        )


def check_recording_reader(path: str | Path, *, mutations: int = 50, seed: int = 0) -> int:
    """Try the reader of a file as those of this project are tested; returns how many frames it has.

    Frames are read in order, by number and again, and must be the same; then copies of the file,
    cut short or with changed bytes, may cost one line each and nothing else.
    path: a small, sound recording, whose package is installed or registered.
    Raises FactoryError, one line, for what the reader does wrong.
    """
    from . import open_recording

    location = Path(path)
    with open_recording(location) as recording:
        frames = list(recording)
        for number in reversed(range(len(recording))):
            again = recording[number].samples
            if not np.array_equal(again, frames[number].samples):
                raise FactoryError(
                    f"{location}: frame {number} is another one when it is read by its number"
                )
    rng = np.random.default_rng(seed)
    content = location.read_bytes()
    with TemporaryDirectory() as folder:
        for number in range(mutations):
            damaged = Path(folder) / f"{number}{location.suffix}"
            damaged.write_bytes(_damaged(content, rng))
            _read_some(damaged, len(frames) + 1)
    return len(frames)


def _read_some(path: Path, most: int) -> None:
    """Read the first frames of a damaged file, which may cost a line."""
    from . import open_recording

    with suppress(FactoryError), open_recording(path) as recording:
        for _ in zip(range(most), recording, strict=False):
            pass


def _damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A file cut short, with bits flipped or a word overwritten, mostly where headers are."""
    data = bytearray(content)
    most = max(1, len(data) if rng.random() < 0.3 else min(len(data), 2600))
    if rng.random() < 0.3:
        return bytes(data[: rng.integers(len(data) + 1)])
    if rng.random() < 0.5:
        data[rng.integers(most)] ^= 1 << int(rng.integers(8))
        return bytes(data)
    place = int(rng.integers(most))
    data[place : place + 4] = b"\xff\xff\xff\x7f"
    return bytes(data)
