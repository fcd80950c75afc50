"""Renders on disk: what is kept is what was rendered, damage is seen, and nobody needs Blender."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from simnfnd.command import main
from simnfnd.factory.config import FactoryConfig, from_mapping
from simnfnd.factory.errors import FactoryError, NotRendered
from simnfnd.factory.frame import FrameRef, Intrinsics
from simnfnd.factory.pairs import pair_maker
from simnfnd.factory.render.base import Rendered
from simnfnd.factory.render.cloud.planes import rounded
from simnfnd.factory.render.mount import Mount
from simnfnd.factory.render.pack import PackViews, read_contents, write_pack
from simnfnd.factory.render.view import FINE, SMALL, View, decode, encode, view_of
from simnfnd.factory.renders.cache import Cache, CacheSettings, Limit
from simnfnd.factory.renders.key import FrameKeys
from simnfnd.factory.renders.views import CachedViews, ViewMaker
from tests.factory.jobs.test_scheduler import shard_bytes
from tests.frames import ground_and_post, plain_render
from tests.project_files import ROOT

SMALL_SEABED = {
    "kind": "seabed",
    "locations": 1,
    "frames_per_location": 3,
    "width": 240,
    "height": 160,
}
WORDS = [
    *("render=analytic", "scenes.locations=2", "scenes.frames_per_location=2"),
    *("scenes.width=240", "scenes.height=160", "dataset.preview_pairs=0"),
    "scheduler=serial",
]


def some_view() -> View:
    frame = ground_and_post()
    return view_of(frame, plain_render(frame), Mount())


def config(folder: Path, **keys: object) -> FactoryConfig:
    return from_mapping(
        {
            "scenes": SMALL_SEABED,
            "render": {"kind": "analytic"},
            "cache": {"dir": str(folder)},
            **keys,
        }
    )


def same(one: View, other: View) -> bool:
    return (
        one.depth_m.tobytes() == other.depth_m.tobytes()
        and one.radiance.tobytes() == other.radiance.tobytes()
        and (one.intrinsics, one.mount) == (other.intrinsics, other.mount)
        and np.array_equal(
            np.asarray(one.world_from_camera, dtype=object),
            np.asarray(other.world_from_camera, dtype=object),
        )
    )


# --- format -----------------------------------------------------------------------------------


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


# --- keys -------------------------------------------------------------------------------------


def test_keys_tell_what_decides_the_pixels_and_nothing_else(tmp_path: Path) -> None:
    base = config(tmp_path)
    ref = FrameRef("seabed", "seabed-0000", "0001")

    def key(settings: FactoryConfig, frame: FrameRef = ref) -> str:
        return FrameKeys(settings.scenes, settings.render, settings.sonar.mount).of(frame)

    assert key(base) == key(base)
    equal = [
        config(tmp_path, noise={"background": {"enabled": False}}, seed=9),
        config(tmp_path, scenes={**SMALL_SEABED, "locations": 7, "frames_per_location": 9}),
        config(tmp_path / "elsewhere", sonar={"beams": 64, "hfov_deg": 30}),
    ]
    assert {key(settings) for settings in equal} == {key(base)}
    other = [
        config(tmp_path, scenes={**SMALL_SEABED, "width": 256}),
        config(tmp_path, render={"kind": "analytic", "albedo": "rgb"}),
        config(tmp_path, sonar={"mount": {"pitch_deg": 5}}),
    ]
    keys = [key(settings) for settings in other]
    keys.append(key(base, FrameRef("seabed", "seabed-0000", "0002")))
    assert len({*keys, key(base)}) == len(keys) + 1


def test_the_content_of_files_counts_and_not_their_place(tmp_path: Path) -> None:
    base = config(tmp_path)
    keys = FrameKeys(base.scenes, base.render, base.sonar.mount)
    for name, content in (("a", b"one"), ("b", b"one"), ("c", b"two")):
        (tmp_path / name).write_bytes(content)
    of = {name: keys.of(FrameRef("", "s", "f", (str(tmp_path / name),))) for name in "abc"}
    assert of["a"] == of["b"] != of["c"]
    (tmp_path / "a").write_bytes(b"more")
    assert keys.of(FrameRef("", "s", "f", (str(tmp_path / "a"),))) not in of.values()


def test_files_of_prepared_frames_are_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, ref = config(tmp_path), FrameRef("seabed", "seabed-0000", "0001")
    key = ViewMaker(settings).prepare(ref).key
    assert key == CachedViews(settings).keys.of(ref)
    views = CachedViews(settings)
    views.expect({ref.name: key})

    def gone(self: FrameKeys, ref: FrameRef) -> str:
        raise FileNotFoundError(ref.name)

    monkeypatch.setattr(FrameKeys, "of", gone)
    assert views.holds(ref)
    assert views.view(ref).depth_m.any()
    views.expect({})
    assert not views.holds(ref)
    with pytest.raises(NotRendered):
        views.view(ref)


# --- the folder -------------------------------------------------------------------------------


def test_damaged_entries_are_removed_when_they_are_met(tmp_path: Path) -> None:
    cache, view = Cache(tmp_path), some_view()
    for key in ("aa11", "bb22"):
        assert cache.get(key) is None
        cache.put(key, view)
        found = cache.get(key)
        assert found is not None
        assert same(found, view)
    for key, damage in (
        ("aa11", lambda c: c[: len(c) // 2]),
        ("bb22", lambda c: c[:-9] + b"9" * 9),
    ):
        path = tmp_path / key[:2] / f"{key}.view"
        path.write_bytes(damage(path.read_bytes()))
        assert cache.get(key) is None
        assert not path.exists()


def test_what_was_unused_longest_goes_first(tmp_path: Path) -> None:
    cache, view = Cache(tmp_path), some_view()
    sizes = [cache.put(f"{number:04d}", view) for number in range(10)]
    for number, entry in enumerate(cache.entries()):
        os.utime(entry.path, (1000 + number, 1000 + number))
    assert cache.get("0000") is not None  # used now, so it stays
    limit = Limit(CacheSettings(dir=str(tmp_path), max_bytes=5 * sizes[0]))
    limit(sizes[0])
    left = {entry.key for entry in cache.entries()}
    assert "0000" in left
    assert left - {"0000"} == {f"{number:04d}" for number in range(10 - len(left) + 1, 10)}
    assert sum(entry.bytes for entry in cache.entries()) <= 5 * sizes[0]


def test_a_cache_that_cannot_be_written_is_said_before_the_run(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(FactoryError, match=r"cache\.dir"):
        Cache(blocked / "cache").check()


def test_a_render_that_is_not_there_is_asked_for_by_name(tmp_path: Path) -> None:
    settings = config(tmp_path)
    ref = FrameRef("seabed", "seabed-0000", "0001")
    with pytest.raises(NotRendered, match="seabed/seabed-0000/0001"):
        pair_maker(settings).pairs(ref, (0,))
    made = ViewMaker(settings).prepare(ref)
    assert (made.hit, made.bytes > 1000) == (False, True)
    assert ViewMaker(settings).prepare(ref).hit
    assert len(pair_maker(settings).pairs(ref, (0, 1))) == 2


def test_pairs_of_a_cached_render_are_those_of_a_fresh_one(tmp_path: Path) -> None:
    from simnfnd.factory.pairs import make_pair, observe

    settings = config(tmp_path)
    ref = FrameRef("seabed", "seabed-0000", "0002")
    maker = ViewMaker(settings)
    fresh = maker.render(ref)
    maker.prepare(ref)
    (cached,) = pair_maker(settings).pairs(ref, (3,))
    scene = observe(fresh.frame(ref), fresh.rendered(), settings)
    direct = make_pair(scene, 3, settings)
    for name in ("noisy", "clean", "shadow"):
        assert getattr(cached, name).tobytes() == getattr(direct, name).tobytes()
    assert cached.record == direct.record


# --- packs ------------------------------------------------------------------------------------


def test_a_pack_holds_the_renders_and_knows_its_mount(tmp_path: Path) -> None:
    view, refs = some_view(), [FrameRef("a", "b", "c"), FrameRef("", "s/t", "f")]
    for name in ("one.pack", "two.pack"):
        write_pack(tmp_path / name, refs, lambda ref: view, Mount(), "cycles")
    assert (tmp_path / "one.pack").read_bytes() == (tmp_path / "two.pack").read_bytes()
    contents = read_contents(tmp_path / "one.pack")
    assert list(contents.members) == refs
    assert contents.exact
    views = PackViews(str(tmp_path / "one.pack"), Mount())
    assert same(views.view(refs[1]), view)
    with pytest.raises(NotRendered):
        views.view(FrameRef("a", "b", "d"))
    with pytest.raises(FactoryError, match=r"sonar\.mount.*pitch_deg"):
        PackViews(str(tmp_path / "one.pack"), Mount(pitch_deg=3.0))
    content = bytearray((tmp_path / "one.pack").read_bytes())
    content[500] ^= 1
    (tmp_path / "one.pack").write_bytes(content)
    with pytest.raises(FactoryError, match=r"a/b/c is damaged.*copy the pack again"):
        views.view(refs[0])
    (tmp_path / "one.pack").write_bytes(b"no zip")
    with pytest.raises(FactoryError, match="no pack, or damaged"):
        read_contents(tmp_path / "one.pack")


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["simnfnd"])  # Hydra's words are put there
    return main(words, default="make")


def test_a_run_works_out_the_key_of_a_frame_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    of, asked = FrameKeys.of, []

    def counted(self: FrameKeys, ref: FrameRef) -> str:
        asked.append(ref.name)
        return of(self, ref)

    monkeypatch.setattr(FrameKeys, "of", counted)
    words = [*WORDS, f"cache.dir={tmp_path / 'cache'}", f"dataset.dir={tmp_path / 'out'}"]
    assert run(monkeypatch, *words) == 0
    assert len(asked) == len(set(asked)) == 4


def test_from_command_line_to_pack_and_back(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """plan, make, status, verify with a flipped bit, pack, and the same pairs out of the pack."""
    cache = f"cache.dir={tmp_path / 'cache'}"
    out = tmp_path / "out"
    words = [*WORDS, cache, f"dataset.dir={out}", "scheduler.shard_size=2"]
    assert run(monkeypatch, "plan", *words) == 0
    stated = capfd.readouterr().out
    assert "train: 2 pairs in 1 shards" in stated
    assert "renders: 0 of 4 are in the cache" in stated
    assert sorted(os.listdir(tmp_path)) == [], "a plan wrote something"
    assert run(monkeypatch, *words) == 0
    assert run(monkeypatch, "plan", *words) == 0
    assert "renders: 4 of 4 are in the cache" in capfd.readouterr().out
    assert run(monkeypatch, "status", str(out), "--verify") == 0
    stated = capfd.readouterr().out
    assert "last run: finished; 4 of 4 pairs" in stated
    assert "4 rendered, 0 from the cache" in stated
    assert run(monkeypatch, "failed", str(out)) == 0

    # A bit flips in one entry: verify says so, and a run renders that frame anew.
    path = sorted((tmp_path / "cache").glob("*/*.view"))[1]
    content = bytearray(path.read_bytes())
    content[-30] ^= 16
    path.write_bytes(content)
    again = [*words, "dataset.on_existing=overwrite"]
    before = shard_bytes(out)
    assert run(monkeypatch, *again) == 0
    frames = json.loads((out / "status.json").read_text())["frames"]
    # Four were there, and one of them had to be made anew.
    assert (frames["rendered"], frames["from_cache"]) == (1, 4)
    assert shard_bytes(out) == before
    content[-30] ^= 16
    path.write_bytes(content[:-1])
    capfd.readouterr()
    assert run(monkeypatch, "cache", "verify", cache) == 1
    assert "3 of 4 renders are whole" in capfd.readouterr().out
    assert run(monkeypatch, *again) == 0

    pack = tmp_path / "views.pack"
    assert run(monkeypatch, "cache", "pack", "--out", str(pack), *words) == 0
    assert run(monkeypatch, "cache", "clear", cache) == 0
    assert not list((tmp_path / "cache").glob("*/*.view"))
    packed = [word for word in words if not word.startswith(("scenes.", "render=", "dataset.dir"))]
    code = run(
        monkeypatch,
        *packed,
        "scenes=pack",
        f"scenes.root={pack}",
        f"dataset.dir={tmp_path / 'from_pack'}",
    )
    assert code == 0
    assert_same_pictures(out, tmp_path / "from_pack")


def assert_same_pictures(one: Path, other: Path) -> None:
    import h5py

    paths = sorted(path.relative_to(one) for path in one.glob("*/*.h5"))
    assert paths == sorted(path.relative_to(other) for path in other.glob("*/*.h5"))
    for path in paths:
        with h5py.File(one / path) as first, h5py.File(other / path) as second:
            for layer in ("noisy", "clean", "shadow"):
                np.testing.assert_array_equal(first[layer][()], second[layer][()])


def test_failed_frames_are_told_and_can_be_tried_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    import cv2

    folder = tmp_path / "scene"
    folder.mkdir()
    rgb = np.full((80, 120, 3), 120, np.uint8)
    depth = np.linspace(4000, 1500, 80 * 120).reshape(80, 120).astype(np.uint16)
    for name, picture in (("good", depth), ("bad", depth * 0)):
        cv2.imwrite(str(folder / f"{name}.png"), rgb)
        cv2.imwrite(str(folder / f"{name}_d.png"), picture)
    (folder / "list.csv").write_text("good.png,good_d.png\nbad.png,bad_d.png\n")
    out = tmp_path / "out"
    words = [
        *("scenes=csv_list", f"scenes.root={folder / 'list.csv'}", "render=analytic"),
        *("scenes.intrinsics=[100,100,60,40]", "scheduler=serial", "dataset.preview_pairs=0"),
        *(f"cache.dir={tmp_path / 'cache'}", f"dataset.dir={out}"),
    ]
    assert run(monkeypatch, *words) == 1
    capfd.readouterr()
    assert run(monkeypatch, "failed", str(out)) == 1
    stated = capfd.readouterr().out
    assert "list/bad" in stated
    assert "frames.only=[list/bad]" in stated
    cv2.imwrite(str(folder / "bad_d.png"), depth)
    assert run(monkeypatch, "failed", str(out), "--rerun") == 0
    assert "1 of 1 frames work now" in capfd.readouterr().out
    assert run(monkeypatch, *words) == 0
    assert run(monkeypatch, "failed", str(out)) == 0


# --- what noise workers load ------------------------------------------------------------------


def test_adding_noise_loads_neither_blender_nor_open3d(tmp_path: Path) -> None:
    settings = config(tmp_path)
    ref = FrameRef("seabed", "seabed-0000", "0001")
    ViewMaker(settings).prepare(ref)
    assert CachedViews(settings).holds(ref)
    code = f"""
import sys
for name in ("bpy", "open3d"):
    sys.modules[name] = None  # whoever imports it now fails
from simnfnd.factory.config import from_mapping
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.pairs import pair_maker
config = from_mapping({{"scenes": {SMALL_SEABED!r}, "render": {{"kind": "analytic"}},
                       "cache": {{"dir": {str(tmp_path)!r}}}}})
pairs = pair_maker(config).pairs(FrameRef("seabed", "seabed-0000", "0001"), (0, 1))
assert len(pairs) == 2
rooms = "simnfnd.factory."
for heavy in ("torch", "matplotlib", rooms + "render.blender", rooms + "scenes.seabed.world"):
    assert heavy not in sys.modules, heavy
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


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
