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

import json
import lzma
import struct
import zlib
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from factory.frame import Frame, FrameRef, Intrinsics
from factory.render.base import Rendered
from factory.sonar.mount import Mount

_NEAREST_M = 1e-3
_FAINTEST = 1e-9
_CODES = 65_534  # 0 is "nothing here"
_MAGIC = b"SFV1"

Codes = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class Precision:
    """depth_step, radiance_step: relative.  block: pixels on an edge that share one radiance.

    codec: zlib is fast, lzma small.
    """

    depth_step: float
    radiance_step: float
    block: int
    codec: Literal["zlib", "lzma"]


FINE = Precision(2e-4, 5e-4, 1, "zlib")
SMALL = Precision(2e-4, 0.1, 4, "lzma")


@dataclass(frozen=True, eq=False)
class View:
    """What the camera and an ideal sonar at `mount` know of each pixel.

    depth_m: (H, W) float32, 0 where there is no surface.
    radiance: (H, W) float32, see `factory.render.base.Rendered`; 0 in the sonar's shadow.
    segmentation, instance: labels of the pixels, see `factory.frame.Frame`; None without labels.
    """

    depth_m: npt.NDArray[np.float32]
    radiance: npt.NDArray[np.float32]
    intrinsics: Intrinsics
    mount: Mount
    segmentation: npt.NDArray[np.uint8] | None = None
    instance: npt.NDArray[np.uint16] | None = None

    def frame(self, ref: FrameRef) -> Frame:
        """The frame as noise needs it: black, for its colour has done its part in the albedo."""
        black = np.broadcast_to(np.uint8(0), (*self.depth_m.shape, 3))
        return Frame(
            ref, black, self.depth_m, self.intrinsics, None, self.segmentation, self.instance
        )

    def rendered(self) -> Rendered:
        """Radiance and surface."""
        return Rendered(self.radiance, self.depth_m > 0)


def view_of(frame: Frame, rendered: Rendered, mount: Mount) -> View:
    """The view of a frame that was just rendered, rounded as the cache keeps it."""
    depth_m = np.where(rendered.surface, frame.depth_m, np.float32(0))
    exact = View(
        depth_m, rendered.radiance, frame.intrinsics, mount, frame.segmentation, frame.instance
    )
    depth_m, radiance = _values(_codes(exact, FINE), depth_m.shape, FINE)
    return replace(exact, depth_m=depth_m, radiance=radiance)


def encode(view: View, precision: Precision = FINE) -> bytes:
    """The view as bytes; `decode(encode(view))` is the view itself when it was rounded alike."""
    labelled = view.segmentation is not None and view.instance is not None
    planes = _packed(_codes(view, precision), precision.block)
    if labelled:
        assert view.segmentation is not None
        assert view.instance is not None
        planes += [view.segmentation.tobytes(), view.instance.astype("<u2").tobytes()]
    parts = [_compress(plane, precision.codec) for plane in planes]
    head = {
        "shape": view.depth_m.shape,
        "intrinsics": asdict(view.intrinsics),
        "mount": asdict(view.mount),
        "precision": asdict(precision),
        "labelled": labelled,
        "parts": [len(part) for part in parts],
    }
    text = json.dumps(head).encode()
    return b"".join([_MAGIC, struct.pack("<I", len(text)), text, *parts])


def decode(content: bytes) -> View:
    """The view that `encode` wrote.  Raises ValueError for anything else."""
    try:
        if content[:4] != _MAGIC:
            raise ValueError("no view of this version")
        (length,) = struct.unpack_from("<I", content, 4)
        head = json.loads(content[8 : 8 + length])
        precision = Precision(**head["precision"])
        decompress = zlib.decompress if precision.codec == "zlib" else lzma.decompress
        parts, start = [], 8 + length
        for size in head["parts"]:
            parts.append(decompress(content[start : start + size]))
            start += size
        height, width = head["shape"]
        camera = {**head["intrinsics"], "distortion": tuple(head["intrinsics"]["distortion"])}
        mount = {**head["mount"], "translation_m": tuple(head["mount"]["translation_m"])}
        codes = _unpacked(parts, (height, width), precision.block)
        values = _values(codes, (height, width), precision)
        view = View(*values, Intrinsics(**camera), Mount(**mount))
        if not head["labelled"]:
            return view
        segmentation = np.frombuffer(parts[-2], np.uint8).reshape(height, width)
        instance = np.frombuffer(parts[-1], "<u2").astype(np.uint16).reshape(height, width)
        return replace(view, segmentation=segmentation, instance=instance)
    except (KeyError, TypeError, zlib.error, lzma.LZMAError, struct.error) as error:
        raise ValueError(f"damaged ({error})") from error


def _compress(content: bytes, codec: str) -> bytes:
    return zlib.compress(content, 1) if codec == "zlib" else lzma.compress(content, preset=6)


def _codes(view: View, precision: Precision) -> tuple[Codes, Codes, npt.NDArray[np.bool_]]:
    """Codes of depth (H, W) and radiance (blocks), and which pixels are lit (H, W)."""
    depth = _rounded_log(view.depth_m, _NEAREST_M, precision.depth_step)
    lit = view.radiance > 0
    radiance = _block_mean(view.radiance, lit, precision.block)
    return depth, _rounded_log(radiance, _FAINTEST, precision.radiance_step), lit


def _values(
    codes: tuple[Codes, Codes, npt.NDArray[np.bool_]],
    shape: tuple[int, ...],
    precision: Precision,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    depth, radiance, lit = codes
    strength = _table(_FAINTEST, precision.radiance_step)[radiance]
    if precision.block > 1:
        strength = strength.repeat(precision.block, axis=0).repeat(precision.block, axis=1)
        strength = np.where(lit, strength[: shape[0], : shape[1]], np.float32(0))
    return _table(_NEAREST_M, precision.depth_step)[depth], strength


def _rounded_log(values: npt.NDArray[np.float32], low: float, step: float) -> Codes:
    codes = np.zeros(values.shape, np.uint16)
    there = values > 0
    level = np.rint(np.log(values[there] / np.float32(low)) / np.float32(step))
    codes[there] = np.clip(level, 0, _CODES - 1).astype(np.uint16) + 1
    return codes


def _table(low: float, step: float) -> npt.NDArray[np.float32]:
    """Value of each code."""
    power = np.minimum((np.arange(_CODES + 2) - 1) * step, 80.0)
    table: npt.NDArray[np.float32] = (low * np.exp(power)).astype(np.float32)
    table[0] = 0
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


def _packed(codes: tuple[Codes, Codes, npt.NDArray[np.bool_]], block: int) -> list[bytes]:
    depth, radiance, lit = codes
    parts = [_differences(depth), _differences(radiance)]
    if block > 1:
        parts.append(np.packbits(lit).tobytes())
    return parts


def _unpacked(
    parts: list[bytes], shape: tuple[int, int], block: int
) -> tuple[Codes, Codes, npt.NDArray[np.bool_]]:
    blocks = (-(-shape[0] // block), -(-shape[1] // block))
    depth, radiance = _sums(parts[0], shape), _sums(parts[1], blocks)
    if block == 1:
        return depth, radiance, radiance > 0
    bits = np.unpackbits(np.frombuffer(parts[2], np.uint8), count=shape[0] * shape[1])
    return depth, radiance, bits.reshape(shape).astype(np.bool_)


def _differences(codes: Codes) -> bytes:
    """Second differences, small numbers first: what a general compressor makes little of."""
    step = codes.copy()
    step[:, 1:] -= codes[:, :-1]
    step[1:] -= step[:-1].copy()
    signed = step.view(np.int16)
    folded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    # Low and high bytes apart, in an order that no machine's own byte order changes.
    pairs = folded.astype("<u2").view(np.uint8).reshape(-1, 2)
    return np.ascontiguousarray(pairs.T).tobytes()


def _sums(content: bytes, shape: tuple[int, int]) -> Codes:
    planes: npt.NDArray[Any] = np.frombuffer(content, np.uint8).reshape(2, -1)
    folded = planes[0].astype(np.uint16) | (planes[1].astype(np.uint16) << 8)
    step = ((folded >> 1) ^ (-(folded & 1).astype(np.int16)).view(np.uint16)).reshape(shape)
    down = np.cumsum(step, axis=0, dtype=np.uint16)
    return np.asarray(np.cumsum(down, axis=1, dtype=np.uint16))
