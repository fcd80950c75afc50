"""Finished frames of a recording on disk, in blocks, until their file can be written.

A block is a file of its own: a line of JSON, then the numbers and the pixels of its frames.  It
holds nothing but data.  A run uses a block of the same sources and command that is whole, and
computes every other one again; whoever forges one changes its frames and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import zlib
from collections.abc import Sequence
from contextlib import suppress
from itertools import accumulate, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.files import explain_os_errors, write_atomically
from .records import NUMBERS, FrameRecord

FOLDER = ".denoise-unfinished"
BLOCK_FRAMES = 128
_FASTEST = 1  # level of zlib


class BlockFrame(NamedTuple):
    """A denoised frame: pixels as the recording stores them, and what is known of it."""

    image: Array
    record: FrameRecord


class Block:
    """The frames of a block that was read, unpacked one by one."""

    def __init__(self, records: Sequence[FrameRecord], packed: Sequence[bytes]) -> None:
        self._records = records
        self._packed = packed

    def __len__(self) -> int:
        return len(self._records)

    def frame(self, index: int, samples: Array) -> BlockFrame:
        """A frame whose samples in the source are these.  Raises ValueError if it does not fit."""
        unpacker = zlib.decompressobj()
        try:
            content = unpacker.decompress(self._packed[index], samples.nbytes + 1)
        except zlib.error as error:
            raise ValueError(f"damaged ({error})") from error
        if len(content) != samples.nbytes:
            raise ValueError("pixels of another frame")
        image = np.frombuffer(content, samples.dtype).reshape(samples.shape)
        return BlockFrame(image, self._records[index])


class BlockStore(NamedTuple):
    """The blocks of one sequence.

    folder: of its own.  key: of the command and of the sources as they are now.
    """

    folder: Path
    key: str

    @classmethod
    def of(cls, out: Path, name: str, key: str) -> BlockStore:
        """The blocks of a result.  out: the output folder.  name: of the result below it."""
        return cls(out / FOLDER / hashlib.sha256(os.fsencode(name)).hexdigest()[:16], key)

    def write(self, first: int, frames: Sequence[BlockFrame]) -> None:
        """Keep a block.  first: number of its first frame.  Raises FactoryError."""
        numbers = np.array([frame.record.numbers() for frame in frames], "<f8").tobytes()
        packed = [
            zlib.compress(np.ascontiguousarray(frame.image).data, _FASTEST) for frame in frames
        ]
        body = b"".join([numbers, *packed])
        head = {"lengths": [len(each) for each in packed], "sha256": self._digest(first, body)}
        with explain_os_errors(self.folder, "--out"):
            self.folder.mkdir(parents=True, exist_ok=True)
        content = json.dumps(head).encode() + b"\n" + body
        write_atomically(self._path(first), content, key="--out")

    def read(self, first: int) -> Block | None:
        """The block that begins with a frame; None where it is missing, damaged or foreign."""
        with suppress(OSError, ValueError, TypeError, KeyError, RecursionError):
            line, _, body = self._path(first).read_bytes().partition(b"\n")
            head = json.loads(line)
            lengths = [int(length) for length in head["lengths"]]
            if head["sha256"] != self._digest(first, body) or min(lengths, default=0) < 0:
                return None
            size = 8 * NUMBERS * len(lengths)
            numbers = np.frombuffer(body[:size], "<f8").reshape(len(lengths), NUMBERS)
            ends = [*accumulate(lengths, initial=size)]
            packed = [body[start:end] for start, end in pairwise(ends)]
            return Block([FrameRecord.of_numbers(each) for each in numbers], packed)
        return None

    def remove(self) -> None:
        """Delete all blocks, once the result is written or cannot be."""
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):  # it holds those of others
            self.folder.parent.rmdir()

    def _path(self, first: int) -> Path:
        return self.folder / f"{first:08d}.block"

    def _digest(self, first: int, body: bytes) -> str:
        return hashlib.sha256(f"{self.key} {first} ".encode() + body).hexdigest()
