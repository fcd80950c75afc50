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


def test_uint8_images_do_not_wrap_around() -> None:
    """200 - 250 is -50 and not 206."""
    a, b = np.full((12, 12), 200, np.uint8), np.full((12, 12), 250, np.uint8)
    assert metrics.psnr(a, b, data_range=255) == pytest.approx(20 * math.log10(255 / 50))


def test_identical_images() -> None:
    clean, _ = waves(32, 32)
    assert metrics.psnr(clean, clean, data_range=255) == math.inf
    assert metrics.finite_psnr(math.inf) == metrics.PSNR_CAP_DB == 100
    assert metrics.finite_psnr(17.64) == 17.64
    assert metrics.ssim(clean, clean, data_range=255) == pytest.approx(1)
    assert metrics.gmsd(clean, clean, data_range=255) == pytest.approx(0, abs=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(11, 40),
    width=st.integers(11, 40),
    pooled=st.booleans(),
)
def test_symmetric_and_bounded(seed: int, height: int, width: int, pooled: bool) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.random((2, height, width))
    assert metrics.psnr(a, b, data_range=1) == metrics.psnr(b, a, data_range=1)
    assert metrics.ssim(a, b, data_range=1) == pytest.approx(metrics.ssim(b, a, data_range=1))
    one = metrics.gmsd(a, b, data_range=1, pooled=pooled)
    assert one == pytest.approx(metrics.gmsd(b, a, data_range=1, pooled=pooled))
    assert 0 <= one <= 0.5  # of values in (0, 1]
    assert -1 <= metrics.ssim(a, b, data_range=1) <= 1
    assert metrics.gmsd(a, a, data_range=1, pooled=pooled) == pytest.approx(0, abs=1e-12)
    # A mirror changes nothing, as long as it does not move the blocks of the pooling.
    if width % 2 == 0 or not pooled:
        mirrored = metrics.gmsd(a[:, ::-1], b[:, ::-1], data_range=1, pooled=pooled)
        assert one == pytest.approx(mirrored)


def test_masked_values_use_the_mask_alone() -> None:
    clean, noisy = waves(64, 64)
    mask = np.zeros(clean.shape, bool)
    mask[8:40, 8:48] = True
    far = ~mask
    far[:16], far[32:56], far[:, :16], far[:, 40:] = False, False, False, False
    outside = noisy.copy()
    outside[60:, 60:] = 0
    for metric in (metrics.psnr, metrics.ssim, metrics.gmsd):
        value = metric(clean, noisy, data_range=255, mask=mask)
        assert metric(clean, outside, data_range=255, mask=mask) == value
        assert metric(clean, outside, data_range=255) != metric(clean, noisy, data_range=255)
        full = metric(clean, noisy, data_range=255, mask=np.ones_like(mask))
        assert full == pytest.approx(metric(clean, noisy, data_range=255))


def test_a_wrong_data_range_is_refused() -> None:
    """0..1 images with range 255 would give an SSIM of .999: the trap must not open."""
    clean, noisy = waves(32, 32)
    for metric in (metrics.psnr, metrics.ssim, metrics.gmsd):
        with pytest.raises(metrics.MetricError, match=r"0\.\.1 images|values 0\.\.1"):
            metric(clean / 255, noisy / 255, data_range=255)
        with pytest.raises(metrics.MetricError, match="data_range"):
            metric(clean, noisy, data_range=1)
        with pytest.raises(metrics.MetricError, match="data_range"):
            metric(clean.astype(np.uint16) * 257, noisy, data_range=255)
        for bad in (0, -1, math.nan, math.inf):
            with pytest.raises(metrics.MetricError, match="positive"):
                metric(clean, noisy, data_range=bad)


def test_unusable_images_are_refused() -> None:
    good = np.zeros((16, 16))
    for bad, words in (
        (np.full((16, 16), np.nan), "NaN"),
        (np.full((16, 16), np.inf), "infinite"),
        (np.zeros((16, 17)), "shape"),
    ):
        for metric in (metrics.psnr, metrics.ssim, metrics.gmsd):
            with pytest.raises(ValueError, match=words):
                metric(good, bad, data_range=1)
    with pytest.raises(metrics.MetricError, match="gray"):
        metrics.psnr(np.zeros((9, 9, 3)), np.zeros((9, 9, 3)), data_range=1)
    with pytest.raises(metrics.MetricError, match="too small"):
        metrics.ssim(np.zeros((10, 30)), np.zeros((10, 30)), data_range=1)
    with pytest.raises(metrics.MetricError, match="too small"):
        metrics.gmsd(np.zeros((4, 30)), np.zeros((4, 30)), data_range=1)
    for mask, words in ((np.zeros((16, 16), bool), "empty"), (np.ones((4, 4), bool), "mask is")):
        for metric in (metrics.psnr, metrics.ssim, metrics.gmsd):
            with pytest.raises(metrics.MetricError, match=words):
                metric(good, good, data_range=1, mask=mask)


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


def test_without_a_shadow() -> None:
    none, light = np.zeros((4, 4), bool), np.full((4, 4), 255, np.uint8)
    assert metrics.shadow_iou(none, light, threshold=5) == 1
    assert math.isnan(metrics.shadow_residual(none, light, data_range=255))
    assert math.isnan(metrics.false_light_rate(none, light, threshold=5))
