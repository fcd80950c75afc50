"""MS-SSIM, edges, speckle: against slow computations of their own and against what must hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from simnfnd.evaluation.metrics.fidelity import (
    edge_preservation,
    gmsd,
    ms_ssim,
)
from simnfnd.evaluation.metrics.measure import (
    Picture,
    Scene,
    contrast_to_noise,
    enl,
    homogeneous_zones,
    mean_ratio,
    sector_of,
)
from tests.evaluation.metrics.waves import waves

Array = npt.NDArray[Any]


def slow_ms_ssim(a: Array, b: Array, full: float) -> float:
    """Wang et al. 2003 with every window written out."""
    y, x = np.mgrid[-5:6, -5:6]
    window = np.exp(-(x**2 + y**2) / (2 * 1.5**2))
    window /= window.sum()

    def averages(values: Array) -> Array:
        windows = sliding_window_view(values, (11, 11))
        return np.asarray(np.einsum("ijkl,kl->ij", windows, window))

    product = 1.0
    weights = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333]
    for scale, weight in enumerate(weights):
        mu_a, mu_b = averages(a), averages(b)
        var_a, var_b = averages(a**2) - mu_a**2, averages(b**2) - mu_b**2
        cov: Array = averages(a * b) - mu_a * mu_b
        c1, c2 = (0.01 * full) ** 2, (0.03 * full) ** 2
        term = (2 * cov + c2) / (var_a + var_b + c2)
        if scale == 4:
            term = term * (2 * mu_a * mu_b + c1) / (mu_a**2 + mu_b**2 + c1)
        product *= max(float(term.mean()), 0) ** weight
        a, b = (
            (v[:-1:2, :-1:2] + v[1::2, :-1:2] + v[:-1:2, 1::2] + v[1::2, 1::2]) / 4
            for v in (v[: v.shape[0] // 2 * 2, : v.shape[1] // 2 * 2] for v in (a, b))
        )
    return product


@pytest.mark.parametrize("size", [(176, 176), (179, 201)])
def test_ms_ssim_is_the_formula(size: tuple[int, int]) -> None:
    clean, noisy = waves(*size)
    expected = slow_ms_ssim(clean.astype(float), noisy.astype(float), 255)
    assert 0.05 < expected < 0.95
    assert ms_ssim(clean, noisy, data_range=255) == pytest.approx(expected, abs=1e-9)
    # The negative has a negative structure term, which has no real root.
    assert ms_ssim(clean, 255 - clean, data_range=255) == 0


def test_edge_preservation_is_the_correlation_of_laplacians() -> None:
    clean, noisy = (image.astype(float) for image in waves(20, 24))

    def laplacian(image: Array) -> list[float]:
        return [
            image[i - 1, j] + image[i + 1, j] + image[i, j - 1] + image[i, j + 1] - 4 * image[i, j]
            for i in range(1, 19)
            for j in range(1, 23)
        ]

    expected = np.corrcoef(laplacian(clean), laplacian(noisy))[0, 1]
    assert edge_preservation(clean, noisy, data_range=255) == pytest.approx(expected, abs=1e-12)
    assert edge_preservation(clean, clean, data_range=255) == pytest.approx(1)
    # Brightness is no edge.
    assert edge_preservation(clean, 0.3 * clean + 9, data_range=255) == pytest.approx(1)


def speckled(level: Array, looks: float, seed: int = 0) -> Array:
    """`level` times gamma speckle of mean 1 and ENL `looks`, scaled to stay within 0..1."""
    rng = np.random.default_rng(seed)
    return np.asarray(level * rng.gamma(looks, 1 / looks, level.shape))


def test_enl_is_the_number_of_looks() -> None:
    everywhere = np.ones((256, 256), bool)
    for looks in (4, 16, 64):
        image = speckled(np.full((256, 256), 0.2), looks)
        zones = homogeneous_zones(
            np.full((256, 256), 0.2), data_range=1, sector=everywhere, share=1.0
        )
        assert len(zones) == 256
        assert enl(image, zones) == pytest.approx(looks, rel=0.05)
        # Gain does not change it, blur does.
        assert enl(3 * image, zones) == pytest.approx(enl(image, zones))
        assert enl(ndimage.uniform_filter(image, 3), zones) > 2 * enl(image, zones)
    assert enl(np.full((256, 256), 0.2), zones) == math.inf
    assert math.isnan(enl(image, zones[:0]))


def test_zones_are_even_bright_and_inside() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((96, 112))
    image[32:48, 48:64] = 0.5 + 0.01 * rng.random((16, 16))  # the one to find
    image[0:16, 0:16] = 0.5  # evener, but the sector lacks a pixel of it
    image[64:80, 16:32] = 0.01  # even, but dark
    sector = np.ones(image.shape, bool)
    sector[3, 3] = False
    zones = homogeneous_zones(image, data_range=1, sector=sector)
    assert zones[0].tolist() == [32, 48]
    assert len(zones) == 4  # a tenth of 6 * 7 - 2


def test_contrast_to_noise_is_the_formula() -> None:
    image = np.array([[1.0, 3.0], [10.0, 14.0]])
    bright, dark = np.array([[0, 0], [1, 1]], bool), np.array([[1, 1], [0, 0]], bool)
    # Means 12 and 2, variances 4 and 1.
    assert contrast_to_noise(image, bright, dark) == pytest.approx(10 / math.sqrt(5))
    assert contrast_to_noise(image / 14, bright, dark) == pytest.approx(10 / math.sqrt(5))
    assert math.isnan(contrast_to_noise(image, bright, np.zeros_like(dark)))
    assert contrast_to_noise(np.where(bright, 1.0, 0.0), bright, dark) == math.inf
    assert contrast_to_noise(np.zeros((2, 2)), bright, dark) == 0


def test_ratio_mean_is_that_of_the_lit_pixels() -> None:
    noisy, denoised = np.array([[0.2, 0.6, 0.5]]), np.array([[0.4, 0.3, 0.0]])
    assert mean_ratio(noisy, denoised) == pytest.approx(1.25)
    assert math.isnan(mean_ratio(noisy, np.zeros_like(noisy)))


def test_what_methods_share_on_a_pair_changes_no_figure() -> None:
    rng = np.random.default_rng(5)
    clean = np.asarray(waves(192, 200)[0] / 255, dtype=np.float32)
    noisy = np.clip(speckled(clean, 9), 0, 1).astype(np.float32)
    shadow = np.zeros(clean.shape, bool)
    shadow[60:90, 40:120] = True
    clean[shadow], noisy[:, :20], clean[:, :20] = 0, 0, 0
    sector = sector_of(noisy, clean, shadow)
    scene = Scene(Picture(noisy, clean, shadow, sector))
    zones = homogeneous_zones(clean, data_range=1, sector=sector)
    assert len(zones) > 1
    for image in (noisy, ndimage.gaussian_filter(noisy, 2), rng.random(clean.shape, np.float32)):
        found = scene.figures(image)
        alone = {
            "gmsd_unpooled": gmsd(clean, image, data_range=1, pooled=False),
            "ms_ssim": ms_ssim(clean, image, data_range=1),
            "edge_preservation": edge_preservation(clean, image, data_range=1, mask=sector),
            "enl": enl(image, zones),
            "cnr": contrast_to_noise(image, sector & ~shadow & (clean > 0), shadow),
            "ratio_mean": mean_ratio(noisy, image),
        }
        assert {name: found[name] for name in alone} == pytest.approx(alone, abs=1e-9)
