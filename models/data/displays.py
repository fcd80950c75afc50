"""What displays and recordings do to an image, for training images: drawn here, applied here.

Real images have near ranges that are too bright, a wrong time-varied gain, glare, saturation, dark
bands, other tone curves, few grey values and other sizes.  None of it is noise: the clean image is
shown in the same way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from ...factory.common.array_types import Float32s

_LEAST_SCALE = 0.35
_MOST_SCALE = 1.6
_SCALED_SHARE = 0.5  # of the displays; each line below counts by itself
_BAND_SHARE = 0.45
_SLOPE_SHARE = 0.3
_GLARE_SHARE = 0.15
_GAIN_SHARE = 0.4
_GAMMA_SHARE = 0.3
_FEW_GREYS_SHARE = 0.15
_COMPRESSED_SHARE = 0.15
_QUALITIES = (45, 96)
_DECIBEL = np.float32(np.log(10) / 20)


@dataclass(frozen=True)
class Band:
    """A gain over a band of an image, with soft edges.

    axis: 0 for a band of rows, 1 of columns.  low, high: its edges as fractions of the side.
    gain: inside.  edge: width of the edges as a fraction of the side.
    """

    axis: int
    low: float
    high: float
    gain: float
    edge: float


@dataclass(frozen=True)
class Glare:
    """A gain that falls from a point like a bell.

    row, column: the point; radius: one standard deviation; as fractions of the sides.
    gain: at the point.
    """

    row: float
    column: float
    radius: float
    gain: float


@dataclass(frozen=True)
class Display:
    """How an image is shown; the defaults change nothing.

    scale: size over that of the image.  gain: of all pixels, before those above 1 saturate.
    near_db, far_db: gain of the last and the first row, even in decibels between (far range is on
    top).  gamma: exponent of grey values.  greys: how many there are in the noisy image; 0: all.
    quality: of the JPEG that the noisy image went through, as frames of videos do; 0: none.
    """

    scale: float = 1.0
    gain: float = 1.0
    near_db: float = 0.0
    far_db: float = 0.0
    bands: tuple[Band, ...] = ()
    glare: Glare | None = None
    gamma: float = 1.0
    greys: int = 0
    quality: int = 0


@dataclass(frozen=True)
class ImagePart:
    """A part of an image: its first row and column, and its size and that of the image."""

    top: int
    left: int
    shape: tuple[int, int]
    image_shape: tuple[int, int]


def draw_display(rng: np.random.Generator) -> Display:
    """A display with some of the changes, each by a coin."""
    scale = 1.0
    gain = 1.0
    near_db = 0.0
    far_db = 0.0
    bands: list[Band] = []
    glare = None
    gamma = 1.0
    greys = 0
    quality = 0
    if rng.random() < _SCALED_SHARE:
        scale = float(np.exp(rng.uniform(np.log(_LEAST_SCALE), np.log(_MOST_SCALE))))
    if rng.random() < _GAIN_SHARE:
        gain = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
    if rng.random() < _SLOPE_SHARE:
        near_db, far_db = rng.uniform(-8, 12, 2)
    if rng.random() < _BAND_SHARE:
        bands = [_draw_band(rng) for _ in range(int(rng.integers(1, 3)))]
    if rng.random() < _GLARE_SHARE:
        row, column = rng.uniform(-0.1, 1.1, 2)
        glare = Glare(row, column, rng.uniform(0.05, 0.5), float(np.exp(rng.uniform(0.3, 1.9))))
    if rng.random() < _GAMMA_SHARE:
        gamma = float(np.exp(rng.uniform(np.log(0.4), np.log(2.1))))
    if rng.random() < _FEW_GREYS_SHARE:
        greys = int(rng.choice([8, 16, 16, 32, 64]))
    if rng.random() < _COMPRESSED_SHARE:
        quality = int(rng.integers(*_QUALITIES))
    return Display(scale, gain, near_db, far_db, tuple(bands), glare, gamma, greys, quality)


def _draw_band(rng: np.random.Generator) -> Band:
    # Ranges are too bright or too dark more often than bearings.
    axis = int(rng.random() < 0.3)
    middle = rng.uniform(0, 1)
    half = rng.uniform(0.02, 0.3)
    is_bright = rng.random() < 0.65
    gain = np.exp(rng.uniform(0.2, 1.9)) if is_bright else np.exp(rng.uniform(-1.9, -0.2))
    return Band(axis, middle - half, middle + half, float(gain), rng.uniform(0.003, 0.12))


def show(image: Float32s, display: Display, window: ImagePart) -> Float32s:
    """An image, or its `window`, as a display shows it, but for its size and number of greys.

    image: float32 of the shape of the window, 0 to 1, NaN where unknown.
    """
    shown = np.clip(image * gains(display, window), 0, 1)
    if display.gamma != 1:
        shown = shown ** np.float32(display.gamma)
    return np.asarray(shown, np.float32)


def gains(display: Display, window: ImagePart) -> Float32s:
    """(H, W) float32: what each pixel of a window is multiplied by."""
    height, width = window.image_shape
    rows = ((np.arange(window.shape[0]) + window.top + 0.5) / height).astype(np.float32)
    columns = ((np.arange(window.shape[1]) + window.left + 0.5) / width).astype(np.float32)
    decibels = display.far_db + (display.near_db - display.far_db) * rows
    of_row = np.exp(decibels * _DECIBEL) * np.float32(display.gain)
    of_column = np.ones_like(columns)
    for band in display.bands:
        if band.axis == 0:
            of_row = of_row * _band_gain(rows, band)
        else:
            of_column = of_column * _band_gain(columns, band)
    gain = of_row[:, None] * of_column[None]
    if display.glare is not None:
        glare = display.glare
        squared = (rows - glare.row)[:, None] ** 2 + (columns - glare.column)[None] ** 2
        bell = np.exp(-squared / np.float32(2 * glare.radius**2))
        gain = gain * (1 + np.float32(glare.gain - 1) * bell)
    return np.asarray(gain, np.float32)


def _band_gain(places: Float32s, band: Band) -> Float32s:
    rise = np.clip((places - band.low) / band.edge + 0.5, 0, 1)
    fall = np.clip((band.high - places) / band.edge + 0.5, 0, 1)
    return np.asarray(1 + np.float32(band.gain - 1) * np.minimum(rise, fall), np.float32)


def with_greys(image: Float32s, count: int) -> Float32s:
    """An image in 0..1 with this many grey values; 0 leaves it."""
    if not count:
        return image
    return np.asarray(np.rint(image * (count - 1)) / np.float32(count - 1), np.float32)


def compressed(image: Float32s, quality: int) -> Float32s:
    """An image in 0..1 as it comes out of a JPEG of a quality; 0 leaves it."""
    if not quality:
        return image
    levels = np.rint(image * 255).astype(np.uint8)
    content = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    decoded = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)
    return np.asarray(decoded, np.float32) / np.float32(255)


def resized_planes(planes: Mapping[str, Float32s], shape: tuple[int, int]) -> dict[str, Float32s]:
    """Planes of one window at another size, (rows, columns), as displays interpolate."""
    height, width = next(iter(planes.values())).shape
    is_smaller = shape[0] < height or shape[1] < width
    interpolation = cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR
    size = shape[1], shape[0]
    return {
        name: np.asarray(cv2.resize(plane, size, interpolation=interpolation), np.float32)
        for name, plane in planes.items()
    }
