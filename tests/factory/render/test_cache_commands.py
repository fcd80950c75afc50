"""The cache on the command line: plan, make, status, verify, pack, and frames that failed."""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from simnfnd.command import main
from tests.factory.scheduler.run_files import shard_bytes

WORDS = [
    *("render=analytic", "scenes.locations=2", "scenes.frames_per_location=2"),
    *("scenes.width=240", "scenes.height=160", "dataset.preview_pairs=0"),
    "scheduler=serial",
]


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["simnfnd"])  # Hydra's words are put there
    return main(words, default="make")


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
    assert run(monkeypatch, "status", str(out), "--verify") == 0
    stated = capfd.readouterr().out
    assert "last run: finished; 4 of 4 pairs" in stated
    assert "4 rendered, 0 from the cache" in stated

    # A bit flips in one entry: verify says so, and a run renders that frame anew.
    path = sorted((tmp_path / "cache").glob("*/*.view"))[1]
    content = bytearray(path.read_bytes())
    content[-30] ^= 16
    path.write_bytes(content)
    before = shard_bytes(out)
    shutil.rmtree(out)
    assert run(monkeypatch, *words) == 0
    frames = json.loads((out / "status.json").read_text())["frames"]
    # Four were there, and one of them had to be made anew.
    assert (frames["rendered"], frames["from_cache"]) == (1, 4)
    assert shard_bytes(out) == before
    content[-30] ^= 16
    path.write_bytes(content[:-1])
    capfd.readouterr()
    assert run(monkeypatch, "cache", "verify", cache) == 1
    assert "3 of 4 renders are whole" in capfd.readouterr().out
    shutil.rmtree(out)
    assert run(monkeypatch, *words) == 0

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
