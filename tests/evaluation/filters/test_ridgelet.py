"""Finite ridgelets: a Radon transform that is undone exactly, and lines that survive."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.evaluation.filters.base import BaselineError
from simnfnd.evaluation.filters.literature.ridgelet import (
    finite_radon,
    inverse_finite_radon,
)
from tests.evaluation.filters.scenes import run, scene

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
