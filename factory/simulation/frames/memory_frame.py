"""A frame from arrays in memory: what a caller may pass, and what each mistake is called."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from ...common.array_types import Array, Float32s, UInt8s
from ...common.errors import FrameError
from ...dataset.frame_ref import FrameRef
from .frame import LIKELY_M, Frame, Intrinsics, checked


def frame_from_arrays(
    ref: FrameRef, rgb: npt.ArrayLike, depth_m: npt.ArrayLike, intrinsics: Intrinsics
) -> Frame:
    """A checked frame; depths that cannot be used are unmeasured pixels.

    rgb: (H, W, 3) of integers 0..255.
    depth_m: (H, W) or (H, W, 1) of floating-point metres; masked pixels are unmeasured.
    Raises ValueError, which names the argument, for another shape, type or unit; FrameError for a
    frame without usable depth.
    """
    colours = _colours(rgb)
    depths = _depths(depth_m)
    if depths.shape != colours.shape[:2]:
        raise ValueError(
            f"depth_m is {_size(depths)} and rgb is {_size(colours)} (columns x rows); give a "
            "depth map registered to the colour image"
        )
    _check_intrinsics(intrinsics)
    return checked(Frame(ref, colours, depths, intrinsics), bad_depth="mask")


def _colours(rgb: npt.ArrayLike) -> UInt8s:
    image = _as_array(rgb, "rgb")
    if image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise ValueError(f"rgb has shape {image.shape}; expected (H, W, 3): red, green, blue")
    if image.dtype == np.uint8:
        return image
    if image.dtype.kind not in "iu" or image.min() < 0 or image.max() > 255:
        raise ValueError(f"rgb is {image.dtype}; expected integers 0..255 (uint8)")
    return image.astype(np.uint8)


def _depths(depth_m: npt.ArrayLike) -> Float32s:
    """(H, W) float32 metres; masked pixels are 0.

    Raises ValueError for another shape or type, FrameError for a median that is hardly in metres.
    """
    if isinstance(depth_m, np.ma.MaskedArray):
        depth_m = np.where(depth_m.mask, 0, depth_m.data)
    depths = _as_array(depth_m, "depth_m")
    if depths.ndim == 3 and depths.shape[2] == 1:
        depths = depths[..., 0]
    if depths.ndim != 2 or 0 in depths.shape:
        raise ValueError(f"depth_m has shape {depths.shape}; expected (H, W)")
    if depths.dtype.kind in "iu":
        raise ValueError(
            f"depth_m is {depths.dtype}, which holds no fractions of a metre; divide by the units "
            "in a metre, for example depth_m=depth_mm / 1000"
        )
    if depths.dtype.kind != "f":
        raise ValueError(f"depth_m is {depths.dtype}; expected floating-point metres")
    with np.errstate(over="ignore"):  # infinite then: unmeasured
        metres = depths.astype(np.float32)
    usable = metres[np.isfinite(metres) & (metres > 0)]
    median = float(np.median(usable)) if usable.size else 1.0
    if median > LIKELY_M[1]:
        raise FrameError(
            f"depth_m: its median is {median:,.4g}; metres are expected, are these millimetres "
            "(divide by 1000) or centimetres (by 100)?"
        )
    if median < LIKELY_M[0]:
        raise FrameError(
            f"depth_m: its median is {median:.4g}; metres are expected, were these divided twice?"
        )
    return metres


def _check_intrinsics(intrinsics: Intrinsics) -> None:
    for name in ("fx", "fy", "cx", "cy"):
        value = getattr(intrinsics, name)
        if not math.isfinite(value):
            raise ValueError(f"{name}={value}: expected a number of pixels")
        if name in ("fx", "fy") and value <= 0:
            raise ValueError(f"{name}={value}: a focal length in pixels is positive")


def _as_array(values: Any, name: str) -> Array:
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # ragged lists
        raise ValueError(f"{name}: is no array ({error})") from error
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{name} holds {array.dtype}; expected an array of numbers")
    return array


def _size(image: Array) -> str:
    return f"{image.shape[1]}x{image.shape[0]}"
