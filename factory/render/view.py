"""The clean render of one frame in the few numbers that noise needs, and its compact form.

Depth and radiance of each surface pixel, rounded to equal steps of their logarithm (two bytes
each).  Every picture is made from the rounded numbers, whether they come from the renderer or from
a file, so what was cached gives the same bytes as what was not.

`FINE` is what the cache keeps.  Its steps are 0.02 % of the depth and 0.05 % of the radiance, so
rounding moves a point by at most 0.01 % of its distance, a fortieth of the farthest of 256 range
bins.  `SMALL` is for packs that travel: the same depth, so every point keeps its place, but one
radiance for 4x4 pixels.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import math
import struct
import sys
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ..frame import Frame, FrameRef, Intrinsics
from ..small_files import parse_json
from .base import Rendered
from .mount import Mount

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_NEAREST_M = 1e-3
_FAINTEST = 1e-9
_MAGIC = b"SFV2"
_CHECKSUM_BYTES = 16
# Four times those of a 4K video.
MOST_PIXELS = 1 << 25
_MOST_HEAD_BYTES = 1 << 16
_MOST_LZMA_BYTES = 1 << 26

Codes = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class Precision:
    """depth_step, radiance_step: relative.  block: pixels on an edge that share one radiance.

    codec: zstd is fast, lzma small.
    """

    depth_step: float
    radiance_step: float
    block: int
    codec: Literal["zstd", "lzma"]


_ZSTD = zstd.CompressionParameter
# Optional numbers of a view's head.
_NUMBERS = ("time_s", "altitude_m")

FINE = Precision(2e-4, 5e-4, 1, "zstd")
SMALL = Precision(2e-4, 0.1, 4, "lzma")


@dataclass(frozen=True, eq=False)
class View:
    """What the camera and an ideal sonar at `mount` know of each pixel.

    depth_m: (H, W) float32, 0 where there is no surface.
    radiance: (H, W) float32, see `simnfnd.factory.render.base.Rendered`; 0 in the sonar's shadow.
    segmentation, instance: labels of the pixels, see `frame.Frame`; None without labels.
    world_from_camera: (4, 4) float64 pose of the camera; None where the recording has none.
    time_s, altitude_m: see `frame.Frame`.  codes: depth and radiance as the cache keeps them.
    """

    depth_m: npt.NDArray[np.float32]
    radiance: npt.NDArray[np.float32]
    intrinsics: Intrinsics
    mount: Mount
    segmentation: npt.NDArray[np.uint8] | None = None
    instance: npt.NDArray[np.uint16] | None = None
    world_from_camera: npt.NDArray[np.float64] | None = None
    time_s: float | None = None
    altitude_m: float | None = None
    codes: tuple[Codes, Codes] | None = None

    def frame(self, ref: FrameRef) -> Frame:
        """The frame as noise needs it: black, for its colour has done its part in the albedo."""
        black = np.broadcast_to(np.uint8(0), (*self.depth_m.shape, 3))
        return Frame(
            ref,
            black,
            self.depth_m,
            self.intrinsics,
            self.world_from_camera,
            self.segmentation,
            self.instance,
            self.time_s,
            self.altitude_m,
        )

    def rendered(self) -> Rendered:
        """Radiance and surface."""
        return Rendered(self.radiance, self.depth_m > 0)


def view_of(frame: Frame, rendered: Rendered, mount: Mount) -> View:
    """The view of a frame that was just rendered, rounded as the cache keeps it."""
    found_m = np.where(rendered.surface, frame.depth_m, np.float32(0))
    depth, depth_m = _rounded(found_m, _NEAREST_M, FINE.depth_step)
    radiance_codes, radiance = _rounded(rendered.radiance, _FAINTEST, FINE.radiance_step)
    return View(
        depth_m,
        radiance,
        frame.intrinsics,
        mount,
        frame.segmentation,
        frame.instance,
        frame.world_from_camera,
        frame.time_s,
        frame.altitude_m,
        (depth, radiance_codes),
    )


def encode(view: View, precision: Precision = FINE) -> bytes:
    """The view as bytes; `decode(encode(view))` is the view itself when it was rounded alike."""
    from .cloud.planes import pack  # loads numba

    lit = view.radiance > 0
    codes = view.codes if precision == FINE else None
    if codes is None:
        radiance = _block_mean(view.radiance, lit, precision.block)
        depth, _ = _rounded(view.depth_m, _NEAREST_M, precision.depth_step)
        codes = depth, _rounded(radiance, _FAINTEST, precision.radiance_step)[0]
    planes = [pack(plane) for plane in codes]
    if precision.block > 1:
        planes.append(np.packbits(lit).tobytes())
    labelled = False
    if view.segmentation is not None and view.instance is not None:
        labelled = True
        planes += [view.segmentation.tobytes(), view.instance.astype("<u2").tobytes()]
    parts = [_compress(plane, precision.codec) for plane in planes]
    pose = view.world_from_camera
    head = {
        "shape": view.depth_m.shape,
        "intrinsics": asdict(view.intrinsics),
        "mount": asdict(view.mount),
        "world_from_camera": None if pose is None else pose.tolist(),
        **{name: getattr(view, name) for name in _NUMBERS if getattr(view, name) is not None},
        "precision": asdict(precision),
        "labelled": labelled,
        "parts": [len(part) for part in parts],
    }
    text = json.dumps(head).encode()
    return b"".join([_MAGIC, struct.pack("<I", len(text)), _checksum(text), text, *parts])


def decode(content: bytes) -> View:
    """The view that `encode` wrote.  Raises ValueError for anything else, one flipped bit too."""
    try:
        if content[:4] != _MAGIC:
            raise ValueError("no view of this version")
        (length,) = struct.unpack_from("<I", content, 4)
        if length > _MOST_HEAD_BYTES:
            raise ValueError(f"a head of {length} bytes")
        start = 8 + _CHECKSUM_BYTES
        text = content[start : start + length]
        if _checksum(text) != content[8:start]:
            raise ValueError("checksum differs")
        head = parse_json(text)
        precision = _checked_precision(Precision(**head["precision"]))
        height, width = head["shape"]
        # Either codec ends in a checksum of its own, which it compares.
        parts, start = [], start + length
        sizes = _plane_bytes(height, width, precision, labelled=bool(head["labelled"]))
        for packed, size in zip(head["parts"], sizes, strict=True):
            parts.append(_decompress(content[start : start + packed], precision.codec, size))
            start += packed
        if start != len(content):
            raise ValueError("too long")
        camera = {**head["intrinsics"], "distortion": tuple(head["intrinsics"]["distortion"])}
        mount = {**head["mount"], "translation_m": tuple(head["mount"]["translation_m"])}
        pose = head["world_from_camera"]
        more: dict[str, Any] = {name: _finite(head.get(name)) for name in _NUMBERS}
        if pose is not None:
            more["world_from_camera"] = np.array(pose, np.float64).reshape(4, 4)
        planes = _values(parts, (height, width), precision)
        view = View(*planes, _checked_intrinsics(Intrinsics(**camera)), Mount(**mount), **more)
        if not head["labelled"]:
            return view
        segmentation = np.frombuffer(parts[-2], np.uint8).reshape(height, width)
        instance = np.frombuffer(parts[-1], "<u2").astype(np.uint16).reshape(height, width)
        return replace(view, segmentation=segmentation, instance=instance)
    except (KeyError, TypeError, zstd.ZstdError, lzma.LZMAError, struct.error) as error:
        raise ValueError(f"damaged ({error})") from error


def _compress(content: bytes, codec: str) -> bytes:
    if codec == "zstd":
        # Level 1 is twice as fast as 3 and, on such planes, no larger.  Differences are noise: what
        # repeats is near, so the least table of places (2^6) is faster, and its output smaller.
        chosen: dict[int, int] = {_ZSTD.compression_level: 1, _ZSTD.hash_log: 6}
        return zstd.compress(content, options={**chosen, _ZSTD.checksum_flag: 1})
    return lzma.compress(content, preset=6)


def _decompress(content: bytes, codec: str, size: int) -> bytes:
    """The `size` bytes that a part stands for; it never makes more.  Raises ValueError."""
    unpacker: zstd.ZstdDecompressor | lzma.LZMADecompressor = (
        zstd.ZstdDecompressor()
        if codec == "zstd"
        else lzma.LZMADecompressor(memlimit=_MOST_LZMA_BYTES)
    )
    # One byte more, so that a longer stream shows and the stream's own checksum is read.
    plane = unpacker.decompress(content, size + 1)
    if len(plane) != size or not unpacker.eof or unpacker.unused_data:
        raise ValueError(f"a part does not hold {size} bytes")
    return plane


def _plane_bytes(height: int, width: int, precision: Precision, *, labelled: bool) -> list[int]:
    """Sizes of the planes that `encode` writes.  Raises ValueError for what is no picture."""
    if type(height) is not int or type(width) is not int or height < 1 or width < 1:
        raise ValueError(f"a picture of {str(height)[:20]} x {str(width)[:20]}")
    pixels = height * width
    if pixels > MOST_PIXELS:
        raise ValueError(f"a picture of {pixels} pixels; at most {MOST_PIXELS} go")
    blocks = -(-height // precision.block) * -(-width // precision.block)
    sizes = [2 * pixels, 2 * blocks]
    if precision.block > 1:
        sizes.append(-(-pixels // 8))
    return sizes + ([pixels, 2 * pixels] if labelled else [])


def _checked_precision(precision: Precision) -> Precision:
    steps = (precision.depth_step, precision.radiance_step)
    good = all(isinstance(step, float) and 0 < step < 1 for step in steps)
    if not good or precision.block not in range(1, 65) or precision.codec not in ("zstd", "lzma"):
        raise ValueError("no precision of a view")
    return precision


def _finite(value: object) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError("no time or altitude")
    return float(value)


def _checked_intrinsics(camera: Intrinsics) -> Intrinsics:
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
    good = all(isinstance(number, int | float) and math.isfinite(number) for number in numbers)
    if not good or camera.fx <= 0 or camera.fy <= 0 or len(camera.distortion) > 16:
        raise ValueError("no camera")
    return camera


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_CHECKSUM_BYTES).digest()


def _values(
    parts: list[bytes], shape: tuple[int, int], precision: Precision
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Depth and radiance of each pixel, (H, W) float32."""
    from .cloud.planes import unpack  # loads numba

    block = precision.block
    depth_m = unpack(parts[0], shape, _table(_NEAREST_M, precision.depth_step))
    blocks = (-(-shape[0] // block), -(-shape[1] // block))
    radiance = unpack(parts[1], blocks, _table(_FAINTEST, precision.radiance_step))
    if block > 1:
        bits = np.unpackbits(np.frombuffer(parts[2], np.uint8), count=shape[0] * shape[1])
        every = radiance.repeat(block, axis=0).repeat(block, axis=1)[: shape[0], : shape[1]]
        radiance = np.where(bits.reshape(shape).astype(np.bool_), every, np.float32(0))
    return depth_m, radiance


def _rounded(
    values: npt.NDArray[np.float32], low: float, step: float
) -> tuple[Codes, npt.NDArray[np.float32]]:
    """Code of each value, see `planes.rounded`, and what the code stands for."""
    from .cloud.planes import rounded  # loads numba

    return rounded(values, low, step, _table(low, step))


@lru_cache(maxsize=8)
def _table(low: float, step: float) -> npt.NDArray[np.float32]:
    """Value of each 16-bit code, damaged ones too."""
    power = np.minimum((np.arange(1 << 16) - 1) * step, 80.0)
    table: npt.NDArray[np.float32] = (low * np.exp(power)).astype(np.float32)
    table[0] = 0
    table.setflags(write=False)
    return table


def _block_mean(
    values: npt.NDArray[np.float32], chosen: npt.NDArray[np.bool_], block: int
) -> npt.NDArray[np.float32]:
    """Mean of the chosen values of each block; 0 where a block has none."""
    if block == 1:
        return np.where(chosen, values, np.float32(0))
    height, width = values.shape
    border = ((0, -height % block), (0, -width % block))
    sums = [
        np.pad(part, border).reshape(-(-height // block), block, -1, block).sum(axis=(1, 3))
        for part in (np.where(chosen, values, 0), chosen.astype(np.float32))
    ]
    return np.asarray(sums[0] / np.maximum(sums[1], 1), dtype=np.float32)
