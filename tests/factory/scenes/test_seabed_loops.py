"""Compiled loops and meshes of the procedural seabed against the same steps in plain numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

from simnfnd.factory.scenes.seabed import terrain
from simnfnd.factory.scenes.seabed.fields import Floats, tiles
from simnfnd.factory.scenes.seabed.view import least_around, measured
from simnfnd.factory.seeds import stream


def between(tile: npt.NDArray[Any], u: Floats, v: Floats, period_m: float) -> Floats:
    """(N,) or (N, C) values of a periodic tile between its pixels."""
    side = tile.shape[0]
    where = []
    for axis_m in (u, v):
        turns = axis_m * np.float32(1 / period_m)
        where.append((turns - np.floor(turns)) * np.float32(side))
    (x, y), (left, top) = where, (part.astype(np.int64) for part in where)
    right, down = (part.reshape(-1, *[1] * (tile.ndim - 2)) for part in (x - left, y - top))
    left, top, beside, below = (k % side for k in (left, top, left + 1, top + 1))
    upper = tile[top, left] * (1 - right) + tile[top, beside] * right
    lower = tile[below, left] * (1 - right) + tile[below, beside] * right
    return np.asarray(upper * (1 - down) + lower * down, np.float32)


@pytest.mark.parametrize("reach", [1, 2, 4, 6])
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


def test_relief_is_that_of_numpy() -> None:
    from simnfnd.factory.scenes.seabed.kernels import relieve

    rng = np.random.default_rng(6)
    flat = rng.uniform(-9, 9, (12, 17, 3)).astype(np.float32)
    normals = rng.normal(0, 1, flat.shape).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    rock = np.clip(rng.normal(0.5, 0.6, flat.shape[:2]), 0, 1).astype(np.float32)
    gravel, crest = rng.random((2, *rock.shape), dtype=np.float32)
    gravel[:, ::3] = 0
    points, attributes, noise = flat.copy(), np.empty_like(flat), tiles()
    offset, metres = np.array([3, 4], np.float32), np.array([0.1, 0.01, 0.03], np.float32)
    relieve(
        points, normals, (rock, gravel, crest), (noise.rock, noise.sand), offset, metres, attributes
    )
    x, y, z = flat.reshape(-1, 3).T
    shares = (normals.reshape(-1, 3) ** 4).T / (normals.reshape(-1, 3) ** 4).sum(axis=1)

    def wrapped(period_m: float) -> Any:
        sides = ((y + 3, z + 4), (x + 3, z + 4), (x + 3, y + 4))
        return sum(
            share * between(noise.rock, *side, period_m)
            for share, side in zip(shares, sides, strict=True)
        ).reshape(rock.shape)

    stone = wrapped(9.1) + 0.35 * wrapped(2.3)
    sand = between(noise.sand, x + 3, y + 4, 6.7).reshape(rock.shape)
    pebbles = between(noise.rock, x + 3, y + 4, 1.7).reshape(rock.shape)
    relief = 0.1 * rock * stone + 0.01 * (1 - rock) * sand + 0.011 * gravel * pebbles + 0.03 * crest
    np.testing.assert_allclose(points, flat + normals * relief[..., None], atol=1e-4)
    tone = rock * stone + (1 - rock) * (0.4 * sand + 0.8 * crest + 0.5 * gravel * pebbles)
    np.testing.assert_allclose(attributes, np.dstack([rock, gravel, tone]), atol=1e-2)
