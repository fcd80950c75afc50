"""Finite ridgelets: an orthonormal basis of lines."""

from __future__ import annotations

import numpy as np
import pytest

from simnfnd.evaluation.filters.base import BaselineError
from simnfnd.evaluation.filters.literature.ridgelet import basis
from tests.evaluation.filters.scenes import run, scene

PRIMES = (3, 5, 7, 11, 17, 31)


@pytest.mark.parametrize("side", PRIMES)
def test_ridgelets_are_orthonormal_and_lie_along_lines(side: int) -> None:
    ridgelets, scales = basis(side)
    assert ridgelets.shape == (side * side, side * side)
    np.testing.assert_allclose(ridgelets @ ridgelets.T, np.eye(side * side), atol=1e-5)
    assert (scales[0].start, scales[-1].stop) == (1, side * side)
    # Each is constant along the lines of one direction: one row of the block has all its values.
    for ridge in ridgelets[1 : 2 + side].reshape(-1, side, side):
        assert len(np.unique(ridge.round(5))) == 2


@pytest.mark.parametrize("block_px", [9, 2, 1, 15])
def test_blocks_that_are_no_odd_prime_are_refused(block_px: int) -> None:
    with pytest.raises(BaselineError, match=rf"block_px {block_px} is no odd prime; take 7"):
        run("ridgelet", scene(), block_px=block_px)


@pytest.mark.parametrize(("shape", "block_px"), [((61, 47), 5), ((40, 53), 11), ((9, 70), 31)])
def test_without_thresholds_the_picture_comes_back(shape: tuple[int, int], block_px: int) -> None:
    image = np.random.default_rng(0).random(shape, dtype=np.float32)
    same = run("ridgelet", image, strength=0.0, block_px=block_px)
    np.testing.assert_allclose(same, image, atol=0.005)
