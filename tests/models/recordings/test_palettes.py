"""Colours of sonar displays: the levels that a colour map painted, and the way back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.common.array_types import Array
from simnfnd.models.recordings.palettes import SUM, find_painted, grey_of_colours
from tests.models.recordings.fan_images import LEFT, TOP, fan, preset, screen, with_rings

KNOWN = ("JET", "TURBO", "RAINBOW", "VIRIDIS", "HOT", "OCEAN", "BONE", "PARULA", "INFERNO")


def ramp_of(*corners: tuple[float, float, float]) -> Array:
    """(256, 1, 3) colours, straight from corner to corner, which lie at 0, 0.8 and 1."""
    at = [0, 0.8, 1]
    steps = np.linspace(0, 1, 256)
    channels = [np.interp(steps, at, [corner[k] for corner in corners]) for k in range(3)]
    ramp = np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
    return np.asarray(ramp[:, None], np.uint8)


COPPER = ramp_of(*(tuple(np.minimum(255, t * np.array([127, 199, 319]))) for t in (0, 0.8, 1)))
BRONZE = ramp_of((0, 0, 0), (20, 110, 220), (200, 255, 255))


def echoes(seed: int = 0) -> Array:
    """Levels as of a sonar: a dim ground with grain, bright things, and nothing at the sides."""
    rng = np.random.default_rng(seed)
    level = 70 + 50 * np.sin(np.linspace(0, 6, 160))[:, None] + rng.normal(0, 16, (160, 120))
    level[60:80, 40:70] = 240 + rng.normal(0, 8, (20, 30))
    level[:, :10] = level[:, -10:] = 0
    return np.asarray(np.clip(level, 0, 255), np.uint8)


def painted(levels: Array, name: str) -> Array:
    return np.asarray(cv2.applyColorMap(levels, getattr(cv2, f"COLORMAP_{name}")), np.uint8)


@pytest.mark.parametrize("name", KNOWN)
@pytest.mark.parametrize("order", [1, -1])
def test_levels_of_known_maps(name: str, order: int) -> None:
    levels = echoes()
    colours = painted(levels, name)[..., ::order]
    actual = find_painted(colours)
    assert actual is not None
    assert actual.palette.name == name.lower()
    assert actual.known.all()
    # Neighbouring levels of some maps have one colour.
    assert np.abs(actual.levels * 255 - levels).max() <= 3
    brighter = np.clip(actual.levels + 0.1, 0, 1)
    wanted = painted(np.rint(brighter * 255).astype(np.uint8), name)[..., ::order]
    assert np.abs(actual.repainted(brighter).astype(int) - wanted)[:, 10:-10].max() <= 12


@pytest.mark.parametrize("ramp", [COPPER, BRONZE], ids=["copper", "bronze"])
def test_levels_of_an_unknown_map(ramp: Array) -> None:
    levels = echoes()
    actual = find_painted(cv2.applyColorMap(levels, ramp))
    assert actual is not None
    assert actual.palette.name == SUM
    order = np.argsort(levels, axis=None, kind="stable")
    assert np.diff(actual.levels.ravel()[order]).min() >= 0, "brighter is more"
    higher = cv2.applyColorMap(np.clip(levels.astype(int) + 20, 0, 230).astype(np.uint8), ramp)
    target = find_painted(higher)
    assert target is not None
    again = actual.repainted(target.levels)
    assert np.abs(again.astype(int) - higher).mean() < 1.5


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.sampled_from([*KNOWN, "own"]), st.sampled_from(["u1", "u2", "f4"]))
def test_what_does_not_change_keeps_its_colours(seed: int, name: str, dtype: str) -> None:
    """Of any kind, with an alpha channel, a line of text and a page around."""
    levels = echoes(seed)
    colours = cv2.applyColorMap(levels, BRONZE) if name == "own" else painted(levels, name)
    cv2.putText(colours, "12.5 m", (12, 30), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (40, 255, 40))
    page = np.pad(colours, ((30, 30), (30, 30), (0, 0)), constant_values=255)
    page = np.dstack([page, np.full(page.shape[:2], 255, np.uint8)])
    full = {"u1": 255, "u2": 65535, "f4": 1}[dtype]
    image = (page * (full / 255)).astype(dtype)
    actual = find_painted(image)
    assert actual is not None
    np.testing.assert_array_equal(actual.repainted(actual.levels), image)
    darker = actual.repainted(actual.levels / 2)
    assert darker.dtype == image.dtype
    np.testing.assert_array_equal(darker[..., 3], image[..., 3])
    np.testing.assert_array_equal(darker[~actual.known], image[~actual.known])
    assert (darker[30:-30, 50:-50] != image[30:-30, 50:-50]).any()


@pytest.mark.parametrize("quality", [60, 90])
@pytest.mark.parametrize("name", ["JET", "VIRIDIS"])
def test_jpeg_mixes_colours_and_levels_are_found_all_the_same(name: str, quality: int) -> None:
    levels = cv2.GaussianBlur(echoes(), (0, 0), 1.2)
    _, content = cv2.imencode(".jpg", painted(levels, name), [cv2.IMWRITE_JPEG_QUALITY, quality])
    actual = find_painted(cv2.imdecode(content, cv2.IMREAD_COLOR))
    assert actual is not None
    assert actual.palette.name == name.lower()
    assert np.corrcoef(actual.levels.ravel(), levels.ravel())[0, 1] > (
        0.98 if quality > 60 else 0.97
    )


@pytest.mark.parametrize("name", [None, "HOT", "JET"])
def test_marks_over_a_map_on_a_screen(name: str | None) -> None:
    """Text, panels and rings are no part of the map, and none is painted anew."""
    grey, true = fan(preset("didson_hf", 300, 400), 0.3, holes=False)
    inside = true.sector_mask(*grey.shape)
    shown = screen(grey if name is None else painted(grey, name), inside, (80, 30, 10))
    ringed = with_rings(shown, true, (0, 200, 0))
    actual = find_painted(ringed)
    assert actual is not None
    assert actual.palette.name == ("grey" if name is None else name.lower())
    part = slice(TOP, TOP + grey.shape[0]), slice(LEFT, LEFT + grey.shape[1])
    rings = (ringed != shown).any(axis=2)[part]
    plain = inside & ~rings
    assert actual.known[part][plain].all()
    assert np.abs(actual.levels[part] * 255 - grey)[plain].max() <= 3
    assert not actual.known[part][rings & inside].any()
    dark = actual.levels[part][rings & inside] < 0.5 * grey[plain].mean() / 255
    assert dark.mean() < 0.35, "rings have the level of what is around them"
    again = actual.repainted(actual.levels * np.float32(0.5))
    np.testing.assert_array_equal(again[part][rings & inside], ringed[part][rings & inside])


def test_colours_of_no_map() -> None:
    rng = np.random.default_rng(1)
    cases: list[Array] = [
        rng.integers(0, 256, (60, 60, 3), dtype=np.uint8),
        np.dstack([echoes()] * 3),
        echoes(),
        np.dstack([echoes(), echoes()]),
        np.zeros((0, 9, 3), np.uint8),
        np.full((40, 40, 3), [0, 0.5, 2], np.float32),
        np.full((40, 40, 3), [0, 0.5, np.nan], np.float32),
        rng.random((40, 40, 3)),
    ]
    assert [find_painted(case) for case in cases] == [None] * len(cases)


def test_grey_of_colours() -> None:
    levels = echoes()
    same = grey_of_colours(np.dstack([levels] * 3))
    np.testing.assert_array_equal(same, levels.astype(np.float32) / np.float32(255))
    np.testing.assert_allclose(grey_of_colours(painted(levels, "JET")) * 255, levels, atol=1.01)
    any_colours = np.random.default_rng(2).random((30, 30, 3)).astype(np.float32)
    wanted = cv2.cvtColor(any_colours, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(grey_of_colours(any_colours), wanted)
