"""Residue of noise is smoothed; where there is ground, part is total variation."""

from __future__ import annotations

import cv2
import numpy as np

from simnfnd.factory.common.array_types import Float32s
from simnfnd.models.denoise.left_detail import corrected_by_detail

_SIDE_PX = 64


def textured(seed: int, sigma: float) -> Float32s:
    """Grey of .4 with white texture."""
    values = 0.4 + sigma * np.random.default_rng(seed).standard_normal((_SIDE_PX, _SIDE_PX))
    return values.astype(np.float32)


def roughness_left(correlation_px: float) -> float:
    """Roughness of ground after, over that before, beside grain that is this wide."""
    ground = np.asarray(cv2.GaussianBlur(textured(1, 0.1), (0, 0), 0.8), np.float32)
    grain = textured(0, 1.0) - np.float32(0.4)
    if correlation_px:
        grain = np.asarray(cv2.GaussianBlur(grain, (0, 0), correlation_px), np.float32)
    grain *= np.float32(0.05) / grain.std()
    corrected = corrected_by_detail(ground + grain, ground)
    return float(cv2.Laplacian(corrected, cv2.CV_32F).std() / cv2.Laplacian(ground, -1).std())


def test_fine_detail_is_ground_where_pixels_are_separate_and_grain_where_they_are_not() -> None:
    assert roughness_left(0.7) < 0.95 * roughness_left(0)


def test_dark_pits_in_saturated_ground_are_filled() -> None:
    level = textured(6, 0.25) + np.float32(0.7)
    noisy = np.clip(level, 0, 1)
    denoised = np.asarray(cv2.GaussianBlur(noisy, (0, 0), 0.6), np.float32)
    corrected = corrected_by_detail(noisy, denoised)
    assert corrected.std() < 0.8 * denoised.std()


def test_residue_of_noise_in_open_water_is_removed() -> None:
    noisy = textured(0, 0.1)
    denoised = np.float32(0.4) + np.float32(0.15) * (noisy - np.float32(0.4))
    assert corrected_by_detail(noisy, denoised).std() < 0.5 * denoised.std()


def test_an_echo_in_open_water_stays() -> None:
    noisy = textured(0, 0.1)
    denoised = np.float32(0.4) + np.float32(0.15) * (noisy - np.float32(0.4))
    denoised[30:34, 30:34] += np.float32(0.2)  # two standard deviations
    corrected = corrected_by_detail(noisy, denoised)
    assert corrected[30:34, 30:34].mean() > 0.4 + 0.85 * 0.2


def test_edges_closer_than_the_network_knows_are_kept_in_part() -> None:
    stones = 0.4 + 0.1 * np.random.default_rng(2).standard_normal((_SIDE_PX // 4, _SIDE_PX // 4))
    ground = np.kron(stones, np.ones((4, 4))).astype(np.float32)
    noisy = ground + (textured(3, 0.03) - np.float32(0.4))
    denoised = np.asarray(cv2.GaussianBlur(noisy, (0, 0), 1.0), np.float32)
    corrected = corrected_by_detail(noisy, denoised)
    assert np.square(corrected - ground).mean() < 0.8 * np.square(denoised - ground).mean()


def test_an_image_that_the_network_leaves_stays_as_it_is() -> None:
    image = textured(4, 0.05)
    assert np.abs(corrected_by_detail(image, image) - image).max() < 1 / 512


def test_a_gain_changes_nothing_else() -> None:
    noisy = textured(5, 0.05)
    denoised = np.float32(0.4) + np.float32(0.5) * (noisy - np.float32(0.4))
    corrected = corrected_by_detail(noisy, denoised)
    halved = corrected_by_detail(noisy / 2, denoised / 2)
    np.testing.assert_allclose(2 * halved, corrected, atol=1e-5)
