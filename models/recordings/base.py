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
from typing import IO, TYPE_CHECKING, Any, Self

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.small_files import open_regular

if TYPE_CHECKING:
    from ...factory.dataset.fan_geometry import FanGeometry

TIFF_SUFFIXES = (".tif", ".tiff")
ANIMATED_SUFFIXES = (".png", ".webp")
ARRAY_SUFFIX = ".npy"
HDF5_SUFFIXES = (".h5", ".hdf5")
ARRAY_SUFFIXES = (ARRAY_SUFFIX, ".npz", ".mat")
PORTABLE_SUFFIXES = (".pgm", ".ppm", ".pnm")
IMAGE_SUFFIXES = (
    *(".png", *TIFF_SUFFIXES, ".jpg", ".jpeg", ".bmp", ".webp"),
    *(*PORTABLE_SUFFIXES, ARRAY_SUFFIX),
)
FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0, "float32": 1.0}
"""dtype -> grey value of full scale, of the pixels that are read and written."""

_WHITES = tuple(float((1 << bits) - 1) for bits in (8, 10, 12, 14))

# Times its size that an untrusted file may unpack to; a small one to `ALWAYS_BYTES`, and none to
# more than `MOST_BYTES` at once.  Raw sonar images are mostly black and pack 5 to 50 times.
RATIO = 200
ALWAYS_BYTES = 1 << 28
MOST_BYTES = 1 << 31
MOST_PIXELS = 1 << 26  # of an image, whatever it is packed into
TOO_LARGE = f"too large; up to {MOST_PIXELS:,} (such as 8192 x 8192) can be read, cut it into parts"
WITHOUT_ALPHA = "has transparency, which is not kept: what is under it shows"
MOST_TINT = 6
"""Grey levels of 255; codecs tint grey images by a few, and differently in each frame."""
MOST_RANGES = 8192
MOST_BEAMS = 4096
MOST_RANGE_M = 2000.0


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
class SonarPose:
    """Pose of the sonar; None where the file does not give it."""

    heading_deg: float | None = None  # of the sonar's compass, as the next two
    pitch_deg: float | None = None
    roll_deg: float | None = None
    depth_m: float | None = None  # of the platform
    pan_deg: float | None = None  # of a rotator
    tilt_deg: float | None = None
    latitude_deg: float | None = None  # of a GPS
    longitude_deg: float | None = None


@dataclass(frozen=True)
class RecordingDevice:
    """The sonar and those of its settings that the file gives."""

    name: str = "unknown"
    serial_number: int | None = None
    frequency_khz: float | None = None
    sound_speed_m_s: float | None = None
    gain_db: float | None = None
    gain_percent: float | None = None
    pulse_us: float | None = None


@dataclass(frozen=True, eq=False)
class SonarFrame:
    """One frame.

    number: counts from 0.
    samples: with `beams`, (ranges, beams) uint8, uint16 or float32 (0..1), near range first, beams
        from left to right; without, an image, (H, W) or (H, W, colours) of such a dtype.
    beams: None for an image, of which only the pixels are known.
    time_s: seconds since 1970 (UTC), or since the start where the file has no clock; None: unknown.
    duration_s: how long a video or an animation shows it; None: unknown.
    geometry: where range and bearing lie in an image, if the file says it.
    sequence: the channel, slice or topic that it belongs to, where the file holds several.
    """

    number: int
    samples: Array
    beams: Beams | None = None
    time_s: float | None = None
    duration_s: float | None = None
    pose: SonarPose = field(default_factory=SonarPose)
    device: RecordingDevice = field(default_factory=RecordingDevice)
    geometry: FanGeometry | None = None
    sequence: str = ""


class Ended(FrameError):
    """The file holds fewer frames than it says."""


class Recording(ABC):
    """An opened recording; close it, or use it in a `with` statement.

    A reader adds `_open` and `_read`.
    warning: what is wrong with the file though its frames can be read, in one line; mostly empty.
    count: how many frames the file says it has.  files: those of images, else none.
    """

    _file: IO[bytes] | None = None

    def __init__(self, path: Path) -> None:
        """Raises FactoryError when it cannot be opened, or holds no whole frame."""
        self.path = path
        self.warning = ""
        self.count = 0
        self.files: list[Path] = []
        try:
            if not path.is_dir():
                self._file = open_regular(path)
                self.size = path.stat().st_size
            self._open()
        except OSError as error:
            raise FactoryError(f"{path}: cannot be read ({error.strerror})") from error
        except FactoryError as error:
            self.close()
            raise FactoryError(str(error)) from error

    @abstractmethod
    def _open(self) -> None:
        """Count the frames.  Raises FactoryError when there are none of this kind."""

    @abstractmethod
    def _read(self, number: int) -> SonarFrame:
        """Read a frame that is there.  Raises FrameError when it is damaged."""

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, number: int) -> SonarFrame:
        """One frame.  Raises IndexError, and FrameError when it cannot be used."""
        if not 0 <= number < self.count:
            raise IndexError(f"{self.path}: frame {number} of {self.count}")
        return self._read(number)

    def __iter__(self) -> Iterator[SonarFrame]:
        """All frames that are there, in order.  Raises FrameError at one that cannot be used."""
        yield from self.frames_from(0)

    def frames_from(self, first: int) -> Iterator[SonarFrame]:
        """The frames from number `first` on."""
        for number in range(first, self.count):
            try:
                frame = self._read(number)
            except Ended:
                if not number:
                    raise
                self.warning = f"{self.path}: ends after {number} of {self.count} frames"
                return
            yield frame

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()

    def bytes_at(self, offset: int, count: int, part: str) -> bytes:
        """`count` bytes of the file.  Raises FrameError when it ends before."""
        content = b""
        if self._file is not None and 0 <= offset <= self.size - count:
            try:
                self._file.seek(offset)
                content = self._file.read(count)
            except OSError as error:
                raise FrameError(f"{self.path}: cannot be read ({error.strerror})") from error
        if len(content) != count:
            raise FrameError(f"{self.path}: ends within {part}; the file is cut short or damaged")
        return content

    def record_at(self, offset: int, layout: np.dtype[Any], part: str) -> np.void:
        """The header of this layout.  Raises FrameError when the file ends before."""
        content = self.bytes_at(offset, layout.itemsize, part)
        record: np.void = np.frombuffer(content, layout)[0]
        return record

    def within(self, quantity: str, value: float, least: float, most: float) -> float:
        """`value`.  Raises FrameError unless it is a number from `least` to `most`."""
        if not least <= value <= most:
            raise FrameError(
                f"{self.path}: {quantity} is {value:g}, which cannot be ({least:g} to {most:g}); "
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
        reason_text = " ".join(str(error).split())[:120] or type(error).__name__
        raise FrameError(f"{words} ({reason_text})" if reason else words) from error


def ask_bytes(name: str, needed: int, size: int, *, streamed: bool = False) -> None:
    """Raise FrameError where a file of `size` bytes unpacks to more than it may.

    needed: bytes, in memory at once; streamed: read piece by piece.
    """
    most = ALWAYS_BYTES + RATIO * size
    most = most if streamed else min(MOST_BYTES, most)
    if needed > most:
        raise FrameError(
            f"{name}: unpacks to {needed:,} bytes or more, at most {most:,} are read ({RATIO} "
            f"times the file's size, {MOST_BYTES >> 30} GiB at once); if it is sound, save it "
            "uncompressed or in parts"
        )


def ask_pixels(name: str, width: float, height: float) -> None:
    """Raise FrameError for an image of more than `MOST_PIXELS`."""
    if width * height > MOST_PIXELS:
        raise FrameError(f"{name}: {width:.0f} x {height:.0f} pixels are {TOO_LARGE}")


def swapped(image: Array) -> Array:
    """(H, W) or (H, W, C), red first as blue first or the other way round, in native byte order."""
    if image.ndim == 3 and image.shape[2] >= 3:
        image = np.concatenate([image[..., 2::-1], image[..., 3:]], axis=2)
    return image.astype(image.dtype.newbyteorder("="), copy=False)


def untinted(image: Array) -> Array:
    """(H, W) of a grey image, (H, W, 3) uint8 or uint16, of nearly equal channels; others as is."""
    import cv2  # sonars' own recordings do without

    blue, green, red = cv2.split(image)
    tint = max(cv2.norm(blue, green, cv2.NORM_INF), cv2.norm(red, green, cv2.NORM_INF))
    if tint > MOST_TINT * (1 if image.dtype == np.uint8 else 257):
        return image
    return np.ascontiguousarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def as_samples(page: Array, name: str) -> Array:
    """A page whose numbers are grey values as they are: uint8, uint16, or floats as float32.

    name: names it in errors.  Raises FrameError for other dtypes, NaN and floats outside 0..1.
    """
    if page.dtype.kind == "f":
        with np.errstate(over="ignore"):  # infinite: outside 0..1
            page = page.astype(np.float32)
    if str(page.dtype) not in FULL_SCALE:
        raise FrameError(f"{name}: pixels are {page.dtype}; expected {', '.join(FULL_SCALE)}")
    problem = range_problem(page)
    if problem:
        raise FrameError(f"{name}: {problem}")
    return page


def range_problem(image: Array) -> str:
    """What keeps the floats of an image from being grey values, and the remedy; empty: nothing."""
    if image.dtype != np.float32 or (image.min() >= 0 and image.max() <= 1):
        return ""
    finite = image[np.isfinite(image)]
    span = f"{finite.min():g} to {finite.max():g}" if finite.size else "none"
    if finite.size < image.size:
        return (
            f"{image.size - finite.size:,} of {image.size:,} pixels are NaN or infinite (the "
            f"others: {span}); put 0 (black) where there is no echo"
        )
    return (
        f"floats must be grey values from 0 to 1, these are {span}; scale them (of echoes in "
        "linear units the logarithm)"
    )


def colours_of(image: Array) -> Array:
    """A view of an image without its alpha channel, (H, W) or (H, W, 1 or 3)."""
    if image.ndim == 2:
        return image
    return image[..., : 3 if image.shape[2] in (3, 4) else 1]


def white_of(image: Array) -> float:
    """The grey value of white: full scale, or that of 8, 10, 12 or 14 bits in samples of 16.

    Cameras and sonars of so few bits store them in the lower ones.
    """
    full = FULL_SCALE[str(image.dtype)]
    if image.dtype != np.uint16:
        return full
    largest = float(colours_of(image).max(initial=0))
    return next((white for white in _WHITES if largest <= white), full)


def known(value: float, most: float = 1e6) -> float | None:
    """A number of a header, or None where it is not finite or absurd."""
    return float(value) if np.isfinite(value) and abs(value) <= most else None


def pose_of(header: np.void) -> SonarPose:
    """What those fields of a header say that are named as fields of `SonarPose`."""
    names = set(header.dtype.names or ()) & set(SonarPose.__dataclass_fields__)
    return SonarPose(**{name: known(header[name]) for name in names})
