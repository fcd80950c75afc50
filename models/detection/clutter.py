"""Bright things without a label: what a real place holds beside the objects that are looked for.

Ropes, rails, grids, fittings, walls and echoes of their own kind fill real images and carry no
box.  They are drawn with speckle over an image that the detector learns from.
"""

from __future__ import annotations

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from .boxes import Boxes

Generator = np.random.Generator

_FAR_SHARE = 0.35  # of the echoes lie in the farthest third, before walls and behind objects
_WALL_COVER = 0.1  # a wall covers at most this share of any object


def add_clutter(image: Float32s, boxes: Boxes, rng: Generator) -> Float32s:
    """The image with a few unlabelled echoes, (H, W) in 0..1; none lies over most of an object."""
    layer = np.zeros(image.shape, np.float32)
    far_part = layer[: layer.shape[0] // 3]
    for _ in range(int(rng.integers(0, 7))):
        part = far_part if rng.random() < _FAR_SHARE else layer
        _DRAWS[int(rng.integers(len(_DRAWS)))](part, rng)
    if rng.random() < 0.3:
        height, width = image.shape
        wall = _wall(height, width, rng)
        if not _covers_objects(wall, boxes):
            layer = np.maximum(layer, wall)
    blurred = cv2.GaussianBlur(layer, (0, 0), float(rng.uniform(0.5, 1.2)))
    grain = np.sqrt(rng.exponential(1.0, image.shape)).astype(np.float32)
    grain = np.clip(grain, 0.2, 1.6)
    return np.asarray(np.clip(np.maximum(image, blurred * grain), 0, 1), np.float32)


def add_repeats(image: Float32s, rng: Generator) -> Float32s:
    """The image with fainter copies of its echoes farther away, as reverberation shows them.

    Sound that takes a detour within an object or past a wall arrives later, and smeared.
    """
    height = image.shape[0]
    blurred = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.6, 2.0)), sigmaY=0.6)
    repeated = np.asarray(blurred, np.float32)
    level = float(rng.uniform(0.2, 0.6))
    step = int(rng.integers(4, max(5, height // 5)))
    result = image.copy()
    for number in range(1, int(rng.integers(2, 4))):
        shift = number * step
        if shift >= height:
            break
        # Ranges grow towards the top.
        np.maximum(result[:-shift], level**number * repeated[shift:], out=result[:-shift])
    return result


def add_shadows(image: Float32s, rng: Generator) -> Float32s:
    """The image with dark sectors along the range, as behind what is outside the image."""
    height, width = image.shape
    layer = np.ones(image.shape, np.float32)
    for _ in range(int(rng.integers(1, 3))):
        x = float(rng.uniform(0, width))
        half_width = float(rng.uniform(2, 10))
        top = float(rng.uniform(-0.2, 0.5)) * height
        bottom = top + float(rng.uniform(0.2, 0.7)) * height
        lean = (x - width / 2) / width * 0.5 * (bottom - top)
        corners = np.array(
            [
                [x + lean - half_width, top],
                [x + lean + half_width, top],
                [x + 0.8 * half_width, bottom],
                [x - 0.8 * half_width, bottom],
            ]
        )
        cv2.fillPoly(layer, [corners.astype(np.int32)], (float(rng.uniform(0.2, 0.7)),))
    return np.asarray(image * cv2.GaussianBlur(layer, (0, 0), 1.5), np.float32)


def _draw_rope(layer: Float32s, rng: Generator) -> None:
    """A straight or dashed line in any direction."""
    height, width = layer.shape
    start = rng.uniform((0, 0), (width, height))
    angle_rad = rng.uniform(0, np.pi) if rng.random() < 0.6 else np.pi / 2 + rng.normal(0, 0.15)
    direction = np.array([np.cos(angle_rad), np.sin(angle_rad)])
    length = float(rng.uniform(8, 90))
    level = float(rng.uniform(0.35, 1.0))
    thickness = int(rng.integers(1, 4))
    dash = float(rng.uniform(2, 8)) if rng.random() < 0.5 else length
    for begin in np.arange(0, length, 2 * dash):
        ends = [start + direction * at for at in (begin, min(begin + dash, length))]
        first, last = (tuple(np.rint(end).astype(int).tolist()) for end in ends)
        cv2.line(layer, first, last, (level,), thickness)


def _draw_grid(layer: Float32s, rng: Generator) -> None:
    """Rows of dots or short strokes, as rails and ladders show."""
    height, width = layer.shape
    x, y = rng.uniform((0, 0), (width, height))
    level = float(rng.uniform(0.3, 0.9))
    step_x = float(rng.uniform(3, 9))
    step_y = float(rng.uniform(4, 10))
    stroke = int(rng.integers(0, 5))
    for row in range(int(rng.integers(1, 6))):
        for column in range(int(rng.integers(3, 14))):
            start = (int(x + column * step_x), int(y + row * step_y))
            cv2.line(layer, start, (start[0], start[1] + stroke), (level,), 1)


def _draw_blob(layer: Float32s, rng: Generator) -> None:
    """A small echo of no particular shape."""
    height, width = layer.shape
    x, y = rng.uniform((0, 0), (width, height))
    level = float(rng.uniform(0.4, 1.0))
    for _ in range(int(rng.integers(1, 4))):
        centre = (int(x + rng.normal(0, 3)), int(y + rng.normal(0, 3)))
        axes = (int(rng.integers(1, 6)), int(rng.integers(1, 4)))
        cv2.ellipse(layer, centre, axes, float(rng.uniform(-40, 40)), 0, 360, (level,), -1)


def _draw_arc(layer: Float32s, rng: Generator) -> None:
    """A line of constant range: a sidelobe, a seam of the floor, or a wall's foot."""
    height, width = layer.shape
    apex = (width // 2, int(height * rng.uniform(1.2, 1.6)))
    radius = int(apex[1] - rng.uniform(0, height))
    middle_deg = -90 + float(rng.normal(0, 8))
    half_deg = float(rng.uniform(1, 12))
    level = float(rng.uniform(0.25, 0.8))
    ends_deg = (middle_deg - half_deg, middle_deg + half_deg)
    cv2.ellipse(layer, apex, (radius, radius), 0, *ends_deg, (level,), int(rng.integers(1, 4)))


def _draw_dashes(layer: Float32s, rng: Generator) -> None:
    """A few short strokes across the beams, as edges of a wall, pipes and fittings show."""
    height, width = layer.shape
    middle_x, middle_y = rng.uniform((0, 0), (width, height))
    level = float(rng.uniform(0.3, 1.0))
    slope = float(rng.normal(0, 0.25))
    for _ in range(int(rng.integers(1, 8))):
        x = middle_x + float(rng.normal(0, 10))
        y = middle_y + float(rng.normal(0, 6))
        half = float(rng.uniform(1.5, 8))
        start = (int(x - half), int(y - slope * half))
        end = (int(x + half), int(y + slope * half))
        cv2.line(layer, start, end, (level * float(rng.uniform(0.5, 1)),), int(rng.integers(1, 3)))


_DRAWS = (
    _draw_rope,
    _draw_grid,
    _draw_blob,
    _draw_blob,
    _draw_dashes,
    _draw_dashes,
    _draw_arc,
)


def _wall(height: int, width: int, rng: Generator) -> Float32s:
    """A wide striped band across the far part of the fan, (H, W)."""
    layer = np.zeros((height, width), np.float32)
    y = float(rng.uniform(-0.02, 0.25)) * height
    slope = float(rng.normal(0, 0.4))
    thickness = float(rng.uniform(6, 40))
    level = float(rng.uniform(0.4, 0.9))
    left = float(rng.uniform(-0.3, 0.6)) * width if rng.random() < 0.5 else 0.0
    for _ in range(int(rng.integers(1, 6))):
        offset = float(rng.uniform(0, thickness))
        stripe = int(max(2, thickness * rng.uniform(0.1, 0.6)))
        start = (int(left), int(y + offset + slope * (left - width / 2)))
        end = (width, int(y + offset + slope * width / 2))
        cv2.line(layer, start, end, (level * float(rng.uniform(0.5, 1)),), stripe)
    return layer


def _covers_objects(wall: Float32s, boxes: Boxes) -> bool:
    for left, top, right, bottom in boxes.astype(int):
        part = wall[max(top, 0) : bottom, max(left, 0) : right]
        if part.size and (part > 0).mean() > _WALL_COVER:
            return True
    return False
