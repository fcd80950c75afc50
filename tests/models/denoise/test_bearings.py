"""Interference along a bearing is taken off; walls and black images stay as they are."""

from __future__ import annotations

import numpy as np
import pytest

from simnfnd import denoise
from simnfnd.factory.common.array_types import Array, Float32s
from simnfnd.models.denoise.denoiser import Denoiser
from tests.models.denoise.test_golden import frames


def laid_in(width_deg: float, first: float, last: float) -> tuple[Float32s, Float32s, Array]:
    """A frame without and with a speckled echo along a bearing, and where it is.

    first, last: of the range between its ends, as fractions.
    """
    observed, geometry = frames()
    maps = geometry.maps(0, 0, *observed.shape[1:])
    across = np.exp(-0.5 * ((maps["azimuth_rad"] + 0.05) / np.radians(width_deg / 2.355)) ** 2)
    fraction = (maps["range_fraction"] - geometry.near_fraction) / (1 - geometry.near_fraction)
    speckle = np.random.default_rng(0).gamma(8, 1 / 8, 1000)
    along = speckle[np.clip(1000 * fraction, 0, 999).astype(int)]
    is_there = (fraction >= first) & (fraction <= last) & (maps["sector"] > 0)
    added = np.asarray(0.4 * across * along * is_there, np.float32)
    return observed[2], np.clip(observed[2] + added, 0, 1), added


@pytest.mark.parametrize("width_deg", [3.5, 8.0])
def test_interference_over_all_ranges_is_taken_off(width_deg: float) -> None:
    frame, disturbed, added = laid_in(width_deg, 0, 1)
    network = Denoiser("simnfnd", "cpu")
    left = network(disturbed, frames()[1]) - network(frame, frames()[1])
    assert abs((added * left).sum() / (added * (disturbed - frame)).sum()) < 0.35


def test_a_wall_that_begins_and_ends_stays() -> None:
    frame, disturbed, added = laid_in(1.5, 0.3, 0.6)
    network = Denoiser("simnfnd", "cpu")
    left = network(disturbed, frames()[1]) - network(frame, frames()[1])
    assert (added * left).sum() / (added * (disturbed - frame)).sum() > 0.8


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_black_stays_black(kind: type) -> None:
    assert not denoise(np.zeros((120, 140), kind)).any()


def test_zeros_in_speckle_are_filled() -> None:
    speckle = np.random.default_rng(0).gamma(1, 40, (120, 140)).clip(0, 255).astype(np.uint8)
    speckle[::7, ::7] = 0
    assert (denoise(speckle) == 0).mean() < 0.5 * (speckle == 0).mean()
