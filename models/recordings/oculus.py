"""Raw messages of Blueprint Subsea's Oculus sonars, one after the other, as they come by network.

After the public headers of the Oculus SDK as liboculus (https://github.com/apl-ocean-engineering,
BSD) uses them: each message has a header of 16 bytes; a ping's goes on with the ping's settings, a
bearing a beam in hundredths of a degree, and the samples row by row from the nearest.  Messages of
other kinds are passed over.
"""

from __future__ import annotations

import numpy as np

from ...factory.errors import FrameError
from .base import (
    MOST_BEAMS,
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Device,
    FileOfFrames,
    Frame,
    Pose,
    Samples,
    known,
)

MAGIC = 0x4F53
SIMPLE_PING = 0x23
_SENDS_GAIN = 0x04
_MOST_BYTES = 1 << 26  # of one message

HEADER = np.dtype(
    [
        ("id", "<u2"),
        ("source", "<u2"),
        ("destination", "<u2"),
        ("kind", "<u2"),
        ("version", "<u2"),
        ("payload", "<u4"),
        ("spare", "<u2"),
    ]
)
_FIRE = [
    ("header", HEADER),
    ("mode", "u1"),
    ("ping_rate", "u1"),
    ("network_speed", "u1"),
    ("gamma", "u1"),
    ("flags", "u1"),
    ("range", "<f8"),
    ("gain_percent", "<f8"),
    ("speed_set", "<f8"),
    ("salinity", "<f8"),
]
_IMAGE = [("image_offset", "<u4"), ("image_size", "<u4"), ("message_size", "<u4")]
PING_1 = np.dtype(
    [
        *_FIRE,
        ("ping", "<u4"),
        ("status", "<u4"),
        ("frequency_hz", "<f8"),
        ("temperature", "<f8"),
        ("pressure", "<f8"),
        ("speed_m_s", "<f8"),
        ("start", "<u4"),
        ("data_size", "u1"),
        ("range_step_m", "<f8"),
        ("ranges", "<u2"),
        ("beams", "<u2"),
        *_IMAGE,
    ]
)
PING_2 = np.dtype(
    [
        *_FIRE,
        ("more_flags", "<u4", 9),
        ("ping", "<u4"),
        ("status", "<u4"),
        ("frequency_hz", "<f8"),
        ("temperature", "<f8"),
        ("pressure", "<f8"),
        ("heading", "<f8"),
        ("pitch", "<f8"),
        ("roll", "<f8"),
        ("speed_m_s", "<f8"),
        ("start_s", "<f8"),
        ("data_size", "u1"),
        ("range_step_m", "<f8"),
        ("ranges", "<u2"),
        ("beams", "<u2"),
        ("spare", "<u4", 4),
        *_IMAGE,
    ]
)


class OculusFile(FileOfFrames):
    """A file of raw Oculus messages; a `Recording` of its pings."""

    def _open(self) -> None:
        self._pings = self._find_pings()

    def _find_pings(self) -> list[tuple[int, int, int]]:
        """(offset, bytes, version) of each ping."""
        pings = []
        offset = 0
        while offset < self.size:
            left = self.size - offset
            header = None
            if left >= HEADER.itemsize:
                header = np.frombuffer(self.bytes_at(offset, HEADER.itemsize, ""), HEADER)[0]
            if header is None or header["id"] != MAGIC:
                if not offset:
                    raise FrameError(f"{self.path}: not a file of raw Oculus messages")
                break
            size = HEADER.itemsize + int(header["payload"])
            if size > min(left, _MOST_BYTES):
                break
            if header["kind"] == SIMPLE_PING:
                pings.append((offset, size, int(header["version"])))
            offset += size
        if not pings:
            raise FrameError(f"{self.path}: holds no whole Oculus ping; it is cut short or damaged")
        if offset < self.size:
            self.warning = (
                f"{self.path}: damaged or cut short at byte {offset}; the {len(pings)} pings "
                "before are read"
            )
        return pings

    def __len__(self) -> int:
        return len(self._pings)

    def _read(self, number: int) -> Frame:
        offset, size, version = self._pings[number]
        layout = PING_2 if version == 2 else PING_1
        what = f"ping {number}"
        if size < layout.itemsize:
            raise FrameError(f"{self.path}: {what} is shorter than its header; it is damaged")
        content = self.bytes_at(offset, size, what)
        ping: np.void = np.frombuffer(content, layout, count=1)[0]
        ranges = int(self.within(f"{what}: nRanges", ping["ranges"], 2, MOST_RANGES))
        beams = int(self.within(f"{what}: nBeams", ping["beams"], 2, MOST_BEAMS))
        step = self.within(f"{what}: rangeResolution", ping["range_step_m"], 1e-5, 100)
        far = self.within(f"{what}: its last range", ranges * step, 0, MOST_RANGE_M)
        if layout.itemsize + 2 * beams > size:
            raise FrameError(f"{self.path}: {what} ends within its bearings; it is damaged")
        bearings = np.frombuffer(content, "<i2", count=beams, offset=layout.itemsize) / 100.0
        if np.any(np.diff(bearings) <= 0) or np.abs(bearings).max() > 90:
            raise FrameError(f"{self.path}: {what} has bearings in disorder; it is damaged")
        return Frame(
            number,
            self._samples(content, ping, ranges, beams, what),
            Beams(tuple(np.deg2rad(bearings).tolist()), 0.0, far),
            time_s=float(ping["start_s"])
            if version == 2 and np.isfinite(ping["start_s"])
            else None,
            pose=_pose(ping) if version == 2 else Pose(),
            device=Device(
                name="Oculus",
                serial_number=int(ping["header"]["source"]),
                frequency_khz=known(float(ping["frequency_hz"]) / 1000),
                sound_speed_m_s=known(ping["speed_m_s"], 1e4),
                gain_percent=known(ping["gain_percent"], 1e3),
            ),
        )

    def _samples(
        self, content: bytes, ping: np.void, ranges: int, beams: int, what: str
    ) -> Samples:
        """(ranges, beams) uint8 or uint16."""
        if ping["data_size"] not in (0, 1):
            raise FrameError(
                f"{self.path}: {what} has samples of {8 * (int(ping['data_size']) + 1)} bits; "
                "8 and 16 can be read"
            )
        width = int(ping["data_size"]) + 1
        # Each row may begin with the gain that it was amplified by.
        extra = 4 if int(ping["flags"]) & _SENDS_GAIN else 0
        stride = extra + beams * width
        start = int(ping["image_offset"])
        if start + ranges * stride > len(content):
            raise FrameError(f"{self.path}: {what} ends within its samples; it is damaged")
        rows = np.frombuffer(content, np.uint8, count=ranges * stride, offset=start)
        rows = np.ascontiguousarray(rows.reshape(ranges, stride)[:, extra:])
        return rows if width == 1 else rows.view("<u2").astype(np.uint16)


def _pose(ping: np.void) -> Pose:
    return Pose(
        heading_deg=known(ping["heading"], 360),
        pitch_deg=known(ping["pitch"], 360),
        roll_deg=known(ping["roll"], 360),
    )
