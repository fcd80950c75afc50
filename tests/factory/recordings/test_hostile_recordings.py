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
from simnfnd.factory.recordings import open_recording
from simnfnd.factory.recordings.fan.pings import fan_of, grey_of
from simnfnd.factory.recordings.ros_messages import COMPRESSED, IMAGE, SONAR, typestore
from simnfnd.factory.recordings.rosbag import RosBag
from tests.factory.recordings.array_files import write_array
from tests.factory.recordings.bag_files import compressed, image, sonar, write_bag
from tests.factory.recordings.recording_files import (
    pings,
    write_aris,
    write_ddf,
    write_oculus,
    write_stack,
    write_video,
)

MUTATIONS = 200


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
        for name in ("a.npy", "a.npz", "b.npz", "a.mat", "b.mat", "a.h5")
    },
    "a.bag": lambda path: _bag(path, SONAR),
    "b.bag": lambda path: _bag(path, COMPRESSED, "lz4"),
    "a.mcap": lambda path: _bag(path, SONAR),
    "a.db3": lambda path: _bag(path, IMAGE),
}


def use(path: Path, *, again: bool = True) -> None:
    """Everything that a program does with a recording; again: write it, too."""
    with open_recording(path) as recording:
        assert len(recording) <= 1000
        for frame in recording:
            assert frame.samples.nbytes < 1 << 24
            if frame.beams is not None:
                picture, _ = fan_of(grey_of(frame), frame.beams)
                assert np.isfinite(picture).all()
        if again and isinstance(recording, RosBag):
            target = path.with_name(f"again{path.suffix}")
            recording.rewrite((frame.samples for frame in recording), target)
            target.unlink()


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """With bits flipped, a field overwritten, cut short, or a piece repeated."""
    data = bytearray(content)
    # Headers are where the harm is.
    most = len(data) if rng.random() < 0.3 else min(len(data), 2600)
    match rng.integers(5):
        case 0:
            for _ in range(rng.integers(1, 9)):
                data[rng.integers(most)] ^= 1 << int(rng.integers(8))
        case 1:
            word = rng.choice(
                [b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\xc0\x7f"]
            )
            at = 4 * int(rng.integers(most // 4))
            data[at : at + 4] = word
        case 2:
            del data[rng.integers(len(data)) :]
        case 3:
            at = int(rng.integers(most))
            data[at : at + 8] = rng.bytes(8)
        case _:
            at, size = int(rng.integers(most)), int(rng.integers(1, 300))
            data[at:at] = data[at : at + size]
    return bytes(data)


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
