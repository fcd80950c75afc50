"""A flipped bit gives the right pictures or a refusal, and never memory of the process."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.format.layout import check_shard
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.read.image_stack import ImageStack
from simnfnd.factory.dataset.read.reader import check_readable
from simnfnd.factory.dataset.write.writer import fletcher32, write_shard
from simnfnd.factory.errors import FactoryError
from tests.factory.dataset.hostile import PROVENANCE, with_layers
from tests.fake_source import FakeConfig, FakeSource, refs

SOURCE = FakeSource(FakeConfig())
# More than 64 chunks: HDF5's table of them has several nodes then.
MANY = 150
STACKS = ("noisy", "clean", "shadow", "range", "layers/background")
COMPRESSIONS = ("gzip", "none", "lzf", "zstd")


def shard(folder: Path, compression: str, samples: int = 4) -> Path:
    pairs = (with_layers(SOURCE.pairs(ref, (0,))[0]) for ref in refs(samples, "alpha"))
    settings = DatasetSettings(
        compression=compression,  # type: ignore[arg-type]
        compression_level={"gzip": 1, "zstd": 3}.get(compression, 1),
    )
    write_shard(folder, "train/a.h5", pairs, SOURCE.axes(), SOURCE.columns(), PROVENANCE, settings)
    return folder / "train/a.h5"


def tables(content: bytes) -> Iterator[int]:
    """Places of the nodes of HDF5's version 1 tables of chunks, which have no checksum."""
    at = content.find(b"TREE\x01")
    while at >= 0:
        yield at
        at = content.find(b"TREE\x01", at + 1)


def pictures(folder: Path) -> dict[str, bytes]:
    with PairDataset(folder, layers=STACKS, trusted=True) as pairs:
        return {
            f"{n} {name}": image.tobytes() for n, s in enumerate(pairs) for name, image in s.items()
        }


@pytest.mark.parametrize("samples", [4, MANY])
@pytest.mark.parametrize("compression", ["gzip", "none"])
def test_a_flipped_bit_in_a_table_of_chunks_changes_no_picture(
    tmp_path: Path, compression: str, samples: int
) -> None:
    path = shard(tmp_path, compression, samples)
    sound = path.read_bytes()
    right = pictures(tmp_path)
    rng = np.random.default_rng(5)
    nodes = list(tables(sound))
    assert len(nodes) >= len(STACKS) * (1 if samples == 4 else 4)
    refused = 0
    for _ in range(150 if samples == 4 else 60):
        content = bytearray(sound)
        # Key: size, mask, three offsets and one of the element (8 bytes each); then an address.
        node = nodes[rng.integers(len(nodes))]
        entries = max(1, int.from_bytes(content[node + 6 : node + 8], "little"))
        at = node + int(rng.integers(4, 24 + (entries + 1) * 48))
        content[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
        try:
            found = pictures(tmp_path)
        except FactoryError:
            refused += 1
            continue
        assert found == right, f"byte {at - node} of the node at {node}"
    assert refused > 20


@pytest.mark.parametrize("compression", ["gzip", "lzf", "zstd"])
def test_a_filter_that_a_chunk_skips_is_refused(tmp_path: Path, compression: str) -> None:
    if compression == "zstd":
        pytest.importorskip("hdf5plugin")
    for name in STACKS:
        path = shard(tmp_path, compression)
        with h5py.File(path, "r+") as file:
            stack = file[name]
            _, chunk = stack.id.read_direct_chunk((1, 0, 0))
            # Of the same size, HDF5 would keep the entry of its table as it is.
            stack.id.write_direct_chunk((1, 0, 0), bytes(chunk) + b"\0", filter_mask=1)
        with pytest.raises(FactoryError, match=rf"a\.h5: /{name} sample 1 skips its filters"):
            pictures(tmp_path)


@pytest.mark.parametrize("checksum", [False, True])
@pytest.mark.parametrize("size", [0, 1, 479, 481, 480 * 1000])
def test_a_chunk_of_another_length_is_no_picture(tmp_path: Path, size: int, checksum: bool) -> None:
    """HDF5 shows what its memory held before where a chunk gives too few bytes."""
    with h5py.File(tmp_path / "a.h5", "w") as file:
        stack = file.create_dataset(
            "x", (2, 24, 20), "u1", chunks=(1, 24, 20), compression="gzip", fletcher32=checksum
        )
        for row, content in enumerate((bytes(480), bytes(size))):
            chunk = zlib.compress(content)
            ending = struct.pack("<I", fletcher32(chunk)) if checksum else b""
            stack.id.write_direct_chunk((row, 0, 0), chunk + ending)
        sums = np.full(2, zlib.crc32(bytes(480)), np.uint32)
        images = ImageStack(stack, sums)
        assert not images[0].any()
        with pytest.raises(ValueError, match="bytes of a picture"):
            images[1]
        with pytest.raises(ValueError, match="bytes of a picture"):
            images[0:2]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_pictures_are_those_that_h5py_reads(tmp_path: Path, compression: str) -> None:
    if compression == "zstd":
        pytest.importorskip("hdf5plugin")
    with h5py.File(shard(tmp_path, compression)) as file:
        for name in STACKS:
            stack = ImageStack(file[name])
            for rows in (0, -1, np.int64(2), slice(None), slice(1, 3), slice(4, 4)):
                np.testing.assert_array_equal(stack[rows], file[name][rows])  # type: ignore[index]
                assert stack[rows].dtype == file[name].dtype  # type: ignore[index]
                assert stack[rows].flags.writeable  # type: ignore[index]
            with pytest.raises(IndexError):
                stack[4]


def chunked(file: h5py.File, name: str) -> None:
    values = file[name][()]
    attributes = dict(file[name].attrs)
    del file[name]
    file.create_dataset(name, data=values, chunks=(1,), compression="gzip")
    file[name].attrs.update(attributes)


@pytest.mark.parametrize("name", ["meta", "axes/right"])
@pytest.mark.parametrize("bit", [0, 7, 9, 14, 40, 62])
def test_a_flipped_bit_in_the_address_of_a_table_is_refused(
    tmp_path: Path, name: str, bit: int
) -> None:
    path = shard(tmp_path, "none")
    with h5py.File(path) as file:
        place = int(file[name].id.get_offset())
    content = path.read_bytes()
    address, flipped = (number.to_bytes(8, "little") for number in (place, place ^ (1 << bit)))
    assert content.count(address) == 1
    path.write_bytes(content.replace(address, flipped))
    with pytest.raises(FactoryError, match=r"a\.h5: "):
        check_readable(path)


def test_a_table_in_chunks_is_refused(tmp_path: Path) -> None:
    for name in ("meta", "axes/ahead"):
        path = shard(tmp_path, "none")
        with h5py.File(path, "r+") as file:
            chunked(file, name)
            with pytest.raises(FactoryError, match=f"/{name} is stored in chunks"):
                check_shard(file)


def test_two_pictures_at_one_place_are_refused(tmp_path: Path) -> None:
    path = shard(tmp_path, "none")
    with h5py.File(path) as file:
        one, two = (file["noisy"].id.get_chunk_info(k).byte_offset for k in (0, 1))
    content = path.read_bytes()
    assert content.count(two.to_bytes(8, "little")) == 1
    path.write_bytes(content.replace(two.to_bytes(8, "little"), one.to_bytes(8, "little")))
    with pytest.raises(FactoryError, match="/noisy and /noisy share bytes of the file"):
        pictures(tmp_path)
