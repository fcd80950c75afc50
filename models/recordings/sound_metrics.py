"""Recordings of Sound Metrics' sonars: ARIS (`.aris`) and DIDSON (`.ddf`, versions 3 and 4).

A file header, then frames of one size, each a header and one byte a sample, row by row from the
nearest.  ARIS after the ARIS File SDK (https://github.com/SoundMetrics/aris-file-sdk, MIT), DIDSON
after "DIDSON V5.26 Data File and Ethernet Structure" as public readers of it agree.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np

from ...factory.errors import FrameError
from ...factory.files import explain_os_errors
from .base import (
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Device,
    Frame,
    Recording,
    Samples,
    known,
    layout_of,
    pose_of,
)

SIGNATURE = b"DDF\5"
"""Of an ARIS file and of each of its frames."""

# The fields that are read; offsets of FrameHeader.h, names too but for the pose.
_ARIS_FRAME = layout_of(
    """
    FrameTime 4 u8  Version 12 S4  ReceiverGain 68 u4  depth_m 128 f4  heading_deg 160 f4
    pitch_deg 164 f4  roll_deg 168 f4  latitude_deg 172 f8  longitude_deg 180 f8  pan_deg 244 f4
    tilt_deg 248 f4  PingMode 436 u4  FrequencyHiLow 440 u4  SamplePeriod 452 u4
    SoundSpeed 464 f4  SamplesPerBeam 468 u4  SampleStartDelay 476 u4  LargeLens 480 u4
    TheSystemType 484 u4  SonarSerialNumber 488 u4  ReorderedSamples 516 u4
    """,
    1024,
)
_BEAMS_OF_PING_MODES = {
    **dict.fromkeys((1, 2), 48),
    **dict.fromkeys((3, 4, 5), 96),
    **dict.fromkeys((6, 7, 8), 64),
    **dict.fromkeys((9, 10, 11, 12), 128),
}
# System type -> name and its low and high frequency, kHz.
_SYSTEMS = {
    0: ("ARIS 1800", (1100, 1800)),
    1: ("ARIS 3000", (1800, 3000)),
    2: ("ARIS 1200", (700, 1200)),
}

# Version -> bytes of the file's and of a frame's header; both have the fields at the same places.
_DDF_HEADERS = {3: (512, 256), 4: (1024, 1024)}
_DDF_FILE = layout_of(
    """
    resolution 12 i4  numbeams 16 i4  samplerate 20 f4  samplesperchannel 24 i4  reverse 40 i4
    serialnumber 44 i4
    """,
    512,
)
_DDF_FRAME = layout_of(
    """
    frametime 4 u4  date 20 6i4  hsecond 44 i4  windowstart 52 i4  windowlength 56 i4
    receivergain 68 i4  depth_m 128 f4  pitch_deg 136 f4  roll_deg 144 f4  heading_deg 152 f4
    pan_deg 160 f4  tilt_deg 164 f4  latitude_deg 172 f8  longitude_deg 180 f8  configflags 192 i4
    """,
    256,
)
_CLASSIC, _LONG_RANGE = 1, 2
# Configuration flags -> metres a step of the window's start at high frequency (twice that at low),
# and window lengths in metres, of codes 0 to 3 (HF) or 2 to 5 (LF).
_WINDOWS = {
    0: (0.419, (1.25, 2.5, 5.0, 10.0, 20.0, 40.0)),
    _CLASSIC: (0.375, (1.125, 2.25, 4.5, 9.0, 18.0, 36.0)),
    _LONG_RANGE: (0.419, (2.5, 5.0, 10.0, 20.0, 40.0, 70.0)),
    _CLASSIC | _LONG_RANGE: (0.375, (2.25, 4.5, 9.0, 18.0, 36.0, 72.0)),
}
_SOUND_M_S = 1500.0


class _SoundMetricsFile(Recording):
    """What both formats share.

    beams, ranges: of every frame.  file_size, frame_size: bytes of a header.  layout: of a frame's.
    """

    beams = ranges = 0
    file_size = frame_size = 1024
    layout: np.dtype[np.void]

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
        return self.record_at(self._place(number), self.layout, f"the header of frame {number}")

    def _samples(self, number: int) -> Samples:
        """(ranges, beams) uint8, beams as they are stored."""
        offset, count = self._place(number) + self.frame_size, self.beams * self.ranges
        content = self.bytes_at(offset, count, f"frame {number}")
        return np.frombuffer(content, np.uint8).reshape(self.ranges, self.beams)


class ArisFile(_SoundMetricsFile):
    """An ARIS recording; a `Recording`."""

    layout = _ARIS_FRAME

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
        return _BEAMS_OF_PING_MODES[int(self.within("PingMode", int(header["PingMode"]), 1, 12))]

    def _read(self, number: int) -> Frame:
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
        name, frequencies = _SYSTEMS.get(int(header["TheSystemType"]), ("ARIS", None))
        high = int(header["FrequencyHiLow"] != 0)
        return Frame(
            number,
            np.ascontiguousarray(self._samples(number)[:, ::-1]),  # beam 0 is the rightmost
            Beams(tuple(azimuths.tolist()), near, far),
            time_s=float(header["FrameTime"]) * 1e-6,
            pose=pose_of(header),
            device=Device(
                name=name,
                serial_number=int(header["SonarSerialNumber"]),
                frequency_khz=frequencies[high] if frequencies else None,
                sound_speed_m_s=speed,
                gain_db=known(header["ReceiverGain"], 100),
            ),
        )

    def rewrite(self, samples: Iterable[Samples], path: Path) -> None:
        """The same recording with other samples, in the same order, as another file.

        samples: (ranges, beams) uint8 of each frame, as `Frame.samples` has them.
        Raises ValueError for samples of another shape, type or number, FactoryError when `path`
        cannot be written.
        """
        partial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        wanted = self.ranges, self.beams
        with explain_os_errors(path, "--out"):
            try:
                with partial.open("wb") as file:
                    file.write(self.bytes_at(0, self.file_size, "its header"))
                    for number, frame in zip(range(self.count), samples, strict=True):
                        if frame.shape != wanted or frame.dtype != np.uint8:
                            said = f"{frame.dtype} {frame.shape}"
                            raise ValueError(f"samples are {said}; expected uint8 {wanted}")
                        what = f"the header of frame {number}"
                        file.write(self.bytes_at(self._place(number), self.frame_size, what))
                        file.write(frame[:, ::-1].tobytes())
                os.replace(partial, path)
            finally:
                partial.unlink(missing_ok=True)


class DdfFile(_SoundMetricsFile):
    """A DIDSON recording; a `Recording`."""

    layout = _DDF_FRAME

    def _open(self) -> None:
        head = self.bytes_at(0, 4, "its first bytes")
        if head[:3] != SIGNATURE[:3]:
            raise FrameError(f"{self.path}: not a DIDSON recording (it begins with {head!r})")
        if head[3] not in _DDF_HEADERS:
            hint = "; rename it to .aris" if head == SIGNATURE else ""
            raise FrameError(f"{self.path}: DDF version {head[3]}; 3 and 4 can be read{hint}")
        self.file_size, self.frame_size = _DDF_HEADERS[head[3]]
        self._told = self.record_at(0, _DDF_FILE, "its header")
        self.beams = int(self._told["numbeams"])
        if self.beams not in (48, 96):
            raise FrameError(f"{self.path}: has {self.beams} beams; a DIDSON has 48 or 96")
        ranges = self._told["samplesperchannel"]
        self.ranges = int(self.within("samplesperchannel", ranges, 2, MOST_RANGES))
        self._count_frames()

    def _read(self, number: int) -> Frame:
        header, samples = self._header(number), self._samples(number)
        near, far = self._window(header)
        samples = samples if self._told["reverse"] else samples[:, ::-1]
        return Frame(
            number,
            np.ascontiguousarray(samples),
            Beams(_didson_azimuths_rad(self.beams), near, far),
            time_s=_time_s(header),
            pose=pose_of(header),
            device=Device(
                name="DIDSON",
                serial_number=int(self._told["serialnumber"]),
                gain_db=known(header["receivergain"], 100),
            ),
        )

    def _window(self, header: np.void) -> tuple[float, float]:
        """First and last range, metres.

        Where the code of the window's length is none of the document's, the rate of the samples
        says how long it is, as Echoview reads it.
        """
        step_m, lengths_m = _WINDOWS[int(header["configflags"]) & (_CLASSIC | _LONG_RANGE)]
        high, rate_hz = bool(self._told["resolution"]), float(self._told["samplerate"])
        start = self.within("windowstart", header["windowstart"], 0, 200)
        near = step_m * start * (1 if high else 2)
        code = int(header["windowlength"])
        if not 0 <= code <= 3 and np.isfinite(rate_hz) and rate_hz > 0:
            length = self.ranges * _SOUND_M_S / (2 * rate_hz)
            self.within("the length of the window", length, 0.1, MOST_RANGE_M)
        else:
            code = int(self.within("windowlength", code, 0, 3))
            length = lengths_m[code + (0 if high else 2)]
        return near, near + length


@cache
def beam_centres_deg() -> dict[str, tuple[float, ...]]:
    """Lens and number of beams -> bearings of the beams, from left to right, as lenses bend them.

    Of the BeamWidths_*.h files of the SDK, whose licence stands in the table.
    """
    lines = Path(__file__).with_name("aris_beams.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    return {name: tuple(map(float, centres)) for name, *centres in rows}


@cache
def _didson_azimuths_rad(beams: int) -> tuple[float, ...]:
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
    date = header["date"].tolist()  # year to second
    try:
        start_s = datetime(*date, tzinfo=UTC).timestamp()
    except (ValueError, OverflowError):
        return float(header["frametime"]) or None
    return start_s + min(max(int(header["hsecond"]), 0), 99) / 100
