"""The format of a view: what is kept is what was rendered, and a flipped bit is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.render.base import Mount, Rendered
from simnfnd.factory.render.view import DEPTH, RADIANCE, decode, encode, fold, view_of
from tests.factory.render.small_views import same, some_view
from tests.frames import ground_and_post, plain_render


def test_what_is_stored_is_what_pictures_are_made_of() -> None:
    view = some_view()
    assert same(decode(encode(view)), view)
    frame = ground_and_post()
    rendered = plain_render(frame)
    surface = rendered.surface
    depth_error = np.abs(view.seen.depth_m[surface] / frame.depth_m[surface] - 1)
    assert 0 < depth_error.max() < 1.01 * DEPTH.step / 2
    lit = surface & (rendered.radiance > 0)
    radiance_error = np.abs(view.radiance[lit] / rendered.radiance[lit] - 1)
    assert 0 < radiance_error.max() < 1.01 * RADIANCE.step / 2
    assert not view.seen.depth_m[~surface].any()
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
    assert view.seen.world_from_camera is frame.world_from_camera
    for name in ("segmentation", "instance"):
        np.testing.assert_array_equal(getattr(again.seen, name), getattr(frame, name))


@given(cut=st.integers(0, 4000), content=st.binary(max_size=60))
@settings(max_examples=40)
def test_anything_else_is_no_view(cut: int, content: bytes) -> None:
    for bad in (content, encode(some_view())[:cut]):
        with pytest.raises(ValueError):  # noqa: PT011 (the cause is what was met first)
            decode(bad)


def test_folded_planes_keep_their_bytes() -> None:
    """Caches and packs hold them: 5 is +5, folded to 10; 3 after 5 is -2, folded to 3."""
    assert fold(np.array([[5, 3], [5, 300]], np.uint16)) == bytes([10, 3, 0, 82, 0, 0, 0, 2])


@settings(max_examples=60, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_never_changes_a_picture(place: float, bit: int) -> None:
    view = some_view()
    content = bytearray(encode(view))
    whole = decode(bytes(content))
    content[int(place * len(content))] ^= 1 << bit
    try:
        found = decode(bytes(content))
    except ValueError:
        return
    assert same(found, whole)  # a bit that the codec does not look at
