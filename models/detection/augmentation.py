"""Varied copies of a labelled image: what a detector must not depend on is drawn anew each time."""

from __future__ import annotations

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s, Int64s
from .boxes import Boxes, areas, clip_boxes, mirror_boxes
from .clutter import add_clutter, add_repeats, add_shadows
from .images import WorkingImage
from .normalise import normalise

Generator = np.random.Generator

_VISIBLE = 0.4  # an object keeps its box while so much of it is inside the image


def vary(
    working: WorkingImage, shape: tuple[int, int], rng: Generator, *, with_clutter: bool
) -> tuple[Float32s, Boxes, Int64s]:
    """A varied copy: network input (3, H, W), boxes and labels.

    shape: H and W of the canvas.  with_clutter: whether unlabelled echoes are drawn over it, for
    images whose places are emptier than real ones.
    """
    image, is_fan, boxes, labels = _place(working, shape, rng)
    if with_clutter and rng.random() < 0.3:
        image = add_repeats(image, rng)
    if with_clutter and rng.random() < 0.8:
        image = add_clutter(image, boxes, rng)
    if rng.random() < 0.3:
        image = add_shadows(image, rng)
    image = _vary_gain(image, rng)
    image = _vary_grain(image, rng)
    image *= is_fan
    return normalise(image, is_fan), boxes, labels


def _place(
    working: WorkingImage, shape: tuple[int, int], rng: Generator
) -> tuple[Float32s, Bools, Boxes, Int64s]:
    """The image mirrored, scaled and moved at random; objects that left the canvas are dropped."""
    source = working.labelled
    height, width = shape
    scale = float(np.exp(rng.uniform(np.log(0.7), np.log(1.45))))
    stretch = float(np.exp(rng.normal(0, 0.07)))
    scale_x = scale * stretch
    scale_y = scale / stretch
    source_height, source_width = source.image.shape
    # A larger image shows any part of itself, a smaller one lies anywhere.
    free_x = width - scale_x * source_width
    free_y = height - scale_y * source_height
    shift_x = free_x / 2 + float(rng.uniform(-0.5, 0.5)) * abs(free_x)
    shift_y = free_y / 2 + float(rng.uniform(-0.5, 0.5)) * abs(free_y)
    # Pixel centres lie at whole numbers, edges of boxes between them.
    matrix = np.array(
        [
            [scale_x, 0, shift_x + 0.5 * scale_x - 0.5],
            [0, scale_y, shift_y + 0.5 * scale_y - 0.5],
        ]
    )
    size = (width, height)
    image = cv2.warpAffine(source.image, matrix, size, flags=cv2.INTER_LINEAR)
    fan = cv2.warpAffine(working.is_fan.astype(np.uint8), matrix, size, flags=cv2.INTER_NEAREST)
    boxes = source.boxes * np.array([scale_x, scale_y] * 2, np.float32)
    boxes = boxes + np.array([shift_x, shift_y] * 2, np.float32)
    if rng.random() < 0.5:
        image = np.ascontiguousarray(image[:, ::-1])
        fan = np.ascontiguousarray(fan[:, ::-1])
        boxes = mirror_boxes(boxes, width)
    clipped = clip_boxes(boxes, height, width)
    is_visible = areas(clipped) > _VISIBLE * np.maximum(areas(boxes), 1e-6)
    values = image.astype(np.float32) / np.float32(255)
    return values, fan > 0, clipped[is_visible], source.labels[is_visible]


def _vary_gain(image: Float32s, rng: Generator) -> Float32s:
    """Gain over the image and over range, and the edge of a brighter or darker floor."""
    height, width = image.shape
    coarse = rng.normal(0, 0.15, (5, 3)).astype(np.float32)
    coarse += rng.normal(0, 0.25, (5, 1)).astype(np.float32)
    resized = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    log_gain = np.asarray(resized, np.float32)
    if rng.random() < 0.5:
        log_gain += _range_step(height, width, rng)
    gamma = float(np.exp(rng.uniform(-0.6, 0.6)))
    gained = np.power(np.maximum(image, 0), gamma) * np.exp(log_gain)
    # Not clipped: a sonar's gain saturates rarely, and `normalise` takes any scale.
    return np.asarray(gained, np.float32)


def _range_step(height: int, width: int, rng: Generator) -> Float32s:
    """A step of the logarithmic gain at one range, (H, W): where the beam meets the floor."""
    y, x = np.mgrid[:height, :width].astype(np.float32)
    apex_y = height * float(rng.uniform(1.2, 1.6))
    radius = np.hypot(x - width / 2, apex_y - y)
    edge = float(rng.uniform(apex_y - 0.9 * height, apex_y - 0.1 * height))
    softness = float(rng.uniform(2, 12))
    step = float(rng.uniform(0.2, 0.9)) * (1 if rng.random() < 0.5 else -1)
    return np.asarray(step * 0.5 * np.tanh((radius - edge) / softness), np.float32)


def _vary_grain(image: Float32s, rng: Generator) -> Float32s:
    """Blur, speckle, a noise floor and lines along the range."""
    height, width = image.shape
    if rng.random() < 0.5:
        blurred = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.3, 1.0)))
        image = np.asarray(blurred, np.float32)
    if rng.random() < 0.6:
        grain = _noise((height, width), float(rng.uniform(0, 0.8)), rng)
        image = image * np.exp(float(rng.uniform(0.0, 0.25)) * grain)
    if rng.random() < 0.6:
        floor = np.abs(_noise((height, width), float(rng.uniform(0, 0.8)), rng))
        image = image + float(rng.uniform(0.0, 0.06)) * floor
    if rng.random() < 0.2:
        lines = rng.normal(0, float(rng.uniform(0.02, 0.08)), (1, width)).astype(np.float32)
        image = image * np.exp(lines)
    return np.asarray(np.maximum(image, 0), np.float32)


def _noise(shape: tuple[int, int], blur_px: float, rng: Generator) -> Float32s:
    """Gaussian noise with standard deviation 1 and a grain of about `blur_px`."""
    noise = rng.standard_normal(shape, np.float32)
    if blur_px < 0.25:
        return noise
    smooth = cv2.GaussianBlur(noise, (0, 0), blur_px)
    return np.asarray(smooth / (smooth.std() + 1e-6), np.float32)
