"""How strongly each pixel's surface scatters, taken from its colour.

A camera picture tells where a surface changes (rock, sand, growth), not how well it echoes.  All
kinds therefore only supply a texture between 0 and 1; its mean level is that of `constant`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from . import kernels

MEAN_ALBEDO = 0.5

# Nothing measured is perfectly black: radiance 0 is kept for the sonar's shadow.
_DARKEST_RGB = 0.01
_DARKEST_FLATTENED = 0.1

# Linear-light weights of red, green and blue in luminance (ITU-R BT.709, the primaries of sRGB).
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)

# The local mean is taken over a window of this part of the image height: wider than the texture of
# a stone, narrower than the way over which water dims and colours the picture.
_WINDOW = 1 / 8


def albedo(
    rgb: npt.NDArray[np.uint8],
    valid: npt.NDArray[np.bool_],
    kind: Literal["rgb", "flattened", "constant"],
) -> npt.NDArray[np.float32]:
    """(H, W) float32 albedo of a colour image, in (0, 1]; 0 where not `valid`.

    rgb: (H, W, 3) uint8 sRGB.  valid: (H, W) bool, pixels that have a depth.
    kind: rgb is the luminance of the image, in linear light, for it multiplies an echo's energy and
        not its grey value; flattened is that luminance over its local mean, times MEAN_ALBEDO;
        constant is MEAN_ALBEDO.
    """
    if kind == "constant":
        return np.where(valid, np.float32(MEAN_ALBEDO), np.float32(0))
    luminance = linear_luminance(rgb)
    if kind == "rgb":
        return np.where(valid, np.maximum(luminance, np.float32(_DARKEST_RGB)), np.float32(0))
    side = max(3, round(luminance.shape[0] * _WINDOW) | 1)
    weight = valid.astype(np.float32)
    # Two box filters are close to a smooth tent.
    total, share = luminance * weight, weight
    for _ in range(2):
        total, share = kernels.box_mean(total, side), kernels.box_mean(share, side)
    limits = np.float32(MEAN_ALBEDO), np.float32(_DARKEST_FLATTENED)
    flat = kernels.flattened(luminance, total, share, np.ascontiguousarray(valid), *limits)
    return np.asarray(flat)


def linear_luminance(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """(H, W) float32 relative luminance 0..1 of an sRGB image (IEC 61966-2-1 decoding)."""
    code = np.arange(256) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )
    found = kernels.weighted(np.ascontiguousarray(rgb), _LUMINANCE[:, None] * linear)
    return np.asarray(found)
