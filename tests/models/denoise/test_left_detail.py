"""Residue of noise is smoothed; where detail is finer than noise, part is total variation."""

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


def test_what_is_left_is_the_networks_where_ground_and_noise_are_as_usual() -> None:
    noisy = textured(0, 0.1)
    denoised = textured(1, 0.045)
    change = corrected_by_detail(noisy, denoised) - denoised
    assert np.abs(change).max() < 0.1 * denoised.std()


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
