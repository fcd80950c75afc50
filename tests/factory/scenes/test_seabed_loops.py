"""The compiled passes of the procedural seabed against the same steps in plain numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy import ndimage

from simnfnd.factory.frame import FrameRef
from simnfnd.factory.scenes.seabed import SeabedReader, SeabedSettings, photo, terrain
from simnfnd.factory.scenes.seabed.depth_dropout import _ellipse, measured
from simnfnd.factory.scenes.seabed.fields import Floats, tiles
from simnfnd.factory.scenes.seabed.objects.meshes import tube
from simnfnd.factory.scenes.seabed.photo import Scene
from simnfnd.factory.scenes.seabed.rasterizer import Hits, Objects
from simnfnd.factory.seeds import stream
from tests.seabed_in_numpy import between, channels, plain_colour


@pytest.mark.parametrize("location", [0, 6, 8])
def test_colours_light_and_water_are_those_of_numpy(
    location: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pixel at the edge of a tile's pixel may fall on the other side in double precision."""
    from simnfnd.factory.scenes.seabed.loops import colour_loops

    kept: dict[str, Any] = {}
    light, paint = photo._light, colour_loops.photograph

    def lit(scene: Scene, hits: Hits) -> tuple[Floats, Floats]:
        made = light(scene, hits)
        kept.update(scene=scene, hits=hits, light=made)
        return made

    def painted(*arguments: Any) -> None:
        paint(*arguments)
        kept["colour"] = arguments[-1].copy()

    monkeypatch.setattr(photo, "_light", lit)
    monkeypatch.setattr(colour_loops, "photograph", painted)
    reader = SeabedReader(SeabedSettings(width=243, height=151))
    reader.load(FrameRef("seabed", f"seabed-{location:04d}", "0001"))
    expected = plain_colour(kept["scene"], kept["hits"], *kept["light"])
    error = np.abs(kept["colour"] - expected).max(axis=-1)
    assert expected.std() > 0.01
    assert np.median(error) < 1e-5
    assert (error > 1e-3).mean() < 0.01


@pytest.mark.parametrize("size", [3, 5, 9, 13])
def test_least_around_is_that_of_scipy(size: int) -> None:
    from simnfnd.factory.scenes.seabed.loops.picture_loops import least_around

    values = np.random.default_rng(size).random((31, 47), dtype=np.float32)
    least = np.empty_like(values)
    least_around(values, _ellipse(size), least)
    stencil = np.zeros((size, size), np.bool_)
    for row, half in _ellipse(size):
        stencil[row + size // 2, size // 2 - half : size // 2 + half + 1] = True
    expected = ndimage.minimum_filter(values, footprint=stencil, mode="constant", cval=np.inf)
    np.testing.assert_array_equal(least, expected)


def test_ranked_is_that_of_sorting() -> None:
    from simnfnd.factory.scenes.seabed.loops.picture_loops import ranked

    rng = np.random.default_rng(0)
    values = np.round(rng.normal(0, 3, (40, 50)), 2).astype(np.float32)  # of both signs, some equal
    among = rng.random(values.shape) < 0.6
    ordered = np.sort(values[among])
    for rank in (0, 1, 300, len(ordered) - 1):
        assert ranked(values, among, rank) == ordered[rank]


def test_what_is_measured_is_what_numpy_says(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    depth_m = ndimage.gaussian_filter(rng.uniform(0, 40, (152, 242)), 6).astype(np.float32) - 17
    depth_m[40:80, 60:120] = 1.5
    depth_m[:20] = np.inf
    range_m, clear_m = depth_m * np.float32(1.1), 5.0
    keep = measured(stream(1, "gaps"), depth_m, range_m, clear_m)
    again = stream(1, "gaps")
    shift = again.uniform(0, 1000, 2).astype(np.float32)
    y, x = np.indices(depth_m.shape, dtype=np.float32) * np.float32(968 / 242)
    texture = channels(tiles().texture)[..., :2]
    noise = between(texture, (x + shift[0]).ravel(), (y + shift[1]).ravel(), 1000)
    broad, grain = np.moveaxis(noise.reshape(*depth_m.shape, 2), -1, 0)
    finite = np.minimum(depth_m, 1e4)
    least = [
        ndimage.minimum_filter(
            finite, footprint=np.array(shape, bool), mode="constant", cval=np.inf
        )
        for shape in (_ellipse_mask(max(round(9 * 242 / 968), 3) | 1), _ellipse_mask(3))
    ]
    edges = (finite > least[0] * 1.12) & (broad + grain > 0.6)
    edges |= (finite > least[1] * 1.12) & (broad + grain > -0.7)
    near = (range_m < clear_m * (1 + 0.06 * broad + 0.03 * grain)) & ~edges
    missing = 0.08 + 0.3 * again.random() ** 2 - (1 - near.mean())
    border = np.maximum(abs(x / 968 * 2 - 1), abs(y / 608 * 2 - 1)) ** 8
    doubt = 0.3 * broad + 0.1 * grain + 0.9 * border + 2.4 * np.minimum(range_m / clear_m, 1)
    count = max(round(missing * near.size), 0)
    limit = np.sort(doubt[near])[near.sum() - count] if count else np.inf
    expected = near & (doubt < limit)
    assert 0.1 < expected.mean() < 0.9
    assert (keep == expected).mean() > 0.999


def _ellipse_mask(size: int) -> npt.NDArray[np.bool_]:
    mask = np.zeros((size, size), np.bool_)
    for row, half in _ellipse(size):
        mask[row + size // 2, size // 2 - half : size // 2 + half + 1] = True
    return mask


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
    from simnfnd.factory.scenes.seabed.loops.ground_loops import relieve

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
        points, normals, rock, gravel, crest, noise.rock, noise.sand, offset, metres, attributes
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


@pytest.mark.parametrize("location", [1, 4])
def test_light_is_that_of_sun_maps_of_everything(
    location: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Leaving out what throws its shadow on nothing that is seen changes no pixel."""
    kept: list[Any] = []
    light, parts = photo._light, Objects.parts
    counts: list[int] = []

    def both(scene: Scene, hits: Hits) -> tuple[Floats, Floats]:
        monkeypatch.setattr(Objects, "parts", lambda self, wanted: counted(self, wanted))
        first = light(scene, hits)
        monkeypatch.setattr(photo, "_over", lambda balls, *rest: np.ones(len(balls), np.bool_))
        kept.extend((first, light(scene, hits)))
        return first

    def counted(objects: Objects, wanted: npt.NDArray[np.bool_]) -> Any:
        counts.append(int(wanted.sum()))
        return parts(objects, wanted)

    monkeypatch.setattr(photo, "_light", both)
    SeabedReader(SeabedSettings(width=242, height=152)).load(
        FrameRef("seabed", f"seabed-{location:04d}", "0001")
    )
    for one, other in zip(*kept, strict=True):
        np.testing.assert_array_equal(one, other)
    assert sum(counts[:2]) < sum(counts[2:]) / 2


@pytest.mark.parametrize("closed", [False, True])
def test_tubes_are_those_of_numpy(closed: bool) -> None:
    rng = np.random.default_rng(8)
    path, radii = rng.normal(0, 1, (7, 3)).cumsum(axis=0), rng.uniform(0.1, 0.3, 7)
    colours = rng.random((7, 3), dtype=np.float32)
    shape = tube(path, radii, 5, closed=closed, colour=colours)
    points = path
    if closed:
        tangents = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    else:
        ends = [0, 0, *range(7), -1, -1]
        tangents = np.gradient(path, axis=0)[ends]
        points, radii, colours = points[ends], radii[ends], colours[ends]
        radii[[0, -1]] = 0
    rings = shape.vertices.reshape(-1, 5, 3)
    away = rings - points[:, None]
    np.testing.assert_allclose(
        np.linalg.norm(away, axis=2), radii[:, None] + 0 * away[..., 0], atol=1e-5
    )
    across = np.einsum("rsi,ri->rs", away, tangents)
    np.testing.assert_allclose(across, 0, atol=1e-5)
    np.testing.assert_array_equal(shape.colours.reshape(-1, 5, 3), np.stack([colours] * 5, axis=1))
    # Neighbours on a ring are a fifth of a turn apart.
    step = np.linalg.norm(np.roll(rings, -1, axis=1) - rings, axis=2)
    expected = 2 * np.sin(np.pi / 5) * radii[:, None]
    np.testing.assert_allclose(step, np.broadcast_to(expected, step.shape), atol=1e-5)
