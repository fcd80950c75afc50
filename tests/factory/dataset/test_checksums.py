"""What tells of damage: checksums of images, tables and texts, chunks."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.isolated import IsolatedProcess
from simnfnd.factory.dataset import PairDataset
from tests.factory.dataset.flips import any_bit, flip, given_out, outcome
from tests.factory.dataset.hostile import PROVENANCE, admit, keep_only, whole, with_layers
from tests.factory.dataset.some_shards import some_pairs, write

SHARD = "train/shard-00000.h5"


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Plain chunks: no filter tells of a flipped bit."""
    return whole(tmp_path_factory.mktemp("sound") / "dataset", compression="none")


def _text(words: bytes) -> Callable[[h5py.File, bytes], int]:
    return lambda file, content: content.index(words) + len(words) // 2


PLACES: dict[str, Callable[[h5py.File, bytes], int]] = {
    "meta": lambda file, content: file["meta"].id.get_offset() + 60,
    "axis": lambda file, content: file["axes/ahead"].id.get_offset() + 15,
    "noisy": lambda file, content: file["noisy"].id.get_chunk_info(1).byte_offset + 200,
    "shadow": lambda file, content: file["shadow"].id.get_chunk_info(2).byte_offset + 200,
    "layer": lambda file, content: file["layers/background"].id.get_chunk_info(0).byte_offset,
    "sums": lambda file, content: file["checksums"].id.get_offset() + 5,
    "config": _text(b'{"seed":7}'),
    "config hash": _text(PROVENANCE.config_hash.encode()),
    "generator": _text(b"simnfnd 0.1.0"),
    "text of an axis": _text(b"from the sonar"),
    "text of a column": _text(b"fraction of the scene points"),
    "text of a layer": _text(b"target of a denoiser"),
}


@pytest.mark.parametrize("part", sorted(PLACES))
def test_a_flipped_bit_is_refused(folder: Path, part: str) -> None:
    path = folder / SHARD
    right = given_out(folder)
    with h5py.File(path) as file:
        place = PLACES[part](file, path.read_bytes())
    flip(path, place, 0)
    assert outcome(folder, right) == "refused"


@pytest.mark.parametrize(
    "names", [("checksums",), ("text_checksum",), ("checksums", "checksum", "text_checksum")]
)
def test_a_shard_without_its_checksums_is_refused(folder: Path, names: tuple[str, ...]) -> None:
    with h5py.File(folder / SHARD, "r+") as file:
        for name in names:
            del (file if name in file else file.attrs)[name]
    admit(folder)
    with pytest.raises(FactoryError, match=r"shard-00000\.h5: .*checksums"):
        given_out(folder)


def test_bits_anywhere_change_nothing_unseen(folder: Path) -> None:
    keep_only(folder, SHARD)
    path = folder / SHARD
    content = path.read_bytes()
    right = given_out(folder)
    rng = np.random.default_rng(5)
    said = []
    process = IsolatedProcess()
    for _ in range(10):
        flip(path, *any_bit(path, rng))
        said.append(process.call(outcome, str(folder), right, limit_s=20.0))
        path.write_bytes(content)
    assert set(said) == {"same", "refused"}


STACKS = ("noisy", "clean", "shadow", "range", "layers/background")


def shard(folder: Path, compression: str, samples: int = 4) -> Path:
    write(folder, map(with_layers, some_pairs(samples)), "train/a.h5", compression=compression)
    return folder / "train/a.h5"


@pytest.mark.parametrize("compression", ["gzip", "none"])
def test_a_flipped_bit_in_a_table_of_chunks_changes_no_image(
    tmp_path: Path, compression: str
) -> None:
    """In this very process, whom a damaged table must not abort; 70 chunks fill several nodes."""
    path = shard(tmp_path, compression, samples=70)
    sound = path.read_bytes()

    def images() -> list[bytes]:
        with PairDataset(tmp_path, layers=STACKS, trusted=True) as pairs:
            return [image.tobytes() for sample in pairs for image in sample.values()]

    right = images()
    nodes = [actual.start() for actual in re.finditer(rb"TREE\x01", sound)]
    assert len(nodes) >= len(STACKS) * 2
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(16):
        content = bytearray(sound)
        # Key: size, mask, three offsets and one of the element (8 bytes each); then an address.
        node = nodes[rng.integers(len(nodes))]
        entries = max(1, int.from_bytes(content[node + 6 : node + 8], "little"))
        content[node + int(rng.integers(4, 24 + (entries + 1) * 48))] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
        try:
            assert images() == right
        except FactoryError:
            refused += 1
    assert refused > 2


def test_a_filter_that_a_chunk_skips_is_refused(tmp_path: Path) -> None:
    for name in STACKS:
        path = shard(tmp_path, "gzip")
        with h5py.File(path, "r+") as file:
            stack = file[name]
            _, chunk = stack.id.read_direct_chunk((1, 0, 0))
            # Of the same size, HDF5 would keep the entry of its table as it is.
            stack.id.write_direct_chunk((1, 0, 0), bytes(chunk) + b"\0", filter_mask=1)
        with pytest.raises(FactoryError, match=rf"a\.h5: /{name} sample 1"):
            PairDataset(tmp_path, layers=STACKS, trusted=True)[0]


def test_a_table_in_chunks_is_refused(tmp_path: Path) -> None:
    for name in ("meta", "axes/ahead"):
        path = shard(tmp_path, "none")
        with h5py.File(path, "r+") as file:
            values = file[name][()]
            attributes = dict(file[name].attrs)
            del file[name]
            file.create_dataset(name, data=values, chunks=(1,), compression="gzip")
            file[name].attrs.update(attributes)
        with pytest.raises(FactoryError, match=f"/{name}: .*schema"):
            PairDataset(tmp_path, trusted=True)[0]
