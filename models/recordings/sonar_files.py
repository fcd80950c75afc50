"""Recordings of sonars: ARIS (`.aris`), DIDSON (`.ddf`, versions 3 and 4), Oculus (`.raw`, logs).

Sound Metrics': a file header, then frames of one size, each a header and one byte per sample, row
by row from the nearest.  Blueprint Subsea's Oculus: messages with a header of 16 bytes; a ping's
continues with its settings, a bearing per beam in hundredths of a degree, and the samples.
Messages of other kinds are skipped.  A log of ViewPoint (`.oculus`) has items, of which those of
kind 10 hold a message each, plain or packed by zlib.  sonar_headers.csv names the documents.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FrameError
from ...factory.common.files import whole_file
from .base import (
    MOST_BEAMS,
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Recording,
    RecordingDevice,
    SonarFrame,
    explained,
    known,
    pose_of,
)

SIGNATURE = b"DDF\5"  # of an ARIS file and of each of its frames
_BEAMS_OF_PING_MODES = (0, 48, 48, 96, 96, 96, 64, 64, 64, 128, 128, 128, 128)
# System type -> name and its low and high frequency, kHz.
_SYSTEMS = {0: ("ARIS 1800", 1100, 1800), 1: ("ARIS 3000", 1800, 3000), 2: ("ARIS 1200", 700, 1200)}

# Version -> bytes of the file's and of a frame's header; both have the fields at the same places.
_DDF_HEADERS = {3: (512, 256), 4: (1024, 1024)}
# Of configuration flags 0 (none), 1 (classic), 2 (long range) and 3 (both): metres a step of the
# window's start at high frequency (twice that at low), and window lengths in metres, of codes 0 to
# 3 (HF) or 2 to 5 (LF).
_WINDOWS = (
    (0.419, (1.25, 2.5, 5.0, 10.0, 20.0, 40.0)),
    (0.375, (1.125, 2.25, 4.5, 9.0, 18.0, 36.0)),
    (0.419, (2.5, 5.0, 10.0, 20.0, 40.0, 70.0)),
    (0.375, (2.25, 4.5, 9.0, 18.0, 36.0, 72.0)),
)
_SOUND_M_S = 1500.0


def _table(name: str) -> list[list[str]]:
    """The rows of a table beside this module."""
    lines = Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines()
    return [line.split(",") for line in lines if not line.startswith("#")]


@cache
def layouts() -> dict[str, np.dtype[Any]]:
    """Header -> its fields that are read."""
    layout_of_header = {}
    for header, rows in groupby(_table("sonar_headers.csv"), key=lambda row: row[0]):
        *fields, end = rows
        _, names, kinds, places = zip(*fields, strict=True)
        layout: Any = {"names": names, "formats": [f"<{kind}" for kind in kinds]}
        layout |= {"offsets": list(map(int, places)), "itemsize": int(end[3])}
        layout_of_header[header] = np.dtype(layout)
    return layout_of_header


class _SoundMetricsFile(Recording):
    """What both formats share."""

    beams = ranges = 0  # of every frame
    file_size = frame_size = 1024  # bytes of a header
    layout: str  # of a frame's header

    def _count_frames(self) -> None:
        """Raises FrameError when there is none; notes a rest as a warning."""
        self.count, rest = divmod(self.size - self.file_size, self._place(1) - self._place(0))
        if self.count < 1:
            raise FrameError(f"{self.path}: ends within its first frame; the file is cut short")
        if rest:
            self.warning = f"{self.path}: ends within frame {self.count}, which is left out"

    def _place(self, number: int) -> int:
        return self.file_size + number * (self.frame_size + self.beams * self.ranges)

    def _header(self, number: int) -> np.void:
        layout = layouts()[self.layout]
        part = f"the header of frame {number}"
        return self.record_at(self._place(number), layout, part)

    def _samples(self, number: int) -> Array:
        """(ranges, beams) uint8, beams as they are stored."""
        offset = self._place(number) + self.frame_size
        count = self.beams * self.ranges
        content = self.bytes_at(offset, count, f"frame {number}")
        return np.frombuffer(content, np.uint8).reshape(self.ranges, self.beams)


class ArisFile(_SoundMetricsFile):
    """An ARIS recording; a `Recording`."""

    layout = "aris_frame"

    def _open(self) -> None:
        head = self.bytes_at(0, 4, "its first bytes")
        if head != SIGNATURE:
            raise FrameError(f"{self.path}: not an ARIS recording (it begins with {head!r})")
        first = self._header(0)
        self.beams = self._beam_count(first)
        self.ranges = int(self.within("SamplesPerBeam", first["SamplesPerBeam"], 2, MOST_RANGES))
        self._count_frames()

    def _beam_count(self, header: np.void) -> int:
        if header["Version"] != SIGNATURE:
            raise FrameError(f"{self.path}: a frame has no frame's signature; it is damaged")
        return _BEAMS_OF_PING_MODES[int(self.within("PingMode", header["PingMode"], 1, 12))]

    def _read(self, number: int) -> SonarFrame:
        header = self._header(number)
        if (self._beam_count(header), header["SamplesPerBeam"]) != (self.beams, self.ranges):
            raise FrameError(f"{self.path}: frame {number} is not as large as the first")
        if not header["ReorderedSamples"]:
            raise FrameError(
                f"{self.path}: frame {number} holds samples in the order of the device, as only "
                "live streams do; record it with ARIScope"
            )
        speed = self.within("SoundSpeed", float(header["SoundSpeed"]), 1000, 2000)
        half_metres = 1e-6 * speed / 2  # a microsecond, there and back
        near = half_metres * float(header["SampleStartDelay"])
        far = near + half_metres * float(header["SamplePeriod"]) * self.ranges
        self.within("the range of the last sample", far, near + 1e-3, MOST_RANGE_M)
        # The beam table goes by the number of beams, and by whether a telephoto lens is on.
        lens = "3000" if self.beams in (64, 128) else "telephoto" if header["LargeLens"] else "1800"
        azimuths = np.deg2rad(beam_centres_deg()[f"{lens}_{self.beams}"])
        name, low_khz, high_khz = _SYSTEMS.get(int(header["TheSystemType"]), ("ARIS", None, None))
        return SonarFrame(
            number,
            np.ascontiguousarray(self._samples(number)[:, ::-1]),  # beam 0 is the rightmost
            Beams(tuple(azimuths.tolist()), near, far),
            time_s=float(header["FrameTime"]) * 1e-6,
            pose=pose_of(header),
            device=RecordingDevice(
                name=name,
                serial_number=int(header["SonarSerialNumber"]),
                frequency_khz=high_khz if header["FrequencyHiLow"] else low_khz,
                sound_speed_m_s=speed,
                gain_db=known(header["ReceiverGain"], 100),
                pulse_us=known(float(header["PulseWidth"])) or None,
            ),
        )

    def rewrite(self, samples: Iterable[Array], path: Path) -> None:
        """Write the recording with other samples, (ranges, beams) uint8 for each frame.

        Raises ValueError for samples of another shape, type or number, FactoryError when `path`
        cannot be written.
        """
        wanted = self.ranges, self.beams
        with whole_file(path) as partial, partial.open("wb") as file:
            file.write(self.bytes_at(0, self.file_size, "its header"))
            for number, frame in zip(range(self.count), samples, strict=True):
                if frame.shape != wanted or frame.dtype != np.uint8:
                    said = f"{frame.dtype} {frame.shape}"
                    raise ValueError(f"samples are {said}; expected uint8 {wanted}")
                part = f"the header of frame {number}"
                file.write(self.bytes_at(self._place(number), self.frame_size, part))
                file.write(frame[:, ::-1].tobytes())


class DdfFile(_SoundMetricsFile):
    """A DIDSON recording; a `Recording`."""

    layout = "ddf_frame"

    def _open(self) -> None:
        head = self.bytes_at(0, 4, "its first bytes")
        if head[:3] != SIGNATURE[:3]:
            raise FrameError(f"{self.path}: not a DIDSON recording (it begins with {head!r})")
        if head[3] not in _DDF_HEADERS:
            hint = "; rename it to .aris" if head == SIGNATURE else ""
            raise FrameError(f"{self.path}: DDF version {head[3]}; 3 and 4 can be read{hint}")
        self.file_size, self.frame_size = _DDF_HEADERS[head[3]]
        self._file_header = self.record_at(0, layouts()["ddf_file"], "its header")
        self.beams = int(self._file_header["numbeams"])
        if self.beams not in (48, 96):
            raise FrameError(f"{self.path}: has {self.beams} beams; a DIDSON has 48 or 96")
        ranges = self._file_header["samplesperchannel"]
        self.ranges = int(self.within("samplesperchannel", ranges, 2, MOST_RANGES))
        self._count_frames()

    def _read(self, number: int) -> SonarFrame:
        header = self._header(number)
        samples = self._samples(number)
        samples = samples if self._file_header["reverse"] else samples[:, ::-1]
        try:  # by the sonar's own clock, taken as UTC, else by that of the computer
            seconds = datetime(*header["date"].tolist()).replace(tzinfo=UTC).timestamp()
            time_s = seconds + min(max(int(header["hsecond"]), 0), 99) / 100
        except (ValueError, OverflowError):
            time_s = float(header["frametime"])
        return SonarFrame(
            number,
            np.ascontiguousarray(samples),
            Beams(_didson_azimuths_rad(self.beams), *self._window(header)),
            time_s=time_s or None,
            pose=pose_of(header),
            device=RecordingDevice(
                name="DIDSON",
                serial_number=int(self._file_header["serialnumber"]),
                gain_db=known(header["receivergain"], 100),
            ),
        )

    def _window(self, header: np.void) -> tuple[float, float]:
        """First and last range, metres."""
        step_m, lengths_m = _WINDOWS[int(header["configflags"]) & 3]
        high = bool(self._file_header["resolution"])
        rate_hz = float(self._file_header["samplerate"])
        near = step_m * self.within("windowstart", header["windowstart"], 0, 200)
        near *= 1 if high else 2
        code = int(header["windowlength"])
        # Where the code is none of the document's, the rate of the samples says how long the window
        # is, as Echoview reads it.
        if not 0 <= code <= 3 and np.isfinite(rate_hz) and rate_hz > 0:
            length = self.ranges * _SOUND_M_S / (2 * rate_hz)
            self.within("the length of the window", length, 0.1, MOST_RANGE_M)
        else:
            length = lengths_m[int(self.within("windowlength", code, 0, 3)) + (0 if high else 2)]
        return near, near + length


@cache
def beam_centres_deg() -> dict[str, tuple[float, ...]]:
    """Lens and number of beams -> bearings of the beams, from left to right, as lenses bend them.

    Of the BeamWidths_*.h files of the SDK, whose licence stands in the table.
    """
    rows = _table("aris_beams.csv")
    return {name: tuple(map(float, centres)) for name, *centres in rows}


@cache
def _didson_azimuths_rad(beams: int) -> tuple[float, ...]:
    """Bearings of the beams' centres: the lens bends them a little."""
    # The maker's polynomial gives the number of the beam (from 1) at a bearing in degrees.
    bearing = np.linspace(-16, 16, 3201)
    if beams == 96:
        number = 1.012 * (0.0030 * bearing**3 - 0.0055 * bearing**2 + 2.6829 * bearing + 48.04) + 1
    else:
        number = 0.0015 * bearing**3 - 0.0036 * bearing**2 + 1.3351 * bearing + 24.0976 + 1
    centres = np.interp(np.arange(1, beams + 1), number, bearing)
    return tuple(np.deg2rad(centres).tolist())


MAGIC = 0x4F53
LOG_MAGIC = 0x11223344
ITEM_MAGIC = 0xAABBCCDD
SONAR_ITEM = 10
SIMPLE_PING = 0x23
_SENDS_GAIN = 0x04
_MOST_BYTES = 1 << 26  # of one message


class _Message(NamedTuple):
    """The place of a message in a file."""

    offset: int
    size: int
    packed: bool = False  # by zlib behind four bytes
    time_s: float | None = None  # of the log


class OculusFile(Recording):
    """A file of raw Oculus messages or a log of ViewPoint; a `Recording` of its pings."""

    def _open(self) -> None:
        magic = int.from_bytes(self.bytes_at(0, 4, "its first bytes"), "little")
        if magic != LOG_MAGIC and magic & 0xFFFF != MAGIC:
            raise FrameError(f"{self.path}: not a file of raw Oculus messages")
        self._pings = list[_Message]()
        self._end = 0
        for message in self._messages(magic == LOG_MAGIC):
            header = _record(self._content(message, 16), "oculus_message")
            if header["id"] == MAGIC and header["kind"] == SIMPLE_PING:
                self._pings.append(message)
        self.count = len(self._pings)
        if not self.count:
            raise FrameError(f"{self.path}: holds no whole Oculus ping; it is cut short or damaged")
        if self._end < self.size:
            read = f"the {self.count} pings before are read"
            self.warning = f"{self.path}: damaged or cut short at byte {self._end}; {read}"

    def _messages(self, is_log: bool) -> Iterator[_Message]:
        """Each whole message of a log, or of a file that holds nothing else, up to `_end`."""
        layout = layouts()["viewpoint_item" if is_log else "oculus_message"]
        if is_log:
            log = self.record_at(0, layouts()["viewpoint_log"], "its header")
            if log["encryption"]:
                raise FrameError(f"{self.path}: is encrypted; export it from ViewPoint without")
            self._end = int(self.within("the size of its header", log["size"], 48, 4096))
        while self.size - self._end >= layout.itemsize:
            head = self.record_at(self._end, layout, "a header")
            if is_log:
                begins = self._end + int(head["size"])
                size = int(head["payload"])
                fits = head["magic"] == ITEM_MAGIC and layout.itemsize <= head["size"] <= 4096
            else:
                begins = self._end
                size = layout.itemsize + int(head["payload"])
                fits = head["id"] == MAGIC
            if not fits or begins + size > self.size:
                return
            self._end = begins + size
            if not is_log:
                yield _Message(begins, size)
            elif head["kind"] == SONAR_ITEM:
                yield _Message(begins, size, bool(head["compression"]), known(head["time_s"], 1e10))

    def _content(self, message: _Message, most: int = _MOST_BYTES) -> bytes:
        """The first bytes of a message, all by default."""
        if not message.packed:
            return self.bytes_at(message.offset, min(message.size, most), "a message")
        content = self.bytes_at(message.offset, message.size, "a message")
        with explained(f"{self.path}: a message cannot be unpacked; it is damaged"):
            return zlib.decompressobj().decompress(content[4:], most)

    def _read(self, number: int) -> SonarFrame:
        message = self._pings[number]
        name = f"ping {number}"
        content = self._content(message)
        second = _record(content, "oculus_message")["version"] == 2
        ping = _record(content, "oculus_ping_2" if second else "oculus_ping")
        ranges = int(self.within(f"{name}: nRanges", ping["ranges"], 2, MOST_RANGES))
        beams = int(self.within(f"{name}: nBeams", ping["beams"], 2, MOST_BEAMS))
        step = self.within(f"{name}: rangeResolution", ping["range_step_m"], 1e-5, 100)
        far = self.within(f"{name}: its last range", ranges * step, 0, MOST_RANGE_M)
        if ping.nbytes + 2 * beams > len(content):
            raise FrameError(f"{self.path}: {name} ends within its bearings; it is damaged")
        bearings = np.frombuffer(content, "<i2", count=beams, offset=ping.nbytes) / 100.0
        if np.any(np.diff(bearings) <= 0) or np.abs(bearings).max() > 90:
            raise FrameError(f"{self.path}: {name} has bearings in disorder; it is damaged")
        width = int(ping["data_size"]) + 1
        start = int(ping["image_offset"])
        if width > 2:
            raise FrameError(
                f"{self.path}: {name} has samples of {8 * width} bits; 8 and 16 can be read"
            )
        # Each row may begin with the gain that it was amplified by.
        extra = 4 if int(ping["flags"]) & _SENDS_GAIN else 0
        stride = extra + beams * width
        if start + ranges * stride > len(content):
            raise FrameError(f"{self.path}: {name} ends within its samples; it is damaged")
        rows = np.frombuffer(content, np.uint8, count=ranges * stride, offset=start)
        rows = np.ascontiguousarray(rows.reshape(ranges, stride)[:, extra:])
        return SonarFrame(
            number,
            rows if width == 1 else rows.view("<u2").astype(np.uint16),
            Beams(tuple(np.deg2rad(bearings).tolist()), 0.0, far),
            time_s=message.time_s or (known(ping["start_s"], 1e10) if second else None),
            pose=pose_of(ping),
            device=RecordingDevice(
                name="Oculus",
                serial_number=int(ping["source"]),
                frequency_khz=known(float(ping["frequency_hz"]) / 1000),
                sound_speed_m_s=known(ping["speed_m_s"], 1e4),
                gain_percent=known(ping["gain_percent"], 1e3),
            ),
        )


def _record(content: bytes, header: str) -> np.void:
    """The header that a message begins with; what is missing of it is 0, which is of no ping."""
    layout = layouts()[header]
    record: np.void = np.frombuffer(content.ljust(layout.itemsize, b"\0"), layout, count=1)[0]
    return record
