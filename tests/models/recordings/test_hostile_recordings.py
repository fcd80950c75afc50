"""Damaged and foreign recordings: one line, little memory, little time."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.factory.errors import FactoryError
from simnfnd.models.recordings.ros_messages import COMPRESSED, IMAGE, SONAR, typestore
from tests.models.recordings.array_files import write_array
from tests.models.recordings.bag_files import compressed, image, sonar, write_bag
from tests.models.recordings.mutations import MUTATIONS, mutated, use
from tests.models.recordings.recording_files import (
    pings,
    write_aris,
    write_ddf,
    write_oculus,
    write_stack,
    write_video,
)


def _png(path: Path) -> Path:
    assert cv2.imwrite(str(path), pings(1, 60, 48)[0])
    return path


def _bag(path: Path, kind: str, compression: str = "") -> Path:
    store = typestore(1 if path.suffix == ".bag" else 2)
    makers: dict[str, Callable[..., Any]] = {SONAR: sonar, IMAGE: image, COMPRESSED: compressed}
    make = makers[kind]
    messages = [make(store, number, one) for number, one in enumerate(pings(3, 12, 8))]
    return write_bag(path, {"/sonar": (kind, messages)}, compression=compression)


WRITERS: dict[str, Callable[[Path], Path]] = {
    "a.aris": lambda path: write_aris(path, pings(3, 16, 48)),
    "a.ddf": lambda path: write_ddf(path, pings(3, 16, 48)),
    "a.raw": lambda path: write_oculus(path, pings(3, 16, 16)),
    "b.raw": lambda path: write_oculus(path, pings(3, 16, 16), version=2, gains=True),
    "a.avi": lambda path: write_video(path, pings(4, 48, 64)),
    "a.tif": lambda path: write_stack(path, pings(4, 48, 64)),
    "a.png": _png,
    **{
        name: lambda path: write_array(path, pings(4, 48, 64))
        for name in ("a.npy", "a.npz", "b.npz", "a.mat", "b.mat")
    },
    "a.bag": lambda path: _bag(path, SONAR),
    "b.bag": lambda path: _bag(path, COMPRESSED, "lz4"),
    "a.mcap": lambda path: _bag(path, SONAR),
    "a.db3": lambda path: _bag(path, IMAGE),
}


@pytest.mark.parametrize("name", WRITERS)
def test_mutations(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path / name)
    use(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(20)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    started = time.monotonic()
    refused = 0
    for number in range(MUTATIONS):
        path.write_bytes(mutated(whole, rng))
        try:
            # A file of SQLite takes a tenth of a second to reach the disk.
            use(path, again=number % 10 == 0)
        except FactoryError as error:
            refused += 1
            text = str(error)
            assert "\n" not in text, number
            assert str(path) in text
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 300_000, "kilobytes"
    assert time.monotonic() - started < 120
    assert refused > 10


@pytest.mark.parametrize(
    "suffix", [".aris", ".ddf", ".raw", ".avi", ".png", ".bag", ".mcap", ".db3"]
)
@pytest.mark.parametrize("content", [b"", b"DDF", b"\0" * 5000, b"GIF89a" * 1000])
def test_foreign_files(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    with pytest.raises(FactoryError) as caught:
        use(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
