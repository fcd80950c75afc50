"""The format of a view: what is kept is what was rendered, and a flipped bit is seen."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from simnfnd.factory.frame import Intrinsics
from simnfnd.factory.render.base import Rendered
from simnfnd.factory.render.cloud.planes import rounded
from simnfnd.factory.render.mount import Mount
from simnfnd.factory.render.view import FINE, SMALL, decode, encode, view_of
from tests.factory.render.small_views import same, some_view
from tests.frames import ground_and_post, plain_render


def test_what_is_stored_is_what_pictures_are_made_of() -> None:
    view = some_view()
    assert same(decode(encode(view)), view)
    frame = ground_and_post()
    rendered = plain_render(frame)
    surface = rendered.surface
    depth_error = np.abs(view.depth_m[surface] / frame.depth_m[surface] - 1)
    assert 0 < depth_error.max() < 1.01 * FINE.depth_step / 2
    lit = surface & (rendered.radiance > 0)
    radiance_error = np.abs(view.radiance[lit] / rendered.radiance[lit] - 1)
    assert 0 < radiance_error.max() < 1.01 * FINE.radiance_step / 2
    assert not view.depth_m[~surface].any()
    assert not view.radiance[surface & ~lit].any()


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**31),
    height=st.integers(1, 9),
    width=st.integers(1, 9),
    empty=st.booleans(),
)
def test_any_view_comes_back(seed: int, height: int, width: int, empty: bool) -> None:
    rng = np.random.default_rng(seed)
    frame = replace(
        ground_and_post(),
        depth_m=np.exp(rng.uniform(-8, 7, (height, width))).astype(np.float32),
        rgb=np.zeros((height, width, 3), np.uint8),
        segmentation=rng.integers(0, 20, (height, width), dtype=np.uint8),
        instance=rng.integers(0, 65535, (height, width), dtype=np.uint16),
        world_from_camera=None if seed % 2 else rng.normal(size=(4, 4)),
    )
    surface = (rng.random((height, width)) < 0.7) & (not empty)
    radiance = np.exp(rng.uniform(-25, 10, (height, width))).astype(np.float32)
    radiance = np.where(surface & (rng.random((height, width)) < 0.8), radiance, np.float32(0))
    mount = Mount((0.1, -0.2, 0.3), 4.0, 5.0)
    view = view_of(frame, Rendered(radiance, surface), mount)
    again = decode(encode(view))
    assert same(again, view)
    assert view.world_from_camera is frame.world_from_camera
    assert again.segmentation is not None
    assert again.instance is not None
    assert frame.segmentation is not None
    assert frame.instance is not None
    np.testing.assert_array_equal(again.segmentation, frame.segmentation)
    np.testing.assert_array_equal(again.instance, frame.instance)
    small = decode(encode(view, SMALL))
    np.testing.assert_array_equal(small.depth_m, view.depth_m)
    np.testing.assert_array_equal(small.radiance > 0, view.radiance > 0)


@given(cut=st.integers(0, 4000), content=st.binary(max_size=60))
@settings(max_examples=40)
def test_anything_else_is_no_view(cut: int, content: bytes) -> None:
    for bad in (content, encode(some_view())[:cut]):
        with pytest.raises(ValueError):  # noqa: PT011 (the cause is what was met first)
            decode(bad)


@settings(max_examples=40, deadline=None)
@given(codes=arrays(np.uint16, array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_planes_are_folded_second_differences(codes: np.ndarray[Any, Any]) -> None:
    """The compiled loops against the same steps in numpy."""
    from simnfnd.factory.render.cloud import planes

    down = np.diff(codes, axis=0, prepend=np.uint16(0))
    step = np.diff(down, axis=1, prepend=np.uint16(0)).view(np.int16)
    folded = ((step << 1) ^ (step >> 15)).astype("<u2")
    expected = np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 2).T).tobytes()
    assert planes.pack(codes) == expected
    table = np.random.default_rng(0).random(1 << 16).astype(np.float32)
    height, width = codes.shape
    np.testing.assert_array_equal(planes.unpack(expected, (height, width), table), table[codes])
    with pytest.raises(ValueError, match="reshape"):
        planes.unpack(expected[:-1], (height, width), table)


@settings(max_examples=60, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7), small=st.booleans())
def test_a_flipped_bit_never_changes_a_picture(place: float, bit: int, small: bool) -> None:
    view = some_view()
    content = bytearray(encode(view, SMALL if small else FINE))
    whole = decode(bytes(content))
    content[int(place * len(content))] ^= 1 << bit
    try:
        found = decode(bytes(content))
    except ValueError:
        return
    assert same(found, whole)  # a bit that the codec does not look at


def test_intrinsics_keep_their_distortion() -> None:
    view = replace(some_view(), intrinsics=Intrinsics(1.5, 2.5, 3.5, 4.5, (0.1, 0.2, 0.3, 0.4)))
    assert decode(encode(view)).intrinsics == view.intrinsics


def test_codes_at_hand_are_those_of_the_rounded_values() -> None:
    """An entry of the cache is the same, made of a fresh view or of one that was read."""
    frame = ground_and_post()
    rendered = plain_render(frame)
    fresh = view_of(frame, rendered, Mount())
    assert fresh.codes is not None
    assert encode(fresh) == encode(replace(fresh, codes=None)) == encode(decode(encode(fresh)))


@pytest.mark.parametrize("shape", [(1, 1), (33, 7), (100, 75)])
def test_codes_are_those_of_plain_numpy(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    values = (10 ** rng.uniform(-12, 38, shape)).astype(np.float32)
    values[rng.random(shape) < 0.3] = 0
    values[rng.random(shape) < 0.1] *= -1
    values.flat[0] = np.inf
    low, step = 1e-3, 2e-4
    table = rng.random(1 << 16).astype(np.float32)
    level = np.log(np.maximum(values, np.float32(1e-38)))
    level = (level - np.float32(math.log(low) - step)) / np.float32(step)
    level = np.clip(np.rint(level), 1, 65_534)
    expected = np.where(values > 0, level, np.float32(0)).astype(np.uint16)
    codes, looked_up = rounded(values, low, step, table)
    np.testing.assert_array_equal(codes, expected)
    np.testing.assert_array_equal(looked_up, table[expected])
    # Rows of another array, as a picture that was cut.
    np.testing.assert_array_equal(rounded(values[:, ::2], low, step, table)[0], expected[:, ::2])
