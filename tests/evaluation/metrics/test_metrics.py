"""The metrics against published definitions, independent programs and slow computations."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage
from skimage.metrics import structural_similarity

from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.evaluation.metrics.fidelity import Reference, deviation
from simnfnd.evaluation.metrics.measure import (
    contrast_to_noise,
    enl,
    fit_levels,
    homogeneous_zones,
    ratio_figures,
)
from simnfnd.factory.common.array_types import Array
from simnfnd.factory.dataset import quality


def waves(height: int, width: int) -> tuple[Array, Array]:
    """The recipe of the golden images: whole grey values from a formula, no random numbers."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    clean = 127.5 + 80 * np.sin(x / 5) * np.cos(y / 7) + 40 * ((x // 8 + y // 8) % 2)
    clean = np.clip(np.rint(clean), 0, 255)
    noisy = 0.6 * clean + 20 + 90 * np.sin(12.9898 * x + 78.233 * y)
    return clean.astype(np.uint8), np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def gmsd(clean: Array, noisy: Array, *, data_range: float, pooled: bool = True) -> float:
    a, b = metrics.checked_pair(clean, noisy, data_range)
    return deviation(Reference(a, data_range).gms_map(b, pooled=pooled))


def ms_ssim(clean: Array, noisy: Array) -> float:
    return Reference(clean.astype(float), 255).ms_ssim(noisy.astype(float))


# Computed once with piq 0.8.0 (Apache-2.0) on float64 tensors of `waves`, outside this project:
# piq.gmsd(..., data_range=255), piq.ssim(..., data_range=255, downsample=False).
GOLDEN = {
    (48, 64): {"gmsd": 0.13046247302378455, "ssim": 0.15112336426307857},
    (33, 47): {"gmsd": 0.13210818327493415, "ssim": 0.14360086095825178},
}


@pytest.mark.parametrize("size", GOLDEN)
def test_agrees_with_piq_and_with_the_figures_of_datasets(size: tuple[int, int]) -> None:
    clean, noisy = waves(*size)
    expected = GOLDEN[size]
    assert gmsd(clean, noisy, data_range=255) == pytest.approx(expected["gmsd"], abs=1e-9)
    assert metrics.ssim(clean, noisy, data_range=255) == pytest.approx(expected["ssim"], abs=1e-9)
    assert quality.gmsd(clean, noisy) == pytest.approx(expected["gmsd"], abs=1e-9)
    assert quality.ssim(clean, noisy) == pytest.approx(expected["ssim"], abs=1e-9)
    psnr_db = metrics.psnr(clean, noisy, data_range=255)
    assert quality.psnr_db(clean, noisy) == pytest.approx(psnr_db, abs=1e-9)


@pytest.mark.parametrize("size", [(16, 20), (17, 13)])
def test_unpooled_gmsd_is_the_formula(size: tuple[int, int]) -> None:
    """Xue et al. 2014, written once more; c = 170 belongs to 0..255, whatever the range."""
    prewitt = np.outer([1, 1, 1], [1, 0, -1]) / 3

    def gradient(image: Array) -> Array:
        grey = image.astype(float)
        across, down = (ndimage.convolve(grey, k, mode="constant") for k in (prewitt, prewitt.T))
        return np.asarray(np.hypot(across, down))

    clean, noisy = waves(*size)
    a, b = gradient(clean), gradient(noisy)
    expected = ((2 * a * b + 170) / (a**2 + b**2 + 170)).std()
    assert gmsd(clean, noisy, data_range=255, pooled=False) == pytest.approx(expected)
    assert gmsd(clean / 255, noisy / 255, data_range=1, pooled=False) == pytest.approx(expected)


@settings(max_examples=15, deadline=None)
@given(
    height=st.integers(11, 70),
    width=st.integers(11, 70),
    kind=st.sampled_from(["waves", "random", "fan"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_ssim_is_that_of_scikit_image(height: int, width: int, kind: str, seed: int) -> None:
    """Every pixel of the map, its borders too, in the units of the data range."""
    rng = np.random.default_rng(seed)
    a, b = waves(height, width)
    if kind == "random":
        a, b = rng.random((2, height, width)) * 255
    elif kind == "fan":
        a = np.where(np.add.outer(np.arange(height), np.arange(width)) % 29 < 9, 0, a)
        b = np.where(a == 0, 0, b)
    mean, similarity = structural_similarity(
        a.astype(float), b.astype(float), data_range=255, gaussian_weights=True, sigma=1.5,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    ours = Reference(a.astype(float), 255).ssim_map(b.astype(float))
    np.testing.assert_allclose(ours, similarity, rtol=0, atol=1e-9)
    assert metrics.ssim(a, b, data_range=255) == pytest.approx(mean, abs=1e-9)


def test_psnr_is_the_formula_and_identical_images_have_a_stated_rule() -> None:
    a = np.zeros((32, 32), np.uint8)
    b = np.full((32, 32), 51, np.uint8)  # a fifth of full scale: 20 log10(5)
    assert metrics.psnr(a, b, data_range=255) == pytest.approx(13.9794000867)
    assert metrics.psnr(a / 255, b / 255, data_range=1) == pytest.approx(13.9794000867)
    clean, _ = waves(32, 32)
    assert metrics.psnr(clean, clean, data_range=255) == math.inf
    assert metrics.finite_psnr(math.inf) == quality.PSNR_CAP_DB == 100
    assert metrics.ssim(clean, clean, data_range=255) == pytest.approx(1)
    assert gmsd(clean, clean, data_range=255) == pytest.approx(0, abs=1e-12)


def test_masks_count_alone_and_masked_pixels_do_not() -> None:
    clean, noisy = waves(64, 64)
    mask = np.zeros(clean.shape, bool)
    mask[8:40, 8:48] = True
    outside = noisy.copy()
    outside[60:, 60:] = 0
    for metric in (metrics.psnr, metrics.ssim):
        value = metric(clean, noisy, data_range=255, mask=mask)
        assert metric(clean, outside, data_range=255, mask=mask) == value
        assert metric(clean, outside, data_range=255) != metric(clean, noisy, data_range=255)
    similarities = [Reference(clean / 255, 1).gms_map(image / 255) for image in (noisy, outside)]
    within = [deviation(similarity, mask) for similarity in similarities]
    assert within[0] == within[1] != deviation(similarities[0])


def test_unusable_images_and_ranges_are_refused() -> None:
    """0..1 images with range 255 would give an SSIM of .999: the trap must not open."""
    clean, noisy = waves(32, 32)
    good = np.zeros((32, 32))
    cases = [
        ((clean / 255, noisy / 255), {"data_range": 255}, r"0\.\.1 images|values 0\.\.1"),
        ((clean, noisy), {"data_range": 1}, "data_range"),
        ((clean, noisy), {"data_range": 0}, "positive"),
        ((good, np.full((32, 32), np.nan)), {"data_range": 1}, "NaN"),
        ((good, np.zeros((32, 33))), {"data_range": 1}, "shape"),
        ((good, good), {"data_range": 1, "mask": np.zeros((32, 32), bool)}, "empty"),
        ((good[:4], good[:4]), {"data_range": 1}, "too small"),
    ]
    for images, options, words in cases:
        with pytest.raises(metrics.MetricError, match=words):
            metrics.ssim(*images, **options)  # type: ignore[arg-type]


def test_shadow_metrics() -> None:
    shadow = np.zeros((4, 4), bool)
    shadow[:2] = True  # 8 pixels
    image = np.full((4, 4), 100, np.uint8)
    image[0] = 0  # half of the shadow is still dark,
    image[3] = 0  # and one row of light went dark
    assert metrics.shadow_iou(shadow, image, threshold=5) == pytest.approx(4 / 12)
    sector = np.ones((4, 4), bool)
    sector[3] = False
    assert metrics.shadow_iou(shadow, image, threshold=5, sector=sector) == pytest.approx(4 / 8)
    assert metrics.shadow_residual(shadow, image) == pytest.approx(50)
    assert metrics.false_light_rate(shadow, image, threshold=5) == pytest.approx(0.5)
    perfect = np.where(shadow, 0, 255).astype(np.uint8)
    assert metrics.shadow_iou(shadow, perfect, threshold=5) == 1
    assert metrics.shadow_residual(shadow, perfect) == 0
    none = np.zeros((4, 4), bool)
    assert metrics.shadow_iou(none, perfect + np.uint8(9), threshold=5) == 1
    assert math.isnan(metrics.shadow_residual(none, perfect))
    assert math.isnan(metrics.false_light_rate(none, perfect, threshold=5))


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
        mu_a = averages(a)
        mu_b = averages(b)
        var_a = averages(a**2) - mu_a**2
        var_b = averages(b**2) - mu_b**2
        cov: Array = averages(a * b) - mu_a * mu_b
        c1 = (0.01 * full) ** 2
        c2 = (0.03 * full) ** 2
        term = (2 * cov + c2) / (var_a + var_b + c2)
        if scale == 4:
            term = term * (2 * mu_a * mu_b + c1) / (mu_a**2 + mu_b**2 + c1)
        product *= max(float(term.mean()), 0) ** weight
        a, b = (
            (v[:-1:2, :-1:2] + v[1::2, :-1:2] + v[:-1:2, 1::2] + v[1::2, 1::2]) / 4
            for v in (v[: v.shape[0] // 2 * 2, : v.shape[1] // 2 * 2] for v in (a, b))
        )
    return product


@pytest.mark.parametrize("size", [(176, 179)])
def test_ms_ssim_is_the_formula(size: tuple[int, int]) -> None:
    clean, noisy = waves(*size)
    expected = slow_ms_ssim(clean.astype(float), noisy.astype(float), 255)
    assert 0.05 < expected < 0.95
    assert ms_ssim(clean, noisy) == pytest.approx(expected, abs=1e-9)
    # The negative has a negative structure term, which has no real root.
    assert ms_ssim(clean, 255 - clean) == 0


def test_edge_preservation_is_the_correlation_of_laplacians() -> None:
    clean, noisy = (image.astype(float) for image in waves(20, 24))

    def laplacian(image: Array) -> list[float]:
        return [
            image[i - 1, j] + image[i + 1, j] + image[i, j - 1] + image[i, j + 1] - 4 * image[i, j]
            for i in range(1, 19)
            for j in range(1, 23)
        ]

    expected = np.corrcoef(laplacian(clean), laplacian(noisy))[0, 1]
    reference = Reference(clean, 255)
    assert reference.edges_kept(noisy) == pytest.approx(expected, abs=1e-12)
    assert reference.edges_kept(clean) == pytest.approx(1)
    # Brightness is no edge.
    assert reference.edges_kept(0.3 * clean + 9) == pytest.approx(1)


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
    bright = np.array([[0, 0], [1, 1]], bool)
    dark = np.array([[1, 1], [0, 0]], bool)
    # Means 12 and 2, variances 4 and 1.
    assert contrast_to_noise(image, bright, dark) == pytest.approx(10 / math.sqrt(5))
    assert contrast_to_noise(image / 14, bright, dark) == pytest.approx(10 / math.sqrt(5))
    assert math.isnan(contrast_to_noise(image, bright, np.zeros_like(dark)))
    assert contrast_to_noise(np.where(bright, 1.0, 0.0), bright, dark) == math.inf
    assert contrast_to_noise(np.zeros((2, 2)), bright, dark) == 0


def test_ratio_mean_is_that_of_the_lit_pixels() -> None:
    noisy = np.array([[0.2, 0.6, 0.5]])
    denoised = np.array([[0.4, 0.3, 0.0]])
    assert ratio_figures(noisy, denoised)["ratio_mean"] == pytest.approx(1.25)
    nothing = ratio_figures(noisy, np.zeros_like(noisy))
    assert all(math.isnan(value) for value in nothing.values())


def test_structure_in_a_ratio_image_is_what_a_filter_took_along() -> None:
    """Noise of four looks removed exactly, and with edges of the scene in it."""
    rng = np.random.default_rng(0)
    clean = np.where(np.arange(96)[:, None] // 12 % 2, 0.3, 0.5) * np.ones((96, 96))
    noisy = np.asarray(clean * rng.gamma(4, 1 / 4, clean.shape), np.float32)
    exact = ratio_figures(noisy, clean)
    assert exact["ratio_mean"] == pytest.approx(1, abs=0.03)
    assert exact["ratio_variance"] == pytest.approx(1 / 4, abs=0.03)
    assert exact["ratio_correlation"] == pytest.approx(0, abs=0.03)
    blurred = ratio_figures(noisy, cv2.GaussianBlur(clean, (0, 0), 9))
    assert blurred["ratio_correlation"] > 0.1
    same = ratio_figures(noisy, noisy)
    assert same["ratio_variance"] == 0
    assert math.isnan(same["ratio_correlation"])
    left = np.zeros(clean.shape, bool)
    left[:, :48] = True
    changed = clean.copy()
    changed[:, 48:] *= 3
    assert ratio_figures(noisy, changed, left) == ratio_figures(noisy, clean, left)


@settings(max_examples=10, deadline=None)
@given(gain=st.floats(0.2, 3), offset=st.floats(-0.4, 0.4), seed=st.integers(0, 2**32 - 1))
def test_levels_are_the_straight_line_fit(gain: float, offset: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = [(rng.random((7, 9)), rng.random((7, 9))) for _ in range(3)]
    inputs, outputs = np.array(pairs).swapaxes(0, 1).reshape(2, -1)
    fitted = fit_levels(pairs)
    assert (fitted.gain, fitted.offset) == pytest.approx(np.polyfit(inputs, outputs, 1), abs=1e-9)
    exact = fit_levels((a, gain * a + offset) for a, _ in pairs)
    assert (exact.gain, exact.offset) == pytest.approx((gain, offset), abs=1e-9)
    result = exact(pairs[0][0])
    assert 0 <= result.min() <= result.max() <= 1
    flat = fit_levels([(np.full((3, 3), 0.2), np.full((3, 3), 0.7))])
    assert (flat.gain, flat.offset) == pytest.approx((0, 0.7))
