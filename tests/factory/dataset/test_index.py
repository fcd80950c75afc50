"""index.h5 over many shards: HDF5's own bytes, in a part of the memory that it takes for them."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.dataset.write import virtual
from simnfnd.factory.dataset.write.checksum_loops import lookup3
from simnfnd.factory.dataset.write.index import write_index
from tests.factory.dataset.hostile import whole
from tests.project_files import ROOT


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven shards of train and one of test, made with all entries at once."""
    folder = whole(tmp_path_factory.mktemp("index") / "dataset")
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    first = next(shard for shard in manifest["shards"] if shard["path"] == "train/shard-00000.h5")
    for number in range(2, 7):
        name = f"train/shard-{number:05d}.h5"
        shutil.copyfile(folder / first["path"], folder / name)
        manifest["shards"].append({**first, "path": name})
    path.write_text(json.dumps(manifest))
    assert virtual._PART > 7
    _index(folder)
    return folder


def _index(folder: Path) -> bytes:
    manifest = load_manifest(folder)
    assert manifest is not None
    return write_index(folder, manifest).read_bytes()


@pytest.mark.parametrize("part", [1, 3, 6])
def test_parts_have_the_bytes_of_all_at_once(
    sound: Path, part: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = (sound / "index.h5").read_bytes()
    pieces: list[int] = []
    plain = virtual._written

    def counted(stack: virtual._Stack, some: list[virtual.Piece]) -> bytes | None:
        pieces.append(len(some))
        return plain(stack, some)

    monkeypatch.setattr(virtual, "_PART", part)
    monkeypatch.setattr(virtual, "_written", counted)
    assert _index(sound) == at_once
    assert max(pieces) == part, "the index was made of parts"
    assert sum(pieces) > 7 * 10, "of every layer"


def test_lists_of_another_form_are_left_to_hdf5(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As an HDF5 of the future may write them: nothing is put into what is not understood."""
    at_once = (sound / "index.h5").read_bytes()
    asked: list[int] = []

    def another(content: bytes) -> int:
        asked.append(len(content))
        return lookup3(content) ^ 1

    monkeypatch.setattr(virtual, "_PART", 3)
    monkeypatch.setattr(virtual, "_lookup3", another)
    assert _index(sound) == at_once
    assert asked


@pytest.mark.parametrize(
    ("content", "wanted"),
    # Bob Jenkins, lookup3.c (driver5): hashlittle with no initial value.
    [(b"Four score and seven years ago", 0x17770551)],
)
def test_the_checksum_is_lookup3(content: bytes, wanted: int) -> None:
    assert lookup3(content) == wanted


GROWTH = """
import sys
import numpy as np, psutil, h5py
from simnfnd.factory.dataset.format.manifest import ShardInfo
from simnfnd.factory.dataset.format.schema import LIBRARY_VERSIONS
from simnfnd.factory.dataset.write import virtual
from simnfnd.factory.dataset.write.checksum_loops import lookup3

virtual._PART = int(sys.argv[1])
infos = [ShardInfo(f"train/shard-{n:05d}.h5", "train", 4, 999, "0" * 64) for n in range(5000)]
with h5py.File("i", "w", driver="core", backing_store=False, libver=LIBRARY_VERSIONS) as index:
    before = psutil.Process().memory_info().rss
    made = virtual.VirtualStacks(index)
    made.add("train/noisy", "noisy", infos, (24, 20), np.dtype("u1"))
    print(psutil.Process().memory_info().rss - before)
"""


def test_memory_hardly_grows_with_shards() -> None:
    """HDF5 alone takes 16 kB of each of 5,000 shards, for one layer."""

    def grown_mb(part: int) -> float:
        command = [sys.executable, "-c", GROWTH, str(part)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        return int(done.stdout) / 1e6

    assert grown_mb(10**6) > 40, "what is measured is seen"
    assert grown_mb(virtual._PART) < 15


def test_what_lies_in_the_index_is_found_again(
    sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(virtual, "_PART", 2)
    folder = Path(shutil.copytree(sound, tmp_path / "moved"))
    _index(folder)
    with h5py.File(folder / "index.h5") as index:
        for number in range(7):
            with h5py.File(folder / f"train/shard-{number:05d}.h5") as shard:
                rows = slice(4 * number, 4 * number + 4)
                for layer in ("noisy", "meta", "layers/background"):
                    np.testing.assert_array_equal(index[f"train/{layer}"][rows], shard[layer][()])
