"""`.ddf`: recordings of DIDSON sonars, versions 3 and 4 of the format.

After "DIDSON V5.26 Data File and Ethernet Structure" as public readers of it agree: a file header,
then frames of one size, each a header and one byte a sample, row by row from the nearest.  Where
the code of the window's length is none of the document's, the rate of the samples says how long it
is, as Echoview reads it.
"""

from __future__ import annotations

import calendar
from functools import lru_cache

import numpy as np

from ...factory.errors import FrameError
from .base import (
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Device,
    FileOfFrames,
    Frame,
    known,
    layout_of,
    pose_of,
)

# Version -> bytes of the file's and of a frame's header.
HEADERS = {3: (512, 256), 4: (1024, 1024)}
DECIBELS = 90.0

_FILE_AT = """
    numframes 4 i4  resolution 12 i4  numbeams 16 i4  samplerate 20 f4  samplesperchannel 24 i4
    reverse 40 i4  serialnumber 44 i4
"""
_FRAME_AT = """
    frametime 4 u4  year 20 i4  month 24 i4  day 28 i4  hour 32 i4  minute 36 i4  second 40 i4
    hsecond 44 i4  windowstart 52 i4  windowlength 56 i4  receivergain 68 i4  depth 128 f4
    pitch 136 f4  roll 144 f4  heading 152 f4  sonarpan 160 f4  sonartilt 164 f4
    latitude 172 f8  longitude 180 f8  configflags 192 i4
"""
_POSE = "heading pitch roll depth sonarpan sonartilt latitude longitude"
FILE_HEADER = layout_of(_FILE_AT, HEADERS[3][0])
FRAME_HEADER = layout_of(_FRAME_AT, HEADERS[3][1])
"""The fields that are read; both versions have them at the same places."""

_CLASSIC, _LONG_RANGE = 1, 2
# Configuration flags -> window lengths in metres, of codes 0 to 3 (HF) or 2 to 5 (LF).
_LENGTHS_M = {
    0: (1.25, 2.5, 5.0, 10.0, 20.0, 40.0),
    _CLASSIC: (1.125, 2.25, 4.5, 9.0, 18.0, 36.0),
    _LONG_RANGE: (2.5, 5.0, 10.0, 20.0, 40.0, 70.0),
    _CLASSIC | _LONG_RANGE: (2.25, 4.5, 9.0, 18.0, 36.0, 72.0),
}
# Metres a step of the window's start at high frequency; twice that at low.
_SOUND_M_S = 1500.0
_START_M = {0: 0.419, _CLASSIC: 0.375, _LONG_RANGE: 0.419, _CLASSIC | _LONG_RANGE: 0.375}


class DdfFile(FileOfFrames):
    """A DIDSON recording; a `Recording`."""

    def _open(self) -> None:
        head = self.bytes_at(0, 4, "its first bytes")
        if head[:3] != b"DDF":
            raise FrameError(f"{self.path}: not a DIDSON recording (it begins with {head!r})")
        if head[3] not in HEADERS:
            hint = "; rename it to .aris" if head[3] == 5 else ""
            raise FrameError(f"{self.path}: DDF version {head[3]}; 3 and 4 can be read{hint}")
        self.version = head[3]
        self._file_size, self._frame_size = HEADERS[self.version]
        content = self.bytes_at(0, FILE_HEADER.itemsize, "its header")
        header = np.frombuffer(content, FILE_HEADER)[0]
        self.beams = int(header["numbeams"])
        if self.beams not in (48, 96):
            raise FrameError(f"{self.path}: has {self.beams} beams; a DIDSON has 48 or 96")
        self.ranges = int(
            self.within("samplesperchannel", header["samplesperchannel"], 2, MOST_RANGES)
        )
        self._high = header["resolution"] != 0
        self._reverse = header["reverse"] != 0
        self._serial = int(header["serialnumber"])
        self._rate_hz = float(header["samplerate"])
        self._stride = self._frame_size + self.beams * self.ranges
        self._count = self.count_frames(self._file_size, self._stride)

    def __len__(self) -> int:
        return self._count

    def _read(self, number: int) -> Frame:
        offset = self._file_size + number * self._stride
        content = self.bytes_at(offset, FRAME_HEADER.itemsize, f"the header of frame {number}")
        header: np.void = np.frombuffer(content, FRAME_HEADER)[0]
        near, far = self._window(header)
        content = self.bytes_at(
            offset + self._frame_size, self.beams * self.ranges, f"frame {number}"
        )
        samples = np.frombuffer(content, np.uint8).reshape(self.ranges, self.beams)
        if not self._reverse:
            samples = samples[:, ::-1]
        return Frame(
            number,
            np.ascontiguousarray(samples),
            Beams(beam_azimuths_rad(self.beams), near, far),
            time_s=_time_s(header),
            pose=pose_of(header, _POSE),
            device=Device(
                name="DIDSON",
                serial_number=self._serial,
                gain_db=known(header["receivergain"], 100),
                decibels=DECIBELS,
            ),
        )

    def _window(self, header: np.void) -> tuple[float, float]:
        """First and last range, metres: by the code of the window's length, else by the samples."""
        flags = int(header["configflags"]) & (_CLASSIC | _LONG_RANGE)
        # Devices older than the flags.
        if self._serial == 15:
            flags = _CLASSIC | _LONG_RANGE
        elif self._serial < 19:
            flags = _CLASSIC
        start = self.within("windowstart", header["windowstart"], 0, 200)
        near = _START_M[flags] * start * (1 if self._high else 2)
        code, rate_hz = int(header["windowlength"]), self._rate_hz
        if not 0 <= code <= 3 and np.isfinite(rate_hz) and rate_hz > 0:
            length = self.ranges * _SOUND_M_S / (2 * rate_hz)
            self.within("the length of the window", length, 0.1, MOST_RANGE_M)
        else:
            code = int(self.within("windowlength", code, 0, 3))
            length = _LENGTHS_M[flags][code + (0 if self._high else 2)]
        return near, near + length


@lru_cache(maxsize=2)
def beam_azimuths_rad(beams: int) -> tuple[float, ...]:
    """Bearings of the beams' centres: the lens bends them a little.

    The maker's polynomial gives the number of the beam (from 1) at a bearing in degrees.
    """
    bearing = np.linspace(-16, 16, 3201)
    if beams == 96:
        number = 1.012 * (0.0030 * bearing**3 - 0.0055 * bearing**2 + 2.6829 * bearing + 48.04) + 1
    else:
        number = 0.0015 * bearing**3 - 0.0036 * bearing**2 + 1.3351 * bearing + 24.0976 + 1
    centres = np.interp(np.arange(1, beams + 1), number, bearing)
    return tuple(np.deg2rad(centres).tolist())


def _time_s(header: np.void) -> float | None:
    """By the sonar's own clock, taken as UTC, else by that of the computer; None without either."""
    date = [int(header[name]) for name in ("year", "month", "day", "hour", "minute", "second")]
    lowest, highest = (1990, 1, 1, 0, 0, 0), (2100, 12, 31, 23, 59, 60)
    if not all(a <= b <= c for a, b, c in zip(lowest, date, highest, strict=True)):
        return float(header["frametime"]) or None
    return calendar.timegm((*date, 0, 0, 0)) + min(max(int(header["hsecond"]), 0), 99) / 100
