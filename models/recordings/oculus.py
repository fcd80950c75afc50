"""Pings of Blueprint Subsea's Oculus sonars: raw messages as they come by network, and logs.

After the public headers of the Oculus SDK as liboculus (https://github.com/apl-ocean-engineering,
BSD) uses them: each message has a header of 16 bytes; a ping's goes on with the ping's settings, a
bearing a beam in hundredths of a degree, and the samples row by row from the nearest.  Messages of
other kinds are passed over.  A log of ViewPoint (.oculus) is a header of 48 bytes and items of 40
and more, of which those of kind 10 hold a message each, plain or packed by zlib.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...factory.errors import FrameError
from .base import (
    MOST_BEAMS,
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Device,
    Frame,
    Recording,
    Samples,
    explained,
    known,
    layout_of,
    pose_of,
)

MAGIC = 0x4F53
LOG_MAGIC, ITEM_MAGIC, SONAR_ITEM = 0x11223344, 0xAABBCCDD, 10
SIMPLE_PING = 0x23
_SENDS_GAIN = 0x04
_MOST_BYTES = 1 << 26  # of one message

_MESSAGE = "id u2  source u2  destination u2  kind u2  version u2  payload u4  unused u2 "
_FIRE = (
    _MESSAGE
    + """
    mode u1  ping_rate u1  network_speed u1  gamma u1  flags u1
    range f8  gain_percent f8  speed_set f8  salinity f8
"""
)
_IMAGE = " image_offset u4  image_size u4  message_size u4"
HEADER = layout_of(_MESSAGE)
PING_1 = layout_of(
    f"""{_FIRE} ping u4  status u4  frequency_hz f8  temperature f8  pressure f8  speed_m_s f8
    start u4  data_size u1  range_step_m f8  ranges u2  beams u2  {_IMAGE}"""
)
PING_2 = layout_of(
    f"""{_FIRE} more_flags V36  ping u4  status u4  frequency_hz f8  temperature f8  pressure f8
    heading_deg f8  pitch_deg f8  roll_deg f8  speed_m_s f8  start_s f8  data_size u1
    range_step_m f8  ranges u2  beams u2  spare V16  {_IMAGE}"""
)
LOG = layout_of(
    "magic u4  size u4  source S16  version u2  encryption u2  spare u4  key i8  time f8"
)
ITEM = layout_of(
    """magic u4  size u4  kind u2  version u2  spare u4  time_s f8  compression u2  more u2
    unpacked u4  payload u4"""
)


class _Message(NamedTuple):
    """Where a message lies; packed: by zlib behind four bytes.  time_s: of the log, where known."""

    offset: int
    size: int
    packed: bool = False
    time_s: float | None = None


class OculusFile(Recording):
    """A file of raw Oculus messages or a log of ViewPoint; a `Recording` of its pings."""

    def _open(self) -> None:
        magic = int.from_bytes(self.bytes_at(0, 4, "its first bytes"), "little")
        if magic != LOG_MAGIC and magic & 0xFFFF != MAGIC:
            raise FrameError(f"{self.path}: not a file of raw Oculus messages")
        self._pings: list[_Message] = []
        self._end = 0
        for one in self._items() if magic == LOG_MAGIC else self._messages():
            header = _record(self._content(one, HEADER.itemsize), HEADER)
            if header["id"] == MAGIC and header["kind"] == SIMPLE_PING:
                self._pings.append(one)
        self.count = len(self._pings)
        if not self.count:
            raise FrameError(f"{self.path}: holds no whole Oculus ping; it is cut short or damaged")
        if self._end < self.size:
            self.warning = (
                f"{self.path}: damaged or cut short at byte {self._end}; the {self.count} pings "
                "before are read"
            )

    def _messages(self) -> Iterator[_Message]:
        """Each whole message of a file that holds nothing else; `_end`: where the last one ends."""
        while self.size - self._end >= HEADER.itemsize:
            header = self.record_at(self._end, HEADER, "a header")
            one = _Message(self._end, HEADER.itemsize + int(header["payload"]))
            if header["id"] != MAGIC or one.size > min(self.size - self._end, _MOST_BYTES):
                return
            self._end += one.size
            yield one

    def _items(self) -> Iterator[_Message]:
        """The same of a log."""
        log = self.record_at(0, LOG, "its header")
        if log["encryption"]:
            raise FrameError(f"{self.path}: is encrypted; export it from ViewPoint without")
        self._end = int(self.within("the size of its header", log["size"], LOG.itemsize, 4096))
        while self.size - self._end >= ITEM.itemsize:
            item = self.record_at(self._end, ITEM, "an item")
            begins, size = self._end + int(item["size"]), int(item["payload"])
            if (
                item["magic"] != ITEM_MAGIC
                or not ITEM.itemsize <= item["size"] <= 4096
                or size > min(self.size - begins, _MOST_BYTES)
            ):
                return
            self._end = begins + size
            if item["kind"] == SONAR_ITEM:
                yield _Message(begins, size, bool(item["compression"]), known(item["time_s"], 1e10))

    def _content(self, one: _Message, most: int = _MOST_BYTES) -> bytes:
        """The first bytes of a message, all by default."""
        if not one.packed:
            return self.bytes_at(one.offset, min(one.size, most), "a message")
        content = self.bytes_at(one.offset, one.size, "a message")
        with explained(f"{self.path}: a message cannot be unpacked; it is damaged"):
            return zlib.decompressobj().decompress(content[4:], most)

    def _read(self, number: int) -> Frame:
        one, what = self._pings[number], f"ping {number}"
        content = self._content(one)
        second = _record(content, HEADER)["version"] == 2
        layout = PING_2 if second else PING_1
        ping = _record(content, layout)
        ranges = int(self.within(f"{what}: nRanges", ping["ranges"], 2, MOST_RANGES))
        beams = int(self.within(f"{what}: nBeams", ping["beams"], 2, MOST_BEAMS))
        step = self.within(f"{what}: rangeResolution", ping["range_step_m"], 1e-5, 100)
        far = self.within(f"{what}: its last range", ranges * step, 0, MOST_RANGE_M)
        if layout.itemsize + 2 * beams > len(content):
            raise FrameError(f"{self.path}: {what} ends within its bearings; it is damaged")
        bearings = np.frombuffer(content, "<i2", count=beams, offset=layout.itemsize) / 100.0
        if np.any(np.diff(bearings) <= 0) or np.abs(bearings).max() > 90:
            raise FrameError(f"{self.path}: {what} has bearings in disorder; it is damaged")
        return Frame(
            number,
            self._samples(content, ping, ranges, beams, what),
            Beams(tuple(np.deg2rad(bearings).tolist()), 0.0, far),
            time_s=one.time_s or (known(ping["start_s"], 1e10) if second else None),
            pose=pose_of(ping),
            device=Device(
                name="Oculus",
                serial_number=int(ping["source"]),
                frequency_khz=known(float(ping["frequency_hz"]) / 1000),
                sound_speed_m_s=known(ping["speed_m_s"], 1e4),
                gain_percent=known(ping["gain_percent"], 1e3),
            ),
        )

    def _samples(
        self, content: bytes, ping: np.void, ranges: int, beams: int, what: str
    ) -> Samples:
        """(ranges, beams) uint8 or uint16."""
        width = int(ping["data_size"]) + 1
        if width > 2:
            raise FrameError(
                f"{self.path}: {what} has samples of {8 * width} bits; 8 and 16 can be read"
            )
        # Each row may begin with the gain that it was amplified by.
        extra = 4 if int(ping["flags"]) & _SENDS_GAIN else 0
        stride, start = extra + beams * width, int(ping["image_offset"])
        if start + ranges * stride > len(content):
            raise FrameError(f"{self.path}: {what} ends within its samples; it is damaged")
        rows = np.frombuffer(content, np.uint8, count=ranges * stride, offset=start)
        rows = np.ascontiguousarray(rows.reshape(ranges, stride)[:, extra:])
        return rows if width == 1 else rows.view("<u2").astype(np.uint16)


def _record(content: bytes, layout: np.dtype[np.void]) -> np.void:
    """The header that a message begins with; what is missing of it is 0, which is of no ping."""
    record: np.void = np.frombuffer(content.ljust(layout.itemsize, b"\0"), layout, count=1)[0]
    return record
