"""`.aris`: recordings of Sound Metrics' ARIS sonars.

After the ARIS File SDK (https://github.com/SoundMetrics/aris-file-sdk, MIT): a file header, then
frames of one size, each a header and one byte a sample, 0 to 80 dB, row by row from the nearest.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.errors import FrameError
from ...factory.files import explain_os_errors
from .base import (
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Device,
    FileOfFrames,
    Frame,
    Samples,
    known,
    layout_of,
    pose_of,
)

HEADER = 1024  # bytes, of the file and of each frame
SIGNATURE = 0x05464444  # "DDF" and 5
DECIBELS = 80.0

_AT = """
    FrameTime 4 u8  Version 12 u4  ReceiverGain 68 u4  Depth 128 f4  CompassHeading 160 f4
    CompassPitch 164 f4  CompassRoll 168 f4  Latitude 172 f8  Longitude 180 f8  SonarPan 244 f4
    SonarTilt 248 f4  PingMode 436 u4  FrequencyHiLow 440 u4  SamplePeriod 452 u4
    SoundSpeed 464 f4  SamplesPerBeam 468 u4  SampleStartDelay 476 u4  LargeLens 480 u4
    TheSystemType 484 u4  SonarSerialNumber 488 u4  ReorderedSamples 516 u4
"""
_POSE = "CompassHeading CompassPitch CompassRoll Depth SonarPan SonarTilt Latitude Longitude"
FRAME_HEADER = layout_of(_AT, HEADER)
"""The fields that are read; names and offsets of FrameHeader.h."""

_BEAMS_OF_PING_MODES = ((48, 1, 2), (96, 3, 5), (64, 6, 8), (128, 9, 12))
# System type -> name and its low and high frequency, kHz.
_SYSTEMS = {
    0: ("ARIS 1800", (1100, 1800)),
    1: ("ARIS 3000", (1800, 3000)),
    2: ("ARIS 1200", (700, 1200)),
}


class ArisFile(FileOfFrames):
    """An ARIS recording; a `Recording`."""

    def _open(self) -> None:
        head = self.bytes_at(0, 4, "its first bytes")
        if int.from_bytes(head, "little") != SIGNATURE:
            raise FrameError(f"{self.path}: not an ARIS recording (it begins with {head!r})")
        first = self._header(0, HEADER)
        self.beams = _beam_count(self, int(first["PingMode"]))
        self.ranges = int(self.within("SamplesPerBeam", first["SamplesPerBeam"], 2, MOST_RANGES))
        self._stride = HEADER + self.beams * self.ranges
        self._count = self.count_frames(HEADER, self._stride)

    def __len__(self) -> int:
        return self._count

    def _header(self, number: int, offset: int) -> np.void:
        content = self.bytes_at(offset, HEADER, f"the header of frame {number}")
        header: np.void = np.frombuffer(content, FRAME_HEADER)[0]
        if header["Version"] != SIGNATURE:
            raise FrameError(f"{self.path}: frame {number} has no frame's signature; it is damaged")
        return header

    def _read(self, number: int) -> Frame:
        offset = HEADER + number * self._stride
        header = self._header(number, offset)
        if (_beam_count(self, int(header["PingMode"])), header["SamplesPerBeam"]) != (
            self.beams,
            self.ranges,
        ):
            raise FrameError(f"{self.path}: frame {number} is not as large as the first")
        if not header["ReorderedSamples"]:
            raise FrameError(
                f"{self.path}: frame {number} holds samples in the order of the device, as only "
                "live streams do; record it with ARIScope"
            )
        content = self.bytes_at(offset + HEADER, self.beams * self.ranges, f"frame {number}")
        # Beam 0 is the rightmost.
        samples = np.frombuffer(content, np.uint8).reshape(self.ranges, self.beams)[:, ::-1]
        lens = _lens(header, self.beams)
        speed = self.within("SoundSpeed", float(header["SoundSpeed"]), 1000, 2000)
        half_metres = 1e-6 * speed / 2  # a microsecond, there and back
        near = half_metres * float(header["SampleStartDelay"])
        far = near + half_metres * float(header["SamplePeriod"]) * self.ranges
        self.within("the range of the last sample", far, near + 1e-3, MOST_RANGE_M)
        azimuths = np.deg2rad(beam_centres_deg()[lens])
        name, frequencies = _SYSTEMS.get(int(header["TheSystemType"]), ("ARIS", None))
        high = int(header["FrequencyHiLow"] != 0)
        return Frame(
            number,
            np.ascontiguousarray(samples),
            Beams(tuple(azimuths.tolist()), near, far),
            time_s=float(header["FrameTime"]) * 1e-6,
            pose=pose_of(header, _POSE),
            device=Device(
                name=name,
                serial_number=int(header["SonarSerialNumber"]),
                frequency_khz=frequencies[high] if frequencies else None,
                sound_speed_m_s=speed,
                gain_db=known(header["ReceiverGain"], 100),
                decibels=DECIBELS,
            ),
        )

    def rewrite(self, samples: Iterable[Samples], path: Path) -> None:
        """The same recording with other samples, in the same order, as another file.

        samples: (ranges, beams) uint8 of each frame, as `Frame.samples` has them.
        Raises ValueError for samples of another shape, type or number, FactoryError when `path`
        cannot be written.
        """
        partial = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        with explain_os_errors(path, "--out"):
            try:
                with partial.open("wb") as file:
                    file.write(self.bytes_at(0, HEADER, "its header"))
                    for number, frame in zip(range(len(self)), samples, strict=True):
                        offset = HEADER + number * self._stride
                        file.write(self.bytes_at(offset, HEADER, f"the header of frame {number}"))
                        file.write(self._bytes_of(frame))
                os.replace(partial, path)
            finally:
                partial.unlink(missing_ok=True)

    def _bytes_of(self, samples: npt.NDArray[np.uint8]) -> bytes:
        if samples.shape != (self.ranges, self.beams) or samples.dtype != np.uint8:
            raise ValueError(
                f"samples are {samples.dtype} {samples.shape}; expected uint8 "
                f"{(self.ranges, self.beams)}"
            )
        return samples[:, ::-1].tobytes()


@cache
def beam_centres_deg() -> dict[str, tuple[float, ...]]:
    """Lens and number of beams -> bearings of the beams, from left to right, as lenses bend them.

    Of the BeamWidths_*.h files of the SDK, whose licence stands in the table.
    """
    lines = Path(__file__).with_name("aris_beams.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    return {name: tuple(map(float, centres)) for name, *centres in rows}


def _beam_count(file: FileOfFrames, ping_mode: int) -> int:
    for beams, first, last in _BEAMS_OF_PING_MODES:
        if first <= ping_mode <= last:
            return beams
    file.within("PingMode", ping_mode, 1, 12)
    raise AssertionError(ping_mode)


def _lens(header: np.void, beams: int) -> str:
    """The beam table of a frame: by its number of beams, and whether a telephoto lens is on."""
    if beams in (64, 128):
        return f"3000_{beams}"
    return f"telephoto_{beams}" if header["LargeLens"] else f"1800_{beams}"
