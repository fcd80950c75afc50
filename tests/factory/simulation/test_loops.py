"""Every compiled loop against the plain numpy or scipy version of the same step."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

from simnfnd.factory.common import seeds
from simnfnd.factory.common.array_types import Bools, Float32s
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.fan_geometry import pixel_size
from simnfnd.factory.simulation.sonar import polar
from simnfnd.factory.simulation.sonar.fan import fan_table
from simnfnd.factory.simulation.sonar.polar import Echoes
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from simnfnd.factory.simulation.sonar.window import Window
from tests.clouds import camera_scene, chosen, window
from tests.project_files import ROOT


def sonar(**keys: Any) -> SonarSettings:
    return build(SonarSettings, keys)


SONARS = {
    "default": sonar(),
    "top view": sonar(projection="top_view", tvg_db_per_decade=20),
    "elsewhere": sonar(
        mount={"translation_m": [0.1, -0.2, 0.3], "pitch_deg": 7, "yaw_deg": -11},
        tvg_db_per_decade=33,
    ),
    "tabled": sonar(beams=5, beam_azimuths_deg=[-15, -8, 0, 3, 16], tvg_db_per_decade=0),
    "narrow": sonar(hfov_deg=20, vfov_deg=8, range={"min_m": 2, "max_m": 6}),
}


def plain_bins(echoes: Echoes, at: Window, device: SonarSettings) -> npt.NDArray[np.intp]:
    half = np.float32(np.deg2rad(device.hfov_deg) / 2)
    fraction = (echoes.range_in(at) - at.range_min_m) / at.range_span_m
    row = np.floor(fraction * np.float32(device.range_bins)).astype(np.intp)
    scale = np.float32(device.beams / (2 * half))
    beam = np.floor((echoes.azimuth_rad + half) * scale).astype(np.intp)
    inside = (row >= 0) & (row < device.range_bins) & (beam >= 0) & (beam < device.beams)
    if device.beam_azimuths_deg is not None:
        centres = device.beam_centres_rad()
        edges = ((centres[1:] + centres[:-1]) / 2).astype(np.float32)
        beam = np.searchsorted(edges, echoes.azimuth_rad, side="right")
    return np.where(inside, row * device.beams + beam, device.range_bins * device.beams)


@pytest.mark.parametrize("accumulate", ["sum", "mean", "max"])
def test_accumulation_is_that_of_numpy_and_parts_need_not_be_joined(accumulate: str) -> None:
    device = sonar(accumulate=accumulate)
    at = window()
    scene = camera_scene(50_000)
    rng = np.random.default_rng(3)
    scene = replace(scene, strength=rng.random(50_000, dtype=np.float32))
    bins = plain_bins(scene, at, device)
    size = device.range_bins * device.beams
    total: Any = np.bincount(bins, weights=scene.strength, minlength=size + 1)[:size]
    if accumulate == "mean":
        total /= np.maximum(np.bincount(bins, minlength=size + 1)[:size], 1)
    elif accumulate == "max":
        total[:] = 0
        np.maximum.at(total, bins[bins < size], scene.strength[bins < size])
    level = polar.accumulate(scene, at, device)
    np.testing.assert_allclose(level.ravel(), total, rtol=1e-5)
    halves = [chosen(scene, np.arange(50_000) % 3 == part) for part in range(3)]
    columns = zip(*(vars(half).values() for half in halves), strict=True)
    joined = Echoes(*map(np.concatenate, columns))
    np.testing.assert_array_equal(
        polar.accumulate(halves[0], at, device, *halves[1:]),
        polar.accumulate(joined, at, device),
    )


@settings(max_examples=30, deadline=None)
@given(
    level=arrays(
        np.float32,
        array_shapes(min_dims=2, max_dims=2, max_side=12),
        elements=st.floats(0, 100, width=32),
    ),
    range_bins=st.sampled_from([0, 0.3, 0.7, 2.5]),
    beams=st.sampled_from([0, 0.5, 1.2]),
)
def test_blur_is_that_of_scipy(level: Float32s, range_bins: float, beams: float) -> None:
    device = sonar(point_spread={"range_bins": range_bins, "beams": beams})
    expected = ndimage.gaussian_filter(
        level.astype(np.float64), (range_bins, beams), mode="constant", truncate=3.0
    )
    np.testing.assert_allclose(polar.spread_points(level, device), expected, rtol=1e-5, atol=1e-5)


@settings(max_examples=30, deadline=None)
@given(hit=arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=14)))
def test_closing_is_that_of_scipy(hit: Bools) -> None:
    grid = ndimage.binary_closing(np.pad(hit, 9), structure=np.ones((5, 3), np.bool_))
    np.testing.assert_array_equal(polar.covered(hit), grid[9:-9, 9:-9])


def test_fan_is_bilinear_and_nearest_as_scipy_interpolates() -> None:
    device = sonar(beams=40, range_bins=60, hfov_deg=90)
    table = fan_table(device, 0.25)
    rng = np.random.default_rng(0)
    level = rng.random((60, 40), dtype=np.float32)
    rows = device.image.height_px
    columns = device.image.width_px
    pixel = pixel_size(device, 0.25)
    ahead = 1 - (np.arange(rows)[:, None] + 0.5) * pixel
    right = (np.arange(columns)[None] + 0.5 - columns / 2) * pixel
    row = (np.hypot(ahead, right) - 0.25) / 0.75 * 60 - 0.5
    beam = (np.arctan2(right, ahead) + np.deg2rad(45)) / np.deg2rad(90) * 40 - 0.5
    places = [row[table.inside], beam[table.inside]]
    expected = ndimage.map_coordinates(level, places, order=1, mode="nearest")
    np.testing.assert_allclose(table.bilinear(level)[table.inside], expected, atol=2e-5)
    assert not table.bilinear(level)[~table.inside].any()
    near = table.nearest(level, np.nan)
    expected = ndimage.map_coordinates(level, places, order=0, mode="nearest")
    assert np.mean(near[table.inside] != expected) < 1e-3  # half way between two
    assert np.isnan(near[~table.inside]).all()
    mask = table.nearest(level > 0.5)
    assert mask.dtype == np.bool_
    assert not mask[~table.inside].any()


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**200), names=st.lists(st.text(max_size=4) | st.integers(), max_size=3))
def test_streams_are_those_of_numpys_seed_sequence(seed: int, names: list[str | int]) -> None:
    plain = np.random.SeedSequence(seed, spawn_key=seeds.spawn_key(*names))
    expected = np.random.Generator(np.random.PCG64(plain)).integers(2**62, size=3)
    np.testing.assert_array_equal(seeds.stream(seed, *names).integers(2**62, size=3), expected)


def test_every_module_of_loops_is_compiled_before_workers_start() -> None:
    """A module that `loops` forgets would be compiled by every worker at once."""
    from simnfnd.factory.simulation.pairs.compilation import LOOPS

    using = {
        ".".join(("simnfnd", *path.relative_to(ROOT).with_suffix("").parts))
        for path in (ROOT / "factory").rglob("*.py")
        if "\n@compiled(" in path.read_text(encoding="utf-8")
    }
    assert using == set(LOOPS)
    for name in LOOPS:
        importlib.import_module(name)
