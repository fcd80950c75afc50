"""Speckle that stands still in part: what the clean picture keeps of it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from simnfnd.factory.pairs import observe
from tests.constant_field import config, constant_field, effects_of

Pictures = tuple[np.ndarray, np.ndarray, np.ndarray]


@cache
def pictures(standing: float) -> Pictures:
    """Noisy, clean, and without speckle, inside of the picture; the transfer curve is linear."""
    settings = config(
        noise={"speckle": {}},
        acoustics={"standing": standing},
        sonar={"transfer": {"kind": "linear", "reference": 0.1, "percentile": 50}},
    )
    made = observe(*constant_field(), settings)
    sample = made.scene.sample(0, effects_of(settings, made), settings)
    noisy, clean, bare = sample.noisy({"speckle"}), sample.clean, sample.without({"speckle"})
    return noisy[8:-8, 8:-8], clean[8:-8, 8:-8], bare[8:-8, 8:-8]


def intensity(picture: np.ndarray) -> np.ndarray:
    """Over that of the mean picture, so that range has no part in it."""
    return np.asarray((picture.astype(np.float64) / pictures(0.0)[1]) ** 2)


def likeness(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of intensities."""
    return float(np.corrcoef(intensity(one).ravel(), intensity(other).ravel())[0, 1])


def test_what_stands_still_whole_is_the_clean_picture() -> None:
    noisy, clean, bare = pictures(1.0)
    np.testing.assert_allclose(clean, noisy, atol=2e-3)
    np.testing.assert_array_equal(bare, clean)


@pytest.mark.parametrize("part", [0.25, 0.5, 0.75])
def test_the_clean_picture_is_as_like_the_noisy_one_as_fields_of_such_a_part(part: float) -> None:
    """|f|^2 of two circular fields whose coherence is sqrt(p) correlate by p (Goodman, 2007)."""
    noisy, clean, _ = pictures(part)
    assert likeness(noisy, clean) == pytest.approx(part, abs=0.08)
    # Averaging took the rest of an exponential intensity, whose contrast is 1.
    power = intensity(clean)
    assert part - 0.1 < power.std() / power.mean() < 1
