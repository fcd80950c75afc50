"""Moving targets inserted into training images, so that a network learns to keep them.

All references of real recordings show the static scene, and drawn scenes hardly move: a network
that learns from them takes a faint fish for noise.  Here the noisy image and its reference get the
same targets, in standard deviations of the grain around each.  They are denser and more varied
than in any recording: targets cover few pixels, and a loss averages over all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from .pairs import TrainingImage

_AREA_PX = 56 * 56  # of an image for each target
_SEMI_MINOR_PX = (1.3, 5.0)
_ELONGATION = (1.0, 4.0)
_CONTRAST = (1.0, 6.0)  # standard deviations of the grain of a single frame
_DARK_SHARE = 0.15  # of the targets that are darker than what is around them
_SOFTNESS = (1.0, 3.0)  # exponent of the profile: a Gaussian, to nearly a flat top
_GRAIN_SIGMA_PX = 3.0
_AROUND_SIGMA_PX = 8.0
_BLACK = 0.01  # grey value around a target that no echo reaches


@dataclass(frozen=True)
class Target:
    """An elliptic target.

    row, column: of its centre.  angle_rad: of its long axis to the rows.
    semi_major_px, semi_minor_px: pixels.  softness: exponent of its profile.
    contrast: standard deviations of a single frame's grain; negative for a shadow.
    """

    row: float
    column: float
    angle_rad: float
    semi_major_px: float
    semi_minor_px: float
    softness: float
    contrast: float


def draw_targets(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Target, ...]:
    """Targets all over an image of this many rows and columns."""
    height, width = shape
    targets = []
    for _ in range(max(1, round(height * width / _AREA_PX))):
        semi_minor_px = _log_uniform(rng, _SEMI_MINOR_PX)
        is_dark = rng.random() < _DARK_SHARE
        contrast = _log_uniform(rng, _CONTRAST)
        targets.append(
            Target(
                row=rng.uniform(0, height),
                column=rng.uniform(0, width),
                angle_rad=rng.uniform(0, np.pi),
                semi_major_px=semi_minor_px * rng.uniform(*_ELONGATION),
                semi_minor_px=semi_minor_px,
                softness=rng.uniform(*_SOFTNESS),
                contrast=-contrast if is_dark else contrast,
            )
        )
    return tuple(targets)


def insert_targets(sample: TrainingImage, targets: Sequence[Target]) -> TrainingImage:
    """The sample with targets in its noisy image and its reference; the grain stays."""
    added = _profiles(targets, sample.noisy.shape) * _grain_sigma(sample)
    shadow = sample.shadow
    if shadow is not None:
        shadow = np.where(np.abs(added) > _BLACK, np.float32(0), shadow)
    return replace(
        sample,
        noisy=np.clip(sample.noisy + added, 0, 1),
        clean=np.clip(sample.clean + added, 0, 1),  # NaN, an unknown reference, stays
        shadow=shadow,
    )


def _profiles(targets: Sequence[Target], shape: tuple[int, ...]) -> Float32s:
    """(H, W) sum of the targets, in standard deviations of the grain."""
    height, width = shape
    total = np.zeros(shape, np.float32)
    for target in targets:
        reach = int(2.5 * target.semi_major_px) + 2
        top = max(0, int(target.row) - reach)
        left = max(0, int(target.column) - reach)
        bottom = min(height, int(target.row) + reach + 1)
        right = min(width, int(target.column) + reach + 1)
        rows, columns = np.mgrid[top:bottom, left:right]
        down = rows - target.row
        across = columns - target.column
        cosine = np.cos(target.angle_rad)
        sine = np.sin(target.angle_rad)
        major = (across * cosine + down * sine) / target.semi_major_px
        minor = (down * cosine - across * sine) / target.semi_minor_px
        profile = np.exp(-((major**2 + minor**2) ** target.softness))
        total[top:bottom, left:right] += np.float32(target.contrast) * profile.astype(np.float32)
    return total


def _grain_sigma(sample: TrainingImage) -> Float32s:
    """(H, W) standard deviation of the grain of a single frame around each pixel; 0 in black."""
    noisy = sample.noisy
    grain = noisy - _blurred(noisy, _GRAIN_SIGMA_PX)
    sigma = np.sqrt(_blurred(grain * grain, _AROUND_SIGMA_PX))
    if sample.frames is not None:
        sigma = sigma * np.float32(np.exp2(np.median(sample.frames) / 2))
    is_lit = _blurred(noisy, _AROUND_SIGMA_PX) > _BLACK
    return np.asarray(sigma * is_lit, np.float32)


def _blurred(image: Float32s, sigma_px: float) -> Float32s:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), np.float32)


def _log_uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    low, high = np.log(limits)
    return float(np.exp(rng.uniform(low, high)))
