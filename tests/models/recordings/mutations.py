"""Damage to a recording, and everything that a program does with one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.rosbag import RosBag
from simnfnd.models.recordings.views import fan_of, grey_of

MUTATIONS = 30


def use(path: Path, *, again: bool = True) -> None:
    """Everything that a program does with a recording; again: write it, too."""
    with open_recording(path) as recording:
        assert len(recording) <= 1000
        for frame in recording:
            assert frame.samples.nbytes < 1 << 24
            if frame.beams is not None:
                image, _ = fan_of(grey_of(frame), frame.beams)
                assert np.isfinite(image).all()
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
            at = int(rng.integers(most))
            size = int(rng.integers(1, 300))
            data[at:at] = data[at : at + size]
    return bytes(data)
