"""The clean render of one frame in the few numbers that noise needs, and its compact form.

Depth and radiance of each surface pixel, rounded to equal steps of their logarithm (two bytes
each).  Every image is made from the rounded numbers, whether they come from the renderer or from
a file, so what was cached gives the same bytes as what was not.  The steps are 0.02 % of the depth
and 0.05 % of the radiance, so rounding moves a point by at most 0.01 % of its distance, a fortieth
of the farthest of 256 range bins.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Float32s, UInt8s, UInt16s
from ...common.small_files import parse_json
from ...dataset.frame_ref import FrameRef
from ..frames.frame import BOX_FIELDS, Frame, Intrinsics, Surroundings
from .base import Bounces, Mount, Rendered

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

_MAGIC = b"SFV2"
_CHECKSUM_BYTES = 16
# Four times those of a 4K video.
MOST_PIXELS = 1 << 25
_MOST_HEAD_BYTES = 1 << 16

_ZSTD = zstd.CompressionParameter
# Optional numbers of a view's head.
_NUMBERS = ("time_s", "altitude_m")


class Steps(NamedTuple):
    """The least value that has a code, and how much each code is more than the one before."""

    low: float
    step: float


DEPTH = Steps(1e-3, 2e-4)
RADIANCE = Steps(1e-9, 5e-4)
_PRECISION = {"depth_step": DEPTH.step, "radiance_step": RADIANCE.step, "block": 1, "codec": "zstd"}


@dataclass(frozen=True, eq=False)
class View:
    """What the camera and an ideal sonar at `mount` know of each pixel.

    unnamed_frame: the frame without its names, black (the albedo has used its colour already), with
        depth 0 where there is no surface.
    radiance: (H, W) float32, see `simulation.render.base.Rendered`; 0 in the sonar's shadow.
    bounces: see there.
    """

    unnamed_frame: Frame
    radiance: Float32s
    mount: Mount
    bounces: Bounces | None = None

    def frame(self, ref: FrameRef) -> Frame:
        """The frame as noise needs it."""
        return replace(self.unnamed_frame, ref=ref)

    def rendered(self) -> Rendered:
        """Radiance, surface and bounces."""
        return Rendered(self.radiance, self.unnamed_frame.valid, self.bounces)


def view_of(frame: Frame, rendered: Rendered, mount: Mount) -> View:
    """The view of a frame that was just rendered, rounded as the cache keeps it."""
    depth_m = np.where(rendered.surface, frame.depth_m, np.float32(0))
    _, depth_m = rounded(depth_m, DEPTH)
    boxes = None if frame.boxes is None else np.round(frame.boxes, 5)
    around = frame.surroundings
    if around is not None:
        around = replace(around, ground_m=np.round(around.ground_m, 2))
    stored_frame = replace(
        frame, rgb=_black(depth_m.shape), depth_m=depth_m, boxes=boxes, surroundings=around
    )
    bounces = rendered.bounces
    if bounces is not None:
        _, distance_m = rounded(bounces.distance_m[None], DEPTH)
        bounces = replace(bounces, distance_m=distance_m[0])
    return View(stored_frame, rounded(rendered.radiance, RADIANCE)[1], mount, bounces)


def _black(shape: tuple[int, ...]) -> UInt8s:
    return np.broadcast_to(np.uint8(0), (*shape, 3))


def encode(view: View) -> bytes:
    """The view as bytes; `decode(encode(view))` is the view itself when it was rounded alike."""
    frame = view.unnamed_frame
    planes = [fold(rounded(frame.depth_m, DEPTH)[0]), fold(rounded(view.radiance, RADIANCE)[0])]
    if frame.segmentation is not None and frame.instance is not None:
        planes += [frame.segmentation.tobytes(), frame.instance.astype("<u2").tobytes()]
    bounces = view.bounces
    if bounces is not None:
        planes += [pixel.astype("<i4").tobytes() for pixel in (bounces.mirror, bounces.second)]
        planes += [fold(rounded(bounces.distance_m[None], DEPTH)[0])]
    # Level 1 is twice as fast as 3 and, on such planes, no larger.  Differences are noise: what
    # repeats is near, so the least table of places (2^6) is faster, and its output smaller.
    options: dict[int, int] = {_ZSTD.compression_level: 1, _ZSTD.hash_log: 6}
    options[_ZSTD.checksum_flag] = 1
    parts = [zstd.compress(plane, options=options) for plane in planes]
    pose = frame.world_from_camera
    head = {
        "shape": frame.depth_m.shape,
        "intrinsics": asdict(frame.intrinsics),
        "mount": asdict(view.mount),
        "world_from_camera": None if pose is None else pose.tolist(),
        **{name: getattr(frame, name) for name in _NUMBERS if getattr(frame, name) is not None},
        "precision": _PRECISION,
        "labelled": frame.segmentation is not None and frame.instance is not None,
        **({} if frame.boxes is None else {"boxes": frame.boxes.tolist()}),
        **({} if frame.surroundings is None else _head_of(frame.surroundings)),
        **({} if bounces is None else _head_of_bounces(bounces)),
        "parts": [len(part) for part in parts],
    }
    text = json.dumps(head).encode()
    return b"".join([_MAGIC, struct.pack("<I", len(text)), _checksum(text), text, *parts])


def decode(content: bytes) -> View:
    """The view that `encode` wrote.  Raises ValueError for anything else, one flipped bit too."""
    try:
        head, parts_begin = _read_head(content)
        height, width = head["shape"]
        pixels = height * width
        if not (height >= 1 <= width and pixels <= MOST_PIXELS):
            raise ValueError(f"an image of {pixels} pixels; at most {MOST_PIXELS} are read")
        parts = _read_parts(content, parts_begin, head, pixels)
        frame = _read_frame(head, parts, (height, width))
        radiance = unfold(parts[1], (height, width), RADIANCE)
        bounces = _bounces(head["bounces"], parts[-3:], pixels) if "bounces" in head else None
        return View(frame, radiance, mount_of(head["mount"]), bounces)
    except (KeyError, TypeError, zstd.ZstdError, struct.error) as error:
        raise ValueError(f"damaged ({error})") from error


def _read_head(content: bytes) -> tuple[dict[str, Any], int]:
    """The head of a view, and where its parts begin."""
    if content[:4] != _MAGIC:
        raise ValueError("no view of this version")
    (length,) = struct.unpack_from("<I", content, 4)
    text_begin = 8 + _CHECKSUM_BYTES
    text = content[text_begin : text_begin + length]
    if length > _MOST_HEAD_BYTES or _checksum(text) != content[8:text_begin]:
        raise ValueError("checksum differs")
    head: dict[str, Any] = parse_json(text)
    if head["precision"] != _PRECISION:
        raise ValueError("no view of this version")
    return head, text_begin + length


def _read_parts(content: bytes, begin: int, head: dict[str, Any], pixels: int) -> list[bytes]:
    """The decompressed parts: depth and radiance; labels and instances; the paths of bounces."""
    sizes = [2 * pixels, 2 * pixels]
    if head["labelled"]:
        sizes += [pixels, 2 * pixels]
    if "bounces" in head:
        paths = int(head["bounces"]["paths"])
        if not 0 <= paths <= pixels:
            raise ValueError(f"{paths} bounces")
        sizes += [4 * paths, 4 * paths, 2 * paths]

    parts = []
    for packed_size, size in zip(head["parts"], sizes, strict=True):
        parts.append(_decompressed(content[begin : begin + packed_size], size))
        begin += packed_size
    if begin != len(content):
        raise ValueError("too long")
    return parts


def _read_frame(head: dict[str, Any], parts: Sequence[bytes], shape: tuple[int, int]) -> Frame:
    """The frame of a view, black and without a name."""
    more: dict[str, Any] = {name: _finite(head.get(name)) for name in _NUMBERS}
    if head["world_from_camera"] is not None:
        more["world_from_camera"] = np.array(head["world_from_camera"], float).reshape(4, 4)
    if head["labelled"]:
        more["segmentation"] = np.frombuffer(parts[2], np.uint8).reshape(shape)
        more["instance"] = np.frombuffer(parts[3], "<u2").astype(np.uint16).reshape(shape)
    if "boxes" in head:
        more["boxes"] = np.array(head["boxes"], float).reshape(-1, BOX_FIELDS)
    if "surroundings" in head:
        more["surroundings"] = _surroundings(head["surroundings"])
    depth_m = unfold(parts[0], shape, DEPTH)
    *lens, distortion = (head["intrinsics"][field.name] for field in fields(Intrinsics))
    fx, fy, cx, cy = map(_finite, lens)
    camera = Intrinsics(fx, fy, cx, cy, tuple(map(_finite, distortion)))
    if not min(camera.fx, camera.fy) > 0:
        raise ValueError("no camera")
    return Frame(FrameRef("", "", ""), _black(shape), depth_m, camera, **more)


def _head_of(surroundings: Surroundings) -> dict[str, Any]:
    return {
        "surroundings": {
            "world_from_start": surroundings.world_from_start.tolist(),
            "ground_cm": np.rint(surroundings.ground_m * 100).astype(int).tolist(),
            "step_m": surroundings.step_m,
        }
    }


def _head_of_bounces(bounces: Bounces) -> dict[str, Any]:
    return {
        "bounces": {
            "paths": len(bounces.mirror),
            "reflection_loss_db": bounces.reflection_loss_db,
            "pixels_each": bounces.pixels_each,
        }
    }


def _bounces(values: dict[str, Any], parts: Sequence[bytes], pixels: int) -> Bounces:
    """The paths that `encode` wrote.  parts: mirror, second and distance of each."""
    mirror, second = (np.frombuffer(part, "<i4").astype(np.int32) for part in parts[:2])
    for pixel in (mirror, second):
        if len(pixel) and not 0 <= pixel.min() <= pixel.max() < pixels:
            raise ValueError("a bounce off the image")
    return Bounces(
        mirror=mirror,
        second=second,
        distance_m=unfold(parts[2], (1, len(mirror)), DEPTH)[0],
        reflection_loss_db=float(_finite(values["reflection_loss_db"])),
        pixels_each=int(_finite(values["pixels_each"])),
    )


def _surroundings(values: dict[str, Any]) -> Surroundings:
    ground_m = np.array(values["ground_cm"], np.float32) / np.float32(100)
    if ground_m.ndim != 2 or ground_m.shape[0] != ground_m.shape[1]:
        raise ValueError("no square of the ground")
    start = np.array(values["world_from_start"], float).reshape(4, 4)
    return Surroundings(start, ground_m, float(_finite(values["step_m"])))


def _decompressed(content: bytes, size: int) -> bytes:
    """The `size` bytes that a part stands for; it never makes more.  Raises ValueError."""
    unpacker = zstd.ZstdDecompressor()
    # One byte more, so that a longer stream shows and the stream's own checksum is read.
    plane = unpacker.decompress(content, size + 1)
    if len(plane) != size or not unpacker.eof or unpacker.unused_data:
        raise ValueError(f"a part does not hold {size} bytes")
    return plane


def mount_of(values: dict[str, Any]) -> Mount:
    """A mount as JSON holds it."""
    return Mount(**{**values, "translation_m": tuple(values["translation_m"])})


def _finite(value: object) -> Any:
    if value is not None and not (isinstance(value, int | float) and math.isfinite(value)):
        raise ValueError(f"no number: {str(value)[:20]}")
    return value


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_CHECKSUM_BYTES).digest()


def rounded(values: Float32s, steps: Steps) -> tuple[UInt16s, Float32s]:
    """(H, W) uint16 code of each value, and (H, W) float32 that it stands for.

    0 for nothing (no value above 0), else 1 + its level: the logarithm of value / low in steps,
    rounded, at most 65,534.
    """
    from . import kernels  # loads numba

    values = np.ascontiguousarray(values)
    codes = np.empty(values.shape, np.uint16)
    looked_up = np.empty(values.shape, np.float32)
    first = np.float32(math.log(steps.low) - steps.step)
    width = np.float32(steps.step)
    levels = np.empty((32, values.shape[1]), np.float32)
    # A few rows at a time stay in the processor's cache.
    for start in range(0, len(values), len(levels)):
        rows = slice(start, start + len(levels))
        some = values[rows]
        # In single precision, whose logarithm is numpy's own and the same everywhere.
        level = np.maximum(some, np.float32(1e-38), out=levels[: len(some)])
        np.log(level, out=level)
        kernels.rounded(some, level, first, width, _table(steps), codes[rows], looked_up[rows])
    return codes, looked_up


@lru_cache(maxsize=8)
def _table(steps: Steps) -> Float32s:
    """Value of each 16-bit code, damaged ones too."""
    power = np.minimum((np.arange(1 << 16) - 1) * steps.step, 80.0)
    table: Float32s = (steps.low * np.exp(power)).astype(np.float32)
    table[0] = 0
    table.setflags(write=False)
    return table


def fold(codes: UInt16s) -> bytes:
    """(H, W) codes as 2 H W bytes that compress well.

    Second differences, with their sign in the lowest bit; all low bytes, then all high bytes.
    """
    down = np.diff(codes, axis=0, prepend=np.uint16(0))
    step = np.diff(down, axis=1, prepend=np.uint16(0)).view(np.int16)
    folded = ((step << 1) ^ (step >> 15)).astype("<i2")
    return np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 2).T).tobytes()


def unfold(content: bytes, shape: tuple[int, int], steps: Steps) -> Float32s:
    """(H, W) float32 values of the codes that `fold` wrote.  Raises ValueError for other sizes."""
    from . import kernels  # loads numba

    planes = np.frombuffer(content, np.uint8).reshape(2, shape[0] * shape[1])
    values = np.empty(shape, np.float32)
    kernels.unfold(planes, _table(steps), values)
    return values
