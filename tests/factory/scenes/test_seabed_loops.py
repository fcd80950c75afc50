"""Compiled loops and meshes of the procedural seabed against the same steps in plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from simnfnd.factory.scenes.seabed import terrain
from simnfnd.factory.scenes.seabed.view import least_around, measured
from simnfnd.factory.seeds import stream


@pytest.mark.parametrize("reach", [1, 4])
def test_least_around_is_that_of_scipy(reach: int) -> None:
    values = np.random.default_rng(reach).random((31, 47), dtype=np.float32)
    expected = ndimage.minimum_filter(values, 2 * reach + 1, mode="constant", cval=np.inf)
    np.testing.assert_array_equal(least_around(values, reach), expected)


def test_depth_is_lost_far_away_and_behind_edges_in_the_share_drawn() -> None:
    depth_m = np.full((608, 968), 3.0, np.float32)
    depth_m[:, 500:] = 4.5
    depth_m[:60] = np.inf
    keep = measured(stream(1, "gaps"), depth_m, depth_m, 5.0)
    assert not keep[:60].any()
    assert 0.6 < keep.mean() < 0.93
    behind, before = keep[200:400, 500:504].mean(), keep[200:400, 496:500].mean()
    assert behind < 0.6 < before
    assert not measured(stream(1, "gaps"), depth_m, depth_m, 1.0).any()


def test_normals_of_a_grid_are_those_of_numpy() -> None:
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(20.0), np.arange(30.0), indexing="ij")
    points = np.dstack([x, y, rng.normal(0, 0.4, x.shape)]).astype(np.float32)
    down, right = (np.gradient(points.astype(np.float64), axis=axis) for axis in (0, 1))
    expected = np.cross(right, down)
    expected *= np.where(expected[..., 2:] < 0, -1, 1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    np.testing.assert_allclose(terrain.grid_normals(points), expected, atol=1e-5)
