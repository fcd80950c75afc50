"""What every reader of recordings gives: frames, one after the other or by number.

A recording is opened without reading its samples.  Whatever a file says about itself is checked
before it is used: a damaged or foreign file costs one line (FactoryError when nothing of it can be
used, FrameError when one frame cannot), never memory or time.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError, FrameError
from ...factory.small_files import open_regular

TIFF_SUFFIXES = (".tif", ".tiff")
ARRAY_SUFFIX = ".npy"
PICTURE_SUFFIXES = (
    *(".png", *TIFF_SUFFIXES, ".jpg", ".jpeg", ".bmp", ".pgm", ".webp", ARRAY_SUFFIX),
)
FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0, "float32": 1.0}
"""dtype -> grey value of full scale, of the pixels that are read and written."""
Samples = npt.NDArray[Any]

RATIO = 200
"""Times its size that a stranger's file may unpack to; a small one to `ALWAYS_BYTES`, and none to
more than `MOST_BYTES` at once.  Raw sonar pictures are mostly black and pack 5 to 50 times."""
ALWAYS_BYTES = 1 << 28
MOST_BYTES = 1 << 31
MOST_PIXELS = 1 << 26
"""Of a picture, whatever it is packed into."""
TOO_LARGE = f"too large; up to {MOST_PIXELS:,} (such as 8192 x 8192) can be read, cut it into parts"
MOST_RANGES, MOST_BEAMS = 8192, 4096
MOST_RANGE_M = 2000.0
_POSE = {
    **dict.fromkeys(("heading_deg", "pitch_deg", "roll_deg"), 360.0),
    **dict.fromkeys(("pan_deg", "tilt_deg"), 720.0),
    **{"depth_m": 1e6, "latitude_deg": 90.0, "longitude_deg": 180.0},
}
"""What is more than that is absurd."""


@dataclass(frozen=True)
class Beams:
    """Where the samples of one ping lie.

    azimuths_rad: (beams,) bearings of the beams' centres, ascending, positive to the right.
    range_min_m, range_max_m: where the first sample of a beam begins and the last one ends.
    """

    azimuths_rad: tuple[float, ...]
    range_min_m: float
    range_max_m: float


@dataclass(frozen=True)
class Pose:
    """How the sonar stood, as far as the file says; None where it does not.

    heading_deg, pitch_deg, roll_deg: of the sonar's compass.  depth_m: of the platform.
    pan_deg, tilt_deg: of a rotator.  latitude_deg, longitude_deg: of a GPS.
    """

    heading_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    depth_m: float | None = None
    pan_deg: float | None = None
    tilt_deg: float | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None


@dataclass(frozen=True)
class Device:
    """The sonar and its settings, as far as the file says."""

    name: str = "unknown"
    serial_number: int | None = None
    frequency_khz: float | None = None
    sound_speed_m_s: float | None = None
    gain_db: float | None = None
    gain_percent: float | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame.

    number: counts from 0.
    samples: with `beams`, (ranges, beams) uint8, uint16 or float32 (0..1), near range first, beams
        from left to right; without, a picture, (H, W) or (H, W, colours) of such a dtype.
    beams: None for a picture, of which only the pixels are known.
    time_s: seconds since 1970 (UTC), or since the start where the file has no clock; None: unknown.
    """

    number: int
    samples: Samples
    beams: Beams | None = None
    time_s: float | None = None
    pose: Pose = field(default_factory=Pose)
    device: Device = field(default_factory=Device)


class Recording(ABC):
    """An opened recording; close it, or use it in a `with` statement.

    warning: what is wrong with the file though its frames can be read, in one line; mostly empty.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warning = ""

    @abstractmethod
    def __len__(self) -> int:
        """How many frames there are."""

    @abstractmethod
    def _read(self, number: int) -> Frame:
        """Read a frame that is there.  Raises FrameError when it is damaged."""

    def __getitem__(self, number: int) -> Frame:
        """One frame.  Raises IndexError, and FrameError when it cannot be used."""
        if not 0 <= number < len(self):
            raise IndexError(f"{self.path}: frame {number} of {len(self)}")
        return self._read(number)

    def __iter__(self) -> Iterator[Frame]:
        """All frames in order.  Raises FrameError at one that cannot be used."""
        for number in range(len(self)):
            yield self[number]

    def close(self) -> None:  # noqa: B027  some hold nothing open
        """Let go of the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class FileOfFrames(Recording):
    """What readers of one file share; they add `_open`, `__len__` and `_read`."""

    def __init__(self, path: Path) -> None:
        """Raises FactoryError when the file cannot be opened, or holds no whole frame."""
        super().__init__(path)
        try:
            self.size = path.stat().st_size
            self._file = open_regular(path)
        except OSError as error:
            raise FactoryError(f"{path}: cannot be read ({error.strerror})") from error
        try:
            self._open()
        except FrameError as error:
            self.close()
            raise FactoryError(str(error)) from error

    @abstractmethod
    def _open(self) -> None:
        """Read what the file says of all frames.  Raises FrameError when it is of another kind."""

    def close(self) -> None:
        """See `Recording`."""
        self._file.close()

    def bytes_at(self, offset: int, count: int, what: str) -> bytes:
        """`count` bytes.  Raises FrameError when the file ends before."""
        content = b""
        if 0 <= offset <= self.size - count:
            try:
                self._file.seek(offset)
                content = self._file.read(count)
            except OSError as error:
                raise FrameError(f"{self.path}: cannot be read ({error.strerror})") from error
        if len(content) != count:
            raise FrameError(f"{self.path}: ends within {what}; the file is cut short or damaged")
        return content

    def within(self, what: str, value: float, least: float, most: float) -> float:
        """`value`.  Raises FrameError unless it is a number from `least` to `most`."""
        if not least <= value <= most:
            raise FrameError(
                f"{self.path}: {what} is {value:g}, which cannot be ({least:g} to {most:g}); "
                "the file is damaged or of another kind"
            )
        return value


@contextmanager
def explained(
    words: str, *, reason: bool = False, passing: type[Exception] | tuple[()] = ()
) -> Iterator[None]:
    """FrameError for whatever damage makes a library raise, which is nearly anything; no warnings.

    reason: whether the error says more in brackets.  passing: errors that are left as they are.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except FactoryError as error:
        raise error if isinstance(error, FrameError) else FrameError(str(error)) from error
    except passing:
        raise
    except Exception as error:
        told = " ".join(str(error).split())[:120] or type(error).__name__
        raise FrameError(f"{words} ({told})" if reason else words) from error


def ask_bytes(what: str, needed: int, size: int, *, streamed: bool = False) -> None:
    """Raise FrameError where a file of `size` bytes unpacks to more than it may.

    needed: bytes, in memory at once; streamed: read piece by piece.
    """
    most = ALWAYS_BYTES + RATIO * size
    most = most if streamed else min(MOST_BYTES, most)
    if needed > most:
        raise FrameError(
            f"{what}: unpacks to {needed:,} bytes or more, at most {most:,} are read ({RATIO} "
            f"times the file's size, {MOST_BYTES >> 30} GiB at once); if it is sound, save it "
            "uncompressed or in parts"
        )


def ask_pixels(what: str, width: float, height: float) -> None:
    """Raise FrameError for a picture of more than `MOST_PIXELS`."""
    if width * height > MOST_PIXELS:
        raise FrameError(f"{what}: {width:.0f} x {height:.0f} pixels are {TOO_LARGE}")


def swapped(picture: Samples) -> Samples:
    """Colours in OpenCV's order (BGR), or the other way round; numbers as the machine orders them.

    picture: (H, W) or (H, W, C); what is beside three colours stays where it is.
    """
    if picture.ndim == 3 and picture.shape[2] >= 3:
        picture = np.concatenate([picture[..., 2::-1], picture[..., 3:]], axis=2)
    return picture.astype(picture.dtype.newbyteorder("="), copy=False)


def known(value: float, most: float = 1e6) -> float | None:
    """A number of a header, or None where it is not finite or absurd."""
    return float(value) if np.isfinite(value) and abs(value) <= most else None


def pose_of(header: np.void) -> Pose:
    """What those fields of a header say that are named as fields of `Pose`."""
    names = header.dtype.names or ()
    return Pose(**{name: known(header[name], _POSE[name]) for name in names if name in _POSE})


def layout_of(fields: str, size: int | None = None) -> np.dtype[Any]:
    """The dtype of a header, little end first.

    fields: "NAME KIND ..." of all fields in order, or, of a header of `size` bytes, "NAME OFFSET
        KIND ..." of those that are read.
    """
    words = fields.split()
    step = 2 if size is None else 3
    names, kinds = words[::step], [f"<{kind}" for kind in words[step - 1 :: step]]
    if size is None:
        return np.dtype(list(zip(names, kinds, strict=True)))
    offsets = [int(word) for word in words[1::3]]
    made: Any = {"names": names, "formats": kinds, "offsets": offsets, "itemsize": size}
    return np.dtype(made)
