"""Renders on disk: keys, the folder, packs, commands; damage is detected; Blender is not needed."""

from __future__ import annotations

import ast
import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.factory.common.errors import FactoryError, FrameError, NotRendered
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.schema import config_hash
from simnfnd.factory.production.cli.generate import run as generate
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.pairs.views import (
    RENDER_CODE,
    Cache,
    CachedViews,
    PackViews,
    ViewMaker,
)
from simnfnd.factory.simulation.render.base import CacheSettings, Mount, RenderSettings
from simnfnd.factory.simulation.render.pack import read_contents, write_pack
from tests.factory.production.scheduler.run_files import shard_bytes
from tests.factory.simulation.render.small_views import SMALL_SEABED, config, same, some_view
from tests.project_files import ROOT


def test_keys_tell_what_decides_the_pixels_and_nothing_else(tmp_path: Path) -> None:
    base = config(tmp_path)
    ref = FrameRef("seabed", "seabed-0000", "0001")

    def key(settings: FactoryConfig, frame: FrameRef = ref) -> str:
        return CachedViews(settings).key(frame)

    assert key(base) == key(base)
    equal = [
        config(tmp_path, noise={"background": {"enabled": False}}, seed=9),
        config(tmp_path, scenes={**SMALL_SEABED, "locations": 7, "frames_per_location": 9}),
        config(tmp_path / "elsewhere", sonar={"beams": 64, "hfov_deg": 30}),
    ]
    assert {key(settings) for settings in equal} == {key(base)}
    other_settings = [
        config(tmp_path, scenes={**SMALL_SEABED, "width": 256}),
        config(tmp_path, render={"kind": "analytic", "albedo": "rgb"}),
        config(tmp_path, sonar={"mount": {"pitch_deg": 5}}),
    ]
    keys = [key(settings) for settings in other_settings]
    keys.append(key(base, FrameRef("seabed", "seabed-0000", "0002")))
    assert len({*keys, key(base)}) == len(keys) + 1


def test_the_content_of_files_counts_and_not_their_place(tmp_path: Path) -> None:
    base = config(tmp_path)
    keys = CachedViews(base)
    for name, content in (("a", b"one"), ("b", b"one"), ("c", b"two")):
        (tmp_path / name).write_bytes(content)
    of = {name: keys.key(FrameRef("", "s", "f", (str(tmp_path / name),))) for name in "abc"}
    assert of["a"] == of["b"] != of["c"]
    (tmp_path / "a").write_bytes(b"more")
    assert keys.key(FrameRef("", "s", "f", (str(tmp_path / "a"),))) not in of.values()


def test_damaged_entries_are_removed_when_they_are_met(tmp_path: Path) -> None:
    cache = Cache(CacheSettings(dir=str(tmp_path)))
    view = some_view()
    for key in ("aa11", "bb22"):
        assert cache.get(key) is None
        cache.put(key, view)
        actual = cache.get(key)
        assert actual is not None
        assert same(actual, view)
    for key, damage in (
        ("aa11", lambda c: c[: len(c) // 2]),
        ("bb22", lambda c: c[:-9] + b"9" * 9),
    ):
        path = tmp_path / key[:2] / f"{key}.view"
        path.write_bytes(damage(path.read_bytes()))
        assert cache.get(key) is None
        assert not path.exists()


def test_what_was_unused_longest_goes_first(tmp_path: Path) -> None:
    cache = Cache(CacheSettings(dir=str(tmp_path)))
    view = some_view()
    sizes = [cache.put(f"{number:04d}", view) for number in range(6)]
    for number, (_, path, _) in enumerate(cache.entries()):
        os.utime(path, (1000 + number, 1000 + number))
    assert cache.get("0000") is not None  # used now, so it stays
    Cache(CacheSettings(dir=str(tmp_path), max_bytes=3 * sizes[0])).note_growth(sizes[0])
    left = {path.stem for _, path, _ in cache.entries()}
    assert "0000" in left
    assert left - {"0000"} == {f"{number:04d}" for number in range(6 - len(left) + 1, 6)}
    assert sum(size for _, _, size in cache.entries()) <= 3 * sizes[0]


def test_a_cache_that_cannot_be_written_is_said_before_the_run(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(FactoryError, match=r"cache\.dir"):
        generate(config(blocked / "cache"), [])


def test_a_pack_holds_the_renders_and_knows_its_mount(tmp_path: Path) -> None:
    view = some_view()
    refs = [FrameRef("a", "b", "c"), FrameRef("", "s/t", "f")]
    for name in ("one.pack", "two.pack"):
        write_pack(tmp_path / name, refs, lambda ref: view, Mount(), RenderSettings("cycles"))
    assert (tmp_path / "one.pack").read_bytes() == (tmp_path / "two.pack").read_bytes()
    contents = read_contents(tmp_path / "one.pack")
    assert list(contents.members) == refs
    assert contents.render == RenderSettings("cycles")
    views = PackViews(str(tmp_path / "one.pack"), Mount())
    assert same(views.view(refs[1]), view)
    with pytest.raises(NotRendered):
        views.view(FrameRef("a", "b", "d"))
    with pytest.raises(FactoryError, match=r"sonar\.mount.*pitch_deg"):
        PackViews(str(tmp_path / "one.pack"), Mount(pitch_deg=3.0))
    content = bytearray((tmp_path / "one.pack").read_bytes())
    content[500] ^= 1
    (tmp_path / "one.pack").write_bytes(content)
    with pytest.raises(FactoryError, match=r"000000.view is damaged"):
        views.view(refs[0])
    (tmp_path / "one.pack").write_bytes(b"no zip")
    with pytest.raises(FactoryError, match="no pack, or damaged"):
        read_contents(tmp_path / "one.pack")


@pytest.mark.slow
def test_a_dataset_of_a_pack_states_which_and_takes_no_other(tmp_path: Path) -> None:
    refs = [FrameRef("seabed", f"seabed-000{k}", "0000") for k in range(2)]
    hashes = set()
    dataset = tmp_path / "out"
    for name, albedo in (("first", "flattened"), ("second", "constant")):
        settings = config(tmp_path / "cache", render={"kind": "analytic", "albedo": albedo})
        maker = ViewMaker(settings)
        pack = tmp_path / f"{name}.pack"
        write_pack(pack, refs, maker.render, Mount(), settings.render)
        packed = config(
            tmp_path / "cache",
            scenes={"kind": "pack", "root": str(pack)},
            render={},
            dataset={"dir": str(dataset), "preview_pairs": 0},
        )
        stated = identity(packed)
        assert stated["render"]["kind"] == "analytic"
        assert stated["render"]["albedo"] == albedo
        hashes.add(config_hash(stated))
        if name == "first":
            generate(packed, [])
    assert len(hashes) == 2
    card = (dataset / "README.md").read_text()
    assert "closed form (as the pack says)" in card
    assert "stride: auto" not in card, "a setting of an earlier version"
    with pytest.raises(FactoryError, match=r"scenes\.digest"):
        generate(packed, [])
    cycles = config(tmp_path, scenes={"kind": "pack", "root": str(pack)}, render={"kind": "cycles"})
    with pytest.raises(FactoryError, match="render=cycles: the pack"):
        identity(cycles)


def test_a_render_that_cannot_be_read_now_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = config(tmp_path)
    ref = FrameRef("seabed", "seabed-0000", "0001")
    key = ViewMaker(settings).prepare(ref).key
    path = CachedViews(settings).cache.path(key)

    def fails(*_: object) -> bytes:
        raise OSError(errno.EIO, "Input/output error", str(path))

    with monkeypatch.context() as patched:
        patched.setattr("simnfnd.factory.simulation.pairs.views.read_regular", fails)
        with pytest.raises(FrameError, match="cannot be read"):
            CachedViews(settings).view(ref)
    assert path.exists()
    CachedViews(settings).view(ref)


def test_the_key_covers_every_module_that_a_render_passes() -> None:
    """What the rooms of the renders import, and what that imports, is hashed."""
    root = ROOT / "factory"
    waiting = [
        path
        for room in ("render", "scenes", "meshes")
        for path in sorted((root / "simulation" / room).rglob("*.py"))
    ]
    observed: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path in observed:
            continue
        observed.add(path)
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level and node.module:
                target = path.parents[node.level - 1].joinpath(*node.module.split("."))
                waiting += [module for module in (target.with_suffix(".py"),) if module.exists()]
    names = {path.relative_to(root).as_posix() for path in observed}
    assert {name for name in names if not name.startswith(RENDER_CODE)} == set()
    assert {"simulation/scenes/base.py", "common/seeds.py"} <= names


@pytest.mark.slow
def test_adding_noise_loads_neither_blender_nor_open3d(tmp_path: Path) -> None:
    settings = config(tmp_path)
    ref = FrameRef("seabed", "seabed-0000", "0001")
    ViewMaker(settings).prepare(ref)
    assert CachedViews(settings).holds(ref)
    code = f"""
import sys
for name in ("bpy", "open3d"):
    sys.modules[name] = None  # whoever imports it now fails
from simnfnd.factory.simulation.config.root import from_mapping
from simnfnd.factory.simulation.frames.frame import FrameRef
from simnfnd.factory.simulation.pairs.pair_maker import pair_maker
config = from_mapping({{"scenes": {SMALL_SEABED!r}, "render": {{"kind": "analytic"}},
                       "cache": {{"dir": {str(tmp_path)!r}}}}})
pairs = pair_maker(config).pairs(FrameRef("seabed", "seabed-0000", "0001"), (0, 1))
assert len(pairs) == 2
rooms = "simnfnd.factory."
for heavy in ("torch", "matplotlib", rooms + "render.renderers", rooms + "scenes.seabed.world"):
    assert heavy not in sys.modules, heavy
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


WORDS = [
    *("render=analytic", "scenes.locations=2", "scenes.frames_per_location=2"),
    *("scenes.width=240", "scenes.height=160", "dataset.preview_pairs=0"),
    "scheduler=serial",
]


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["simnfnd"])  # Hydra's words are put there
    return main(words, default="make")


@pytest.mark.slow
def test_from_command_line_to_pack_and_back(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """plan, make, status, a flipped bit, pack, and the same pairs out of the pack."""
    cache = f"cache.dir={tmp_path / 'cache'}"
    out = tmp_path / "out"
    words = [*WORDS, cache, f"dataset.dir={out}", "scheduler.shard_size=2"]
    assert run(monkeypatch, "plan", *words) == 0
    stated = capfd.readouterr().out
    assert "train: 2 pairs in 1 shards" in stated
    assert "renders: 0 of 4 are in the cache" in stated
    written = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert written == ["costs.json"], "a plan wrote more than what it measured"
    assert run(monkeypatch, *words) == 0
    assert run(monkeypatch, "status", str(out)) == 0
    stated = capfd.readouterr().out
    assert "last run: finished; 4 of 4 pairs" in stated
    assert "4 rendered, 0 from the cache" in stated

    # A bit flips in one entry: a run makes the same pairs, and that entry anew.
    path = sorted((tmp_path / "cache").glob("*/*.view"))[1]
    whole = path.read_bytes()
    before = shard_bytes(out)
    path.write_bytes(whole[:-30] + bytes([whole[-30] ^ 16]) + whole[-29:])
    shutil.rmtree(out)
    assert run(monkeypatch, *words) == 0
    assert shard_bytes(out) == before
    assert path.read_bytes() == whole

    pack = tmp_path / "views.pack"
    assert run(monkeypatch, "cache", "pack", "--out", str(pack), *words) == 0
    assert run(monkeypatch, "cache", "clear", cache) == 0
    assert not list((tmp_path / "cache").glob("*/*.view"))
    packed = [word for word in words if not word.startswith(("scenes.", "render=", "dataset.dir"))]
    from_pack = tmp_path / "from_pack"
    packed += ["scenes=pack", f"scenes.root={pack}", f"dataset.dir={from_pack}"]
    assert run(monkeypatch, *packed) == 0
    paths = sorted(path.relative_to(out) for path in out.glob("*/*.h5"))
    assert paths == sorted(path.relative_to(from_pack) for path in from_pack.glob("*/*.h5"))
    for path in paths:
        with h5py.File(out / path) as first, h5py.File(from_pack / path) as second:
            for layer in ("noisy", "clean", "shadow"):
                np.testing.assert_array_equal(first[layer][()], second[layer][()])
