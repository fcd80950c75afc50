"""Chunks made without HDF5: its checksum, its filters, and files that everybody can read."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simnfnd.factory.dataset.write.writer import deflate, fletcher32, write_gzip_chunk


def by_the_book(content: bytes) -> int:
    """Sums folded word by word, as H5checksum.c has them."""
    words = list(struct.unpack(f">{len(content) // 2}H", content[: len(content) // 2 * 2]))
    words += [content[-1] << 8] if len(content) % 2 else []
    low = high = 0
    for word in words:
        low += word
        low = (low & 0xFFFF) + (low >> 16)
        high += low
        high = (high & 0xFFFF) + (high >> 16)
    return high << 16 | low


@settings(max_examples=100)
@given(st.binary(max_size=900) | st.sampled_from([b"\xff" * 65_535, b"\0" * 7, b"\xff\xff" * 4]))
def test_fletcher_is_that_of_hdf5(content: bytes) -> None:
    assert fletcher32(content) == by_the_book(content)


def test_fletcher_of_more_than_one_piece() -> None:
    content = np.random.default_rng(0).bytes((1 << 17) * 2 + 4321)
    assert fletcher32(content) == by_the_book(content)


@pytest.mark.parametrize("level", [0, 1, 6, 9])
@pytest.mark.parametrize("dtype", ["uint8", "float32", "bool", "uint16"])
def test_hdf5_reads_what_it_did_not_compress_and_sees_damage(
    tmp_path: Path, level: int, dtype: str
) -> None:
    rng = np.random.default_rng(level)
    images = (rng.random((3, 37, 53)) * 9 > 4).astype(dtype)
    images[1] = 0
    path = tmp_path / "stack.h5"

    def make(chunked: bool) -> None:
        with h5py.File(path, "w") as file:
            stack = file.create_dataset(
                "noisy",
                shape=images.shape,
                dtype=dtype,
                chunks=(1, 37, 53),
                compression="gzip",
                compression_opts=level,
                fletcher32=True,
            )
            for number, image in enumerate(images):
                if chunked:
                    write_gzip_chunk(stack, number, image, level)
                else:
                    stack[number] = image

    make(chunked=False)
    with h5py.File(path) as file:
        size = file["noisy"].id.get_storage_size()
    make(chunked=True)
    with h5py.File(path) as file:
        stack = file["noisy"]
        np.testing.assert_array_equal(stack[()], images)
        assert stack.id.get_storage_size() < 1.1 * size + 100
        start = stack.id.get_chunk_info(2).byte_offset
    content = bytearray(path.read_bytes())
    content[start + 20] ^= 8
    path.write_bytes(content)
    with h5py.File(path) as file, pytest.raises(OSError, match="filter"):
        file["noisy"][2]


def test_deflated_bytes_are_the_same_every_time_and_small() -> None:
    rng = np.random.default_rng(0)
    picture = (rng.random((256, 256)) ** 8 * 255).astype(np.uint8)
    first = deflate(picture, 1)
    assert first == deflate(picture.copy(), 1)
    assert zlib.decompress(first) == picture.tobytes()
    assert len(first) < 1.05 * len(zlib.compress(picture.tobytes(), 1))
