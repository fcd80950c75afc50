"""The classical methods against slow computations and against what they promise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from simnfnd.evaluation.filters import REGISTRY, Baseline
from simnfnd.evaluation.filters.rivals import lpmsde
from simnfnd.evaluation.metrics.fidelity import psnr
from simnfnd.factory.common.array_types import Array
from simnfnd.factory.common.errors import FactoryError

NAMES = tuple(REGISTRY)


def scene(size: int = 96) -> Array:
    """Ground of two brightnesses with a bright block and a shadow, 0..1."""
    image = np.full((size, size), 0.4, np.float32)
    image[:, size // 2 :] = 0.65
    image[size // 4 : size // 2, size // 8 : size // 3] = 0.9
    image[size // 2 : -4, size // 8 : size // 3] = 0
    return image


def noisy_scene(kind: str, size: int = 96, seed: int = 0) -> Array:
    rng = np.random.default_rng(seed)
    clean = scene(size)
    if kind == "white":
        noisy = clean + rng.normal(0, 0.1, clean.shape)
    else:
        noisy = clean * rng.gamma(12, 1 / 12, clean.shape)
    return np.asarray(np.clip(noisy, 0, 1), dtype=np.float32)


def run(name: str, image: Array, **parameters: float) -> Array:
    baseline = REGISTRY[name]
    return baseline(image, {**baseline.default, **parameters})


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gives_an_image_for_every_image(name: str) -> None:
    rng = np.random.default_rng(1)
    size = (12, 17)
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
    clean = scene()
    noisy = noisy_scene(kind)
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


def test_bm3d_is_ahead_on_white_noise() -> None:
    """Where it is made for, block matching beats simpler filters at their best."""
    y, x = np.mgrid[0:64, 0:64]
    clean = (0.5 + 0.2 * np.sin(x / 2.2) * (y > 32) + 0.2 * (x > y)).astype(np.float32)
    noise = np.random.default_rng(2).normal(0, 0.1, clean.shape)
    noisy = np.clip(clean + noise, 0, 1).astype(np.float32)
    gaussian, nlm, tv = (
        max(psnr(clean, REGISTRY[name](noisy, p), data_range=1) for p in REGISTRY[name].points())
        for name in ("gaussian", "nlm", "tv")
    )
    assert psnr(clean, run("bm3d", noisy, sigma=0.1), data_range=1) > max(gaussian, nlm, tv) + 2


def test_median_and_opening_are_the_definition() -> None:
    """The median of stored images, which is taken on bytes, is that of any other."""
    stored = np.random.default_rng(3).integers(0, 256, (40, 33)).astype(np.float32)
    stored /= np.float32(255)
    for image in (stored, np.nextafter(stored, np.float32(0.5))):
        for size in (2, 3, 5, 9):
            expected = ndimage.median_filter(image, size=size, mode="nearest")
            np.testing.assert_array_equal(run("median", image, size=size), expected)
        darkest = sliding_window_view(image, (3, 3)).min(axis=(2, 3))
        opened = sliding_window_view(darkest, (3, 3)).max(axis=(2, 3))
        actual = run("grey_opening", image, size=3)
        np.testing.assert_array_equal(actual[2:-2, 2:-2], opened)


def test_lee_kuan_and_frost_are_their_formulas() -> None:
    image = noisy_scene("speckle", 40)
    cu2 = 0.1**2
    y, x = np.mgrid[-3:4, -3:4]
    actual = [run(name, image, size=7, noise_cv=0.1) for name in ("lee", "kuan")]
    actual.append(run("frost", image, size=7, damping=2))
    for row, column in ((20, 20), (9, 30), (12, 4)):
        window = image[row - 3 : row + 4, column - 3 : column + 4].astype(float)
        mean = window.mean()
        ci2 = window.var() / window.mean() ** 2
        part = max(1 - cu2 / ci2, 0) * (float(image[row, column]) - mean)
        weights = np.exp(-2 * ci2 * np.hypot(x, y))
        frost = (weights * window).sum() / weights.sum()
        expected = (mean + part, mean + part / (1 + cu2), frost)
        assert [image[row, column] for image in actual] == pytest.approx(expected, abs=1e-6)


def test_srad_is_the_formula_step_by_step() -> None:
    """Yu and Acton 2002, in whole arrays; conductances are those of a cell and of the next one."""
    image = np.clip(noisy_scene("speckle", 12), 0.05, 0.7)
    values = image.astype(float)
    for number in range(3):
        q0 = (0.3 * math.exp(-number * 0.2 / 6)) ** 2
        edged = np.pad(values, 1, mode="edge")
        down = edged[2:, 1:-1] - values
        up = edged[:-2, 1:-1] - values
        right = edged[1:-1, 2:] - values
        left = edged[1:-1, :-2] - values
        gradient = (down**2 + up**2 + right**2 + left**2) / values**2
        laplace = (down + up + right + left) / values
        q2 = np.maximum(gradient / 2 - laplace**2 / 16, 0) / (1 + laplace / 4) ** 2
        conduct = 1 / (1 + np.maximum((q2 - q0) / (q0 * (1 + q0)), 0))
        after = np.pad(conduct, 1, mode="edge")
        flow = after[2:, 1:-1] * down + after[1:-1, 2:] * right + conduct * (up + left)
        values = values + 0.2 / 4 * flow
    np.testing.assert_allclose(run("srad", image, iterations=3, initial_cv=0.3), values, atol=1e-6)
    # No flux crosses the border: light is only moved.
    assert run("srad", image, iterations=50).mean() == pytest.approx(image.mean(), rel=1e-4)


@pytest.mark.parametrize(("size", "levels"), [((9, 50), 1), ((33, 47), 4), ((17, 16), 3)])
def test_the_wavelet_gives_back_what_it_got(size: tuple[int, int], levels: int) -> None:
    image = np.random.default_rng(0).random(size, dtype=np.float32)
    same = run("wavelet", image, strength=0.0, levels=levels)
    np.testing.assert_allclose(same, image, atol=1e-5)


def test_a_pyramid_without_noise_gives_back_the_image() -> None:
    image = np.random.default_rng(0).random((32, 48), dtype=np.float32)
    np.testing.assert_allclose(lpmsde.lpmsde(image, 0.0, 3), image, atol=1e-5)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [(lambda image: image * math.nan, "or NaN"), (lambda image: image[::2], r"gave \(2, 3\)")],
)
def test_a_wrong_method_is_caught(wrong: Any, said: str) -> None:
    with pytest.raises(FactoryError, match=said):
        Baseline("wrong", wrong, {}, {}, "here")(np.ones((3, 3)), {})
