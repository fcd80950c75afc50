"""Width of grain: what decides it, and what must not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Float32s
from simnfnd.models.denoise.grain_width import grain_correlation

SIDE = 256


def speckle(side: int = SIDE) -> Float32s:
    rng = np.random.default_rng(0)
    grain = rng.gamma(4, 0.25, (side, side)).astype(np.float32)
    return np.asarray(np.clip(0.2 * cv2.GaussianBlur(grain, (0, 0), 0.5), 0, 1), np.float32)


def test_enlarged_grain_is_wider() -> None:
    plain = speckle()
    enlarged = cv2.resize(plain, None, fx=1.5, fy=1.5, interpolation=cv2.INTER_LINEAR)
    assert grain_correlation(plain) < 0.4
    assert grain_correlation(np.asarray(enlarged, np.float32)) > 0.56


def test_bright_band_and_letters_do_not_widen_grain() -> None:
    plain = speckle()
    changed = plain.copy()
    changed[150:200] *= 6
    changed[8:18, 6:60:8] = 1
    changed = np.clip(changed, 0, 1)
    assert grain_correlation(changed) == pytest.approx(grain_correlation(plain), abs=0.03)


@pytest.mark.parametrize("gain", [0.1, 0.5, 1.5])
def test_gain_changes_nothing(gain: float) -> None:
    plain = speckle()
    actual = grain_correlation(np.float32(gain) * plain)
    assert actual == pytest.approx(grain_correlation(plain), abs=0.01)


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_image_without_grain_has_none(level: float) -> None:
    assert grain_correlation(np.full((SIDE, SIDE), level, np.float32)) < 0.56


def test_small_image_has_too_few_blocks() -> None:
    assert grain_correlation(speckle(48)) == 0
