"""Finite ridgelets: a Radon transform that is undone exactly, and lines that survive."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.filters.base import BaselineError
from simnfnd.evaluation.filters.literature.ridgelet import (
    _lines,
    basis,
    finite_radon,
    inverse_finite_radon,
)
from simnfnd.evaluation.metrics.fidelity import psnr
from tests.evaluation.filters.scenes import noisy_scene, run, scene

Array = npt.NDArray[Any]
PRIMES = (3, 5, 7, 11, 17, 31)


@pytest.mark.parametrize("side", PRIMES)
def test_the_finite_radon_transform_is_undone_exactly(side: int) -> None:
    block = np.random.default_rng(side).normal(size=(side, side))
    projections = finite_radon(block)
    assert projections.shape == (side + 1, side)
    np.testing.assert_allclose(inverse_finite_radon(projections), block, atol=1e-12)
    # Each direction sees every pixel once.
    np.testing.assert_allclose(projections.sum(axis=1), block.sum() / np.sqrt(side), atol=1e-10)


def test_every_line_has_as_many_pixels_and_two_pixels_share_one() -> None:
    side, pixels = 7, []
    for i in range(side):
        for j in range(side):
            one = np.zeros((side, side))
            one[i, j] = np.sqrt(side)
            pixels.append(finite_radon(one).ravel())
    crossed = np.stack(pixels) @ np.stack(pixels).T
    expected = np.full_like(crossed, 1) + side * np.eye(side**2)
    np.testing.assert_allclose(crossed, expected, atol=1e-12)
    np.testing.assert_allclose(np.stack(pixels).sum(axis=0), side)


@pytest.mark.parametrize("side", PRIMES)
def test_neighbouring_lines_are_neighbours_in_the_block(side: int) -> None:
    """The order of Do and Vetterli: by the shortest normal, which is at most sqrt(2 / sqrt(3) p)
    pixels long, as in any lattice of one point in p (Hermite)."""
    seen = set()
    for lines in _lines(side):
        down, right = lines[1, 0] - lines[0, 0], lines[0, 1] - lines[0, 0]
        normal = [(step + side // 2) % side - side // 2 for step in (down, right)]
        assert 0 < normal[0] ** 2 + normal[1] ** 2 <= 2 / np.sqrt(3) * side
        seen.add(tuple(sorted(tuple(m * step % side for step in normal) for m in range(1, side))))
    assert len(seen) == side + 1


@pytest.mark.parametrize("side", PRIMES)
def test_ridgelets_are_orthonormal_and_a_line_is_few_of_them(side: int) -> None:
    ridgelets, scales = basis(side)
    np.testing.assert_allclose(ridgelets @ ridgelets.T, np.eye(side**2), atol=1e-5)
    assert [part.start for part in scales[1:]] == [part.stop for part in scales[:-1]]
    assert (scales[0].start, scales[-1].stop) == (1, side**2)
    i, j = np.mgrid[0:side, 0:side]
    line = ((i + 2 * j) % side == 1).astype(float)
    assert (np.abs(ridgelets @ line.ravel()) > 1e-4).sum() <= 1 + len(scales)


@pytest.mark.parametrize("block_px", [9, 2, 1, 15])
def test_blocks_that_are_no_odd_prime_are_refused(block_px: int) -> None:
    with pytest.raises(
        BaselineError, match=rf"block_px {block_px} is no odd prime; take 7"
    ) as told:
        run("ridgelet", scene(), block_px=block_px)
    assert "\n" not in str(told.value)
    with pytest.raises(BaselineError, match=r"a block is square, not \(5, 7\)"):
        finite_radon(np.zeros((5, 7)))


@pytest.mark.parametrize(("shape", "block_px"), [((61, 47), 5), ((40, 53), 11), ((9, 70), 31)])
def test_without_thresholds_the_picture_comes_back(shape: tuple[int, int], block_px: int) -> None:
    image = np.random.default_rng(0).random(shape, dtype=np.float32)
    same = run("ridgelet", image, strength=0.0, block_px=block_px)
    np.testing.assert_allclose(same, image, atol=0.005)


def gain(name: str, clean: Array, noisy: Array) -> float:
    """Of the best point of the grid, dB."""
    best = max(psnr(clean, REGISTRY[name](noisy, p), data_range=1) for p in REGISTRY[name].points())
    return best - psnr(clean, noisy, data_range=1)


def test_edges_under_speckle_are_what_it_is_for() -> None:
    """Slanted edges and lines: ahead of Haar wavelets, each at its best."""
    y, x = np.mgrid[0:90, 0:121]
    clean = np.where(x > 0.4 * y + 30, 0.55, 0.25).astype(np.float32)
    clean[np.abs(y - 0.5 * x - 10) < 1.5] = 0.8
    speckle = np.random.default_rng(4).gamma(12, 1 / 12, clean.shape)
    noisy = np.clip(clean * speckle, 0, 1).astype(np.float32)
    assert gain("ridgelet", clean, noisy) > max(10, gain("wavelet", clean, noisy) + 1)


def test_the_mean_stays_and_black_stays_black() -> None:
    noisy = noisy_scene("speckle", 61)
    smooth = run("ridgelet", noisy)
    assert smooth.mean() == pytest.approx(noisy.mean(), rel=1e-2)
    even = np.s_[4:12, 4:28]
    assert smooth[even].std() < 0.3 * noisy[even].std()
    half = noisy.copy()
    half[:, :40] = 0
    assert not run("ridgelet", half)[:, :20].any()
