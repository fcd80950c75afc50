"""Messages of ROS that hold a sonar's picture: what they say, and the same with other samples.

Messages may be those of rosbags or of rclpy, whose fields have the same names.  Types are those
that the standard packages and marine_acoustic_msgs define; what a bag says of its types is compared
with them and never run.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from copy import copy
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ...factory.errors import FrameError
from .base import (
    MOST_BEAMS,
    MOST_PIXELS,
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Device,
    Frame,
    Samples,
    known,
)
from .pictures import decoded

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

SONAR = "marine_acoustic_msgs/msg/ProjectedSonarImage"
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"

# https://github.com/apl-ocean-engineering/marine_msgs, whose field names and types these are.
_DEFINITIONS = {
    "marine_acoustic_msgs/msg/PingInfo": (
        "float32 frequency\nfloat32 sound_speed\nfloat32[] tx_beamwidths\nfloat32[] rx_beamwidths\n"
    ),
    "marine_acoustic_msgs/msg/SonarImageData": (
        "bool is_bigendian\nuint32 DTYPE_UINT8=0\nuint32 DTYPE_INT8=1\nuint32 DTYPE_UINT16=2\n"
        "uint32 DTYPE_INT16=3\nuint32 DTYPE_UINT32=4\nuint32 DTYPE_INT32=5\nuint32 DTYPE_UINT64=6\n"
        "uint32 DTYPE_INT64=7\nuint32 DTYPE_FLOAT32=8\nuint32 DTYPE_FLOAT64=9\nuint32 dtype\n"
        "uint32 beam_count\nuint8[] data\n"
    ),
    SONAR: (
        "std_msgs/Header header\nPingInfo ping_info\ngeometry_msgs/Vector3[] beam_directions\n"
        "float32[] ranges\nSonarImageData image\n"
    ),
}
# SonarImageData.DTYPE_* that a frame can hold.
_SONAR_DTYPES = {0: "u1", 2: "u2", 8: "f4"}
# Encoding of an Image -> type and number of its channels, which stay in their order.
_ENCODINGS = {
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1)),
    "32FC1": ("f4", 1),
    **dict.fromkeys(("rgb8", "bgr8", "8UC3"), ("u1", 3)),
    **dict.fromkeys(("rgba8", "bgra8", "8UC4"), ("u1", 4)),
    **dict.fromkeys(("rgb16", "bgr16", "16UC3"), ("u2", 3)),
}
_JPEG, _PNG = b"\xff\xd8", b"\x89PNG"


@lru_cache(maxsize=2)
def typestore(version: int) -> Typestore:
    """The types of ROS 1 or 2, with those of marine_acoustic_msgs."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def digest_of(msgtype: str, version: int) -> str:
    """What a bag must state as the fingerprint of a type: an MD5 in ROS 1, RIHS01 in ROS 2."""
    store = typestore(version)
    return store.generate_msgdef(msgtype)[1] if version == 1 else store.hash_rihs01(msgtype)


def frame_of(message: Any, msgtype: str, number: int, bag_time_s: float, what: str) -> Frame:
    """The frame in a message.

    bag_time_s: when it was recorded, taken where its header has no stamp.  what: names the message
    in errors.  Raises FrameError when its parts contradict each other or cannot be read.
    """
    stamp = message.header.stamp
    time_s = stamp.sec + stamp.nanosec * 1e-9 if stamp.sec or stamp.nanosec else bag_time_s
    name = message.header.frame_id or "unknown"
    if msgtype != SONAR:
        picture = _picture(message, what) if msgtype == IMAGE else _decoded(message, what)
        return Frame(number, _native(picture), time_s=time_s, device=Device(name))
    samples = _samples(message, what)
    info = message.ping_info
    device = Device(
        name,
        frequency_khz=known(info.frequency / 1000) or None,
        sound_speed_m_s=known(info.sound_speed, 1e4) or None,
    )
    return Frame(number, _native(samples), _beams(message, what), time_s, device=device)


def with_samples(message: Any, msgtype: str, samples: Samples, what: str) -> Any:
    """The same message with other samples, of the shape and type of those of its frame.

    A compressed picture is compressed as it was, JPEG at its best quality.
    Raises ValueError for samples of another shape or type.
    """
    if msgtype == COMPRESSED:
        before = _decoded(message, what)
        _same_form(samples, before)
        jpeg = _head(message) == _JPEG
        import cv2  # an extra

        options = [cv2.IMWRITE_JPEG_QUALITY, 100] if jpeg else []
        done, content = cv2.imencode(".jpg" if jpeg else ".png", samples, options)
        assert done
        data = content.tobytes()
        return _with(message, data=_like(message.data, data))
    # A copy of all bytes, so that what lies between the rows stays.
    if msgtype == IMAGE:
        changed = _with(message, data=_like(message.data, bytes(message.data)))
        target = _picture(changed, what)
    else:
        image = message.image
        image = _with(image, data=_like(image.data, bytes(image.data)))
        changed = _with(message, image=image)
        target = _samples(changed, what)
    _same_form(samples, target)
    target[...] = samples
    return changed


def _with(message: Any, **fields: Any) -> Any:
    changed = copy(message)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _like(data: Any, content: bytes) -> Any:
    """Bytes that may be written to, as rclpy (array) or rosbags (numpy) has them."""
    return array("B", content) if isinstance(data, array) else np.array(bytearray(content))


def _same_form(samples: Samples, before: Samples) -> None:
    if samples.shape != before.shape or samples.dtype != before.dtype.newbyteorder("="):
        raise ValueError(
            f"samples are {samples.dtype} {samples.shape}; expected {before.dtype} {before.shape}"
        )


def _native(samples: Samples) -> Samples:
    """As this machine orders bytes, and in one piece."""
    return np.ascontiguousarray(samples, samples.dtype.newbyteorder("="))


def _order(big: bool) -> str:
    return ">" if big else "<"


def _picture(message: Any, what: str) -> Samples:
    """The pixels of an Image, (H, W) or (H, W, channels), in its own memory."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    if message.encoding not in _ENCODINGS:
        raise FrameError(
            f"{what} has the encoding {str(message.encoding)[:40]!r}, which cannot be denoised "
            f"({', '.join(_ENCODINGS)})"
        )
    kind, channels = _ENCODINGS[message.encoding]
    dtype = np.dtype(_order(message.is_bigendian) + kind)
    row = width * channels * dtype.itemsize
    if not (
        0 < height * width <= MOST_PIXELS and row <= step and height * step == len(message.data)
    ):
        raise FrameError(
            f"{what} says {width} x {height} pixels in rows of {step} bytes, and holds "
            f"{len(message.data)} bytes; it is damaged"
        )
    strides = (step, channels * dtype.itemsize, dtype.itemsize)
    pixels: Samples = np.ndarray((height, width, channels), dtype, message.data, strides=strides)
    return pixels[..., 0] if channels == 1 else pixels


def _head(message: Any) -> bytes:
    data = bytes(message.data[:4])
    return next((kind for kind in (_JPEG, _PNG) if data.startswith(kind)), b"")


def _decoded(message: Any, what: str) -> Samples:
    """The pixels of a CompressedImage."""
    if not _head(message):
        raise FrameError(
            f"{what} is compressed as {str(message.format)[:40]!r}; JPEG and PNG can be read"
        )
    return decoded(bytes(message.data), what)


def _samples(message: Any, what: str) -> Samples:
    """(ranges, beams) of a ProjectedSonarImage, in its own memory."""
    image, ranges = message.image, len(message.ranges)
    beams = int(image.beam_count)
    if image.dtype not in _SONAR_DTYPES:
        raise FrameError(
            f"{what} has samples of type {image.dtype}; uint8 (0), uint16 (2) and float32 (8) can "
            "be read"
        )
    dtype = np.dtype(_order(image.is_bigendian) + _SONAR_DTYPES[image.dtype])
    held = len(image.data)
    if not (
        2 <= ranges <= MOST_RANGES
        and 2 <= beams <= MOST_BEAMS
        and beams == len(message.beam_directions)
        and ranges * beams * dtype.itemsize == held
    ):
        raise FrameError(
            f"{what} says {ranges} ranges, {beams} beams and {len(message.beam_directions)} "
            f"directions, and holds {held} bytes; it is damaged"
        )
    samples: Samples = np.ndarray((ranges, beams), dtype, image.data)
    return samples


def _beams(message: Any, what: str) -> Beams:
    """Where the samples lie.

    The message has z ahead, x up and y to the side.  Drivers do not agree on the sign of y, but
    store beams from left to right, so bearings are taken to ascend; some simulators have x ahead.
    """
    ahead, side = _axes(message.beam_directions)
    bearings = np.arctan2(side, ahead)
    if bearings[0] > bearings[-1]:
        bearings = -bearings
    ranges = np.asarray(message.ranges, np.float64)
    if not (np.isfinite(bearings).all() and np.all(np.diff(bearings) > 0)):
        raise FrameError(f"{what} has beams in disorder; it is damaged")
    if not np.abs(bearings).max() <= np.pi / 2:
        raise FrameError(
            f"{what} has beams that look back; sectors of up to 180 degrees can be read"
        )
    step = (ranges[-1] - ranges[0]) / (len(ranges) - 1)
    even = np.abs(ranges - np.linspace(ranges[0], ranges[-1], len(ranges))).max() < step
    if not (even and ranges[-1] + step / 2 <= MOST_RANGE_M and ranges[0] + step / 2 > 0):
        raise FrameError(
            f"{what} has ranges that do not ascend evenly from 0 m on; they cannot be used"
        )
    near = max(0.0, float(ranges[0] - step / 2))
    return Beams(tuple(bearings.tolist()), near, float(ranges[-1] + step / 2))


def _axes(
    directions: Sequence[Any],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    x, y, z = (np.array([getattr(one, k) for one in directions], np.float64) for k in "xyz")
    return (x, y) if np.abs(z).max() < 1e-6 else (z, y)
