"""The classical methods against slow computations and against what they promise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from simnfnd.evaluation.filters import REGISTRY, Baseline, chosen
from simnfnd.evaluation.metrics.fidelity import psnr
from simnfnd.evaluation.metrics.measure import fit_levels
from simnfnd.factory.errors import FactoryError
from tests.evaluation.filters.scenes import Array, noisy_scene, run, scene

NAMES = tuple(REGISTRY)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [(33, 47), (12, 12)])
def test_gives_a_picture_for_every_picture(name: str, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    for image in (
        rng.random(size, dtype=np.float32),
        np.zeros(size, np.float32),
        np.ones(size, np.float32),
        (rng.random(size) > 0.9).astype(np.float32),
    ):
        before = image.copy()
        result = run(name, image)
        assert result.shape == size
        assert result.dtype == np.float32
        assert 0 <= result.min() <= result.max() <= 1
        np.testing.assert_array_equal(image, before)
        np.testing.assert_array_equal(run(name, image), result)
        if not image.any():
            assert not result.any(), "light where nothing was"
        if image.min() == 1:
            np.testing.assert_allclose(result, 1, atol=0.01)


@pytest.mark.parametrize("name", [n for n in NAMES if n != "identity"])
def test_some_point_of_the_grid_helps(name: str) -> None:
    """Every denoiser gains on noise that it is made for."""
    white = ("bm3d", "nlm", "tv", "wavelet", "bilateral")
    kind = "white" if name in white else "speckle"
    clean, noisy = scene(), noisy_scene(kind)
    if name == "grey_opening":  # is made for specks
        noisy = np.where(np.random.default_rng(0).random(clean.shape) < 0.03, 1, clean)
        noisy = noisy.astype(np.float32)
    before = psnr(clean, noisy.astype(np.float32), data_range=1)
    slow = name in ("srad", "bm3d")
    points = [dict(REGISTRY[name].default)] if slow else REGISTRY[name].points()[::2]
    if name == "srad":
        points = [{**points[0], "iterations": 60, "initial_cv": 0.3}]
    gains = [psnr(clean, REGISTRY[name](noisy, p), data_range=1) - before for p in points]
    assert max(gains) > (1.5 if name == "nlm" else 2.0)


def test_bm3d_is_the_best_on_white_noise_and_repeats() -> None:
    """Where it is made for, block matching beats everything simpler at its best."""
    y, x = np.mgrid[0:128, 0:128]
    clean = (0.5 + 0.2 * np.sin(x / 2.2) * (y > 64) + 0.2 * (x > y)).astype(np.float32)
    noise = np.random.default_rng(2).normal(0, 0.1, clean.shape)
    noisy = np.clip(clean + noise, 0, 1).astype(np.float32)
    best = {
        name: max(
            psnr(clean, REGISTRY[name](noisy, p), data_range=1) for p in REGISTRY[name].points()
        )
        for name in ("gaussian", "median", "bilateral", "nlm", "tv", "wavelet")
    }
    assert psnr(clean, run("bm3d", noisy, sigma=0.1), data_range=1) > max(best.values()) + 2


def test_bm3d_leaves_a_noiseless_picture() -> None:
    """Transforms, stacks and the weighted sum put together again what they took apart."""
    image = noisy_scene("white", 41)
    np.testing.assert_allclose(run("bm3d", image, sigma=1e-4), image, atol=2e-4)


@pytest.mark.parametrize("shape", [(40, 33), (7, 64)])
def test_median_of_stored_pictures_is_that_of_any_other(shape: tuple[int, int]) -> None:
    stored = np.random.default_rng(3).integers(0, 256, shape).astype(np.float32) / np.float32(255)
    finer = np.nextafter(stored, np.float32(0.5))
    for size in (2, 3, 5, 9):
        for image in (stored, finer):
            expected = ndimage.median_filter(image, size=size, mode="nearest")
            np.testing.assert_array_equal(run("median", image, size=size), expected)


def test_median_and_opening_are_the_definition() -> None:
    image = noisy_scene("speckle", 20)
    around = np.pad(image, 2, mode="edge")
    low = np.pad(image, 4, mode="edge")
    for row, column in ((0, 0), (7, 11), (19, 3)):
        window = sorted(around[row : row + 5, column : column + 5].ravel())
        assert run("median", image, size=5)[row, column] == window[12]
    # Opening: the brightest of the darkest.
    expected = max(
        min(low[r + i, c + j] for i in range(-1, 2) for j in range(-1, 2))
        for r in range(10, 13)
        for c in range(14, 17)
    )
    assert run("grey_opening", image, size=3)[11 - 4, 15 - 4] == expected


def local(image: Array, row: int, column: int, size: int) -> tuple[Array, float, float]:
    """Window, its mean and its squared coefficient of variation."""
    r = size // 2
    window = image[row - r : row + r + 1, column - r : column + r + 1].astype(float)
    return window, float(window.mean()), float(window.var() / window.mean() ** 2)


def test_lee_kuan_and_frost_are_their_formulas() -> None:
    image = noisy_scene("speckle", 40)
    for row, column in ((20, 20), (9, 30), (12, 4)):
        window, mean, ci2 = local(image, row, column, 7)
        pixel, cu2 = float(image[row, column]), 0.1**2
        weight = max(1 - cu2 / ci2, 0)
        lee = run("lee", image, size=7, noise_cv=0.1)[row, column]
        assert lee == pytest.approx(mean + weight * (pixel - mean), abs=1e-6)
        kuan = run("kuan", image, size=7, noise_cv=0.1)[row, column]
        assert kuan == pytest.approx(mean + weight / (1 + cu2) * (pixel - mean), abs=1e-6)
        y, x = np.mgrid[-3:4, -3:4]
        weights = np.exp(-2 * ci2 * np.sqrt(x**2 + y**2))
        expected = (weights * window).sum() / weights.sum()
        assert run("frost", image, size=7, damping=2)[row, column] == pytest.approx(
            expected, abs=1e-6
        )


def test_srad_is_the_formula_step_by_step() -> None:
    image = np.clip(noisy_scene("speckle", 12), 0.05, 0.7)
    values, q0 = image.astype(float), 0.3
    for number in range(3):
        q0_now = (q0 * math.exp(-number * 0.2 / 6)) ** 2

        def at(i: int, j: int, values: Array = values) -> float:
            return float(values[min(max(i, 0), 11), min(max(j, 0), 11)])

        conduct = np.zeros((12, 12))
        for i in range(12):
            for j in range(12):
                steps = [at(i + a, j + b) - at(i, j) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
                gradient = sum(step**2 for step in steps) / at(i, j) ** 2
                laplace = sum(steps) / at(i, j)
                q2 = max(gradient / 2 - laplace**2 / 16, 0) / (1 + laplace / 4) ** 2
                spread = (q2 - q0_now) / (q0_now * (1 + q0_now))
                conduct[i, j] = 1 / (1 + max(spread, 0))
        after = values.copy()
        for i in range(12):
            for j in range(12):
                down, right = conduct[min(i + 1, 11), j], conduct[i, min(j + 1, 11)]
                flow = down * (at(i + 1, j) - at(i, j)) + right * (at(i, j + 1) - at(i, j))
                flow += conduct[i, j] * (at(i - 1, j) + at(i, j - 1) - 2 * at(i, j))
                after[i, j] += 0.2 / 4 * flow
        values = after
    np.testing.assert_allclose(run("srad", image, iterations=3, initial_cv=0.3), values, atol=1e-6)
    # No flux crosses the border: light is only moved.
    assert run("srad", image, iterations=50).mean() == pytest.approx(image.mean(), rel=1e-4)


@settings(max_examples=10, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(9, 50),
    width=st.integers(9, 50),
    levels=st.integers(1, 4),
)
def test_the_wavelet_gives_back_what_it_got(
    seed: int, height: int, width: int, levels: int
) -> None:
    image = np.random.default_rng(seed).random((height, width), dtype=np.float32)
    same = run("wavelet", image, strength=0.0, levels=levels)
    np.testing.assert_allclose(same, image, atol=1e-5)


@settings(max_examples=20, deadline=None)
@given(gain=st.floats(0.2, 3), offset=st.floats(-0.4, 0.4), seed=st.integers(0, 2**32 - 1))
def test_levels_are_the_straight_line_fit(gain: float, offset: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pairs = [(rng.random((7, 9)), rng.random((7, 9))) for _ in range(3)]
    slope, start = np.polyfit(
        np.concatenate([a.ravel() for a, _ in pairs]),
        np.concatenate([b.ravel() for _, b in pairs]),
        1,
    )
    fitted = fit_levels(pairs)
    assert (fitted.gain, fitted.offset) == pytest.approx((slope, start), abs=1e-9)
    exact = fit_levels((a, gain * a + offset) for a, _ in pairs)
    assert (exact.gain, exact.offset) == pytest.approx((gain, offset), abs=1e-9)
    result = exact(pairs[0][0])
    assert 0 <= result.min() <= result.max() <= 1
    flat = fit_levels([(np.full((3, 3), 0.2), np.full((3, 3), 0.7))])
    assert flat.gain == 0
    assert flat.offset == pytest.approx(0.7)


def test_registry_is_well_formed() -> None:
    for name, baseline in REGISTRY.items():
        assert name == baseline.name
        assert baseline.source
        for axis in baseline.grid.values():
            assert list(axis) == sorted(set(axis))
        for parameter in baseline.grid:
            assert parameter in baseline.default
    assert [b.name for b in chosen(["nlm", "median", "nlm"])] == ["nlm", "median"]
    assert [b.name for b in chosen(["all"])] == list(NAMES)
    with pytest.raises(FactoryError, match=r"no 'wiener'; choose of identity, median"):
        chosen(["wiener"])


def test_a_wrong_method_is_caught() -> None:
    def nothing(image: Array) -> Array:
        return image * math.nan

    def halved(image: Array) -> Array:
        return image[::2]

    with pytest.raises(FactoryError, match=r"or NaN"):
        Baseline("nothing", nothing, {}, {}, "here")(np.ones((3, 3)), {})
    with pytest.raises(FactoryError, match=r"gave \(2, 3\)"):
        Baseline("halved", halved, {}, {}, "here")(np.ones((3, 3)), {})
