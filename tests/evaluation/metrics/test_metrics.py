"""The metrics against published definitions, independent programs and slow loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.evaluation.metrics import fidelity as metrics
from tests.evaluation.metrics.waves import Array, waves

# Computed once with piq 0.8.0 (Apache-2.0) on float64 tensors of `waves`, outside this project:
# piq.gmsd(..., data_range=255), piq.ssim(..., data_range=255, downsample=False).
GOLDEN = {
    (48, 64): {"gmsd": 0.13046247302378455, "ssim": 0.15112336426307857},
    (33, 47): {"gmsd": 0.13210818327493415, "ssim": 0.14360086095825178},
}


@pytest.mark.parametrize("size", GOLDEN)
def test_agrees_with_piq(size: tuple[int, int]) -> None:
    clean, noisy = waves(*size)
    assert metrics.gmsd(clean, noisy, data_range=255) == pytest.approx(
        GOLDEN[size]["gmsd"], abs=1e-9
    )
    assert metrics.ssim(clean, noisy, data_range=255) == pytest.approx(
        GOLDEN[size]["ssim"], abs=1e-9
    )


def slow_gmsd(a: Array, b: Array, pooled: bool) -> float:
    """Xue et al. 2014 pixel by pixel, with nothing in common with the program under test."""

    def pool(gray: Array) -> Array:
        rows, columns = math.ceil(gray.shape[0] / 2), math.ceil(gray.shape[1] / 2)
        out = np.zeros((rows, columns))
        for i in range(rows):
            for j in range(columns):
                out[i, j] = gray[2 * i : 2 * i + 2, 2 * j : 2 * j + 2].sum() / 4
        return out

    def gradient(gray: Array, i: int, j: int) -> float:
        def at(r: int, c: int) -> float:
            inside = 0 <= r < gray.shape[0] and 0 <= c < gray.shape[1]
            return float(gray[r, c]) if inside else 0.0

        across = sum(at(i + k, j - 1) - at(i + k, j + 1) for k in (-1, 0, 1)) / 3
        down = sum(at(i - 1, j + k) - at(i + 1, j + k) for k in (-1, 0, 1)) / 3
        return math.sqrt(across**2 + down**2)

    a, b = a.astype(float), b.astype(float)
    if pooled:
        a, b = pool(a), pool(b)
    values = []
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            m_a, m_b = gradient(a, i, j), gradient(b, i, j)
            values.append((2 * m_a * m_b + 170) / (m_a**2 + m_b**2 + 170))
    mean = sum(values) / len(values)
    return math.sqrt(sum((value - mean) ** 2 for value in values) / len(values))


@pytest.mark.parametrize("pooled", [True, False])
@pytest.mark.parametrize("size", [(16, 20), (15, 20), (17, 13)])
def test_gmsd_is_the_formula(size: tuple[int, int], pooled: bool) -> None:
    clean, noisy = waves(*size)
    expected = slow_gmsd(clean, noisy, pooled)
    assert metrics.gmsd(clean, noisy, data_range=255, pooled=pooled) == pytest.approx(expected)
    # The 0..255 scale that c belongs to is the metric's own business.
    unit = clean / 255, noisy / 255
    assert metrics.gmsd(*unit, data_range=1, pooled=pooled) == pytest.approx(expected)


@settings(max_examples=15, deadline=None)
@given(
    height=st.integers(11, 70),
    width=st.integers(11, 70),
    kind=st.sampled_from(["waves", "random", "fan"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_ssim_is_that_of_scikit_image(height: int, width: int, kind: str, seed: int) -> None:
    """Every pixel of the map, its borders too, in the units of the data range."""
    from skimage.metrics import structural_similarity

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
    ours = metrics.ssim_map(a.astype(float), b.astype(float), data_range=255)
    np.testing.assert_allclose(ours, similarity, rtol=0, atol=1e-9)
    value = metrics.ssim(a.astype(float), b.astype(float), data_range=255)
    assert value == pytest.approx(mean, abs=1e-9)


def test_psnr_is_the_formula() -> None:
    a = np.zeros((4, 5), np.uint8)
    b = np.full((4, 5), 51, np.uint8)  # a fifth of full scale: 20 log10(5)
    assert metrics.psnr(a, b, data_range=255) == pytest.approx(13.9794000867)
    assert metrics.psnr(a / 255, b / 255, data_range=1) == pytest.approx(13.9794000867)
    half = np.zeros((4, 5), bool)
    half[:2] = True
    b[:2] = 255
    assert metrics.psnr(a, b, data_range=255, mask=half) == pytest.approx(0)


def test_identical_images() -> None:
    clean, _ = waves(32, 32)
    assert metrics.psnr(clean, clean, data_range=255) == math.inf
    assert metrics.finite_psnr(math.inf) == metrics.PSNR_CAP_DB == 100
    assert metrics.finite_psnr(17.64) == 17.64
    assert metrics.ssim(clean, clean, data_range=255) == pytest.approx(1)
    assert metrics.gmsd(clean, clean, data_range=255) == pytest.approx(0, abs=1e-12)


def test_masks_count_alone_and_masked_pixels_do_not() -> None:
    clean, noisy = waves(64, 64)
    mask = np.zeros(clean.shape, bool)
    mask[8:40, 8:48] = True
    outside = noisy.copy()
    outside[60:, 60:] = 0
    for metric in (metrics.psnr, metrics.ssim, metrics.gmsd):
        value = metric(clean, noisy, data_range=255, mask=mask)
        assert metric(clean, outside, data_range=255, mask=mask) == value
        assert metric(clean, outside, data_range=255) != metric(clean, noisy, data_range=255)


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
    for metric in (metrics.ssim, metrics.gmsd):
        for images, options, words in cases:
            with pytest.raises(metrics.MetricError, match=words):
                metric(*images, **options)  # type: ignore[arg-type]


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
    assert metrics.shadow_residual(shadow, image, data_range=255) == pytest.approx(50 / 255)
    assert metrics.false_light_rate(shadow, image, threshold=5) == pytest.approx(0.5)
    perfect = np.where(shadow, 0, 255).astype(np.uint8)
    assert metrics.shadow_iou(shadow, perfect, threshold=5) == 1
    assert metrics.shadow_residual(shadow, perfect, data_range=255) == 0
    none = np.zeros((4, 4), bool)
    assert metrics.shadow_iou(none, perfect + np.uint8(9), threshold=5) == 1
    assert math.isnan(metrics.shadow_residual(none, perfect, data_range=255))
    assert math.isnan(metrics.false_light_rate(none, perfect, threshold=5))
