"""All that a dataset gives to its readers, and single bits flipped in its shards."""

from __future__ import annotations

from pathlib import Path
from unittest import mock

import numpy as np

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset import PairDataset, reader

LAYERS = ("noisy", "clean", "shadow", "range", "elevation", "segmentation", "layers/background")


def given_out(root: Path) -> dict[str, str]:
    """Name -> content (hexadecimal) of every image, mask and piece of metadata of a train split.

    Raises FactoryError when the reader refuses anything.
    """
    actual: dict[str, bytes] = {}
    with PairDataset(root, "train", layers=LAYERS) as pairs:
        for number, sample in enumerate(pairs):
            actual |= {f"image {number} {name}": x.tobytes() for name, x in sample.items()}
        table = pairs.meta()
        both = pairs.axes
        actual["meta"] = table.tobytes() + repr(table.dtype.names).encode()
        axes = [(axis.name, axis.units, axis.description) for axis in both]
        actual["axes"] = b"".join(axis.values.tobytes() for axis in both)
        actual["form"] = repr((axes, pairs.shape, pairs.dtype, pairs.config_hash)).encode()
        actual["all"] = repr((pairs.form.columns, pairs.form, pairs.splits)).encode()
    return {name: content.hex() for name, content in actual.items()}


def outcome(root: Path | str, sound: dict[str, str]) -> str:
    """`same`, `refused`, or the names of what is another than in the sound dataset."""
    # What hangs is ended after ten seconds; on a busy machine a sound file may take some.
    with mock.patch.object(reader, "LIMIT_S", 10.0):
        try:
            actual = given_out(Path(root))
        except FactoryError:
            return "refused"
    wrong = sorted(name for name in sound | actual if sound.get(name) != actual.get(name))
    return ", ".join(wrong)[:200] or "same"


def flip(path: Path, place: int, bit: int) -> None:
    """Turn one bit of a file over."""
    content = bytearray(path.read_bytes())
    content[place] ^= 1 << bit
    path.write_bytes(content)


def any_bit(path: Path, rng: np.random.Generator) -> tuple[int, int]:
    """A place in a file and a bit there, each as likely as any other."""
    return int(rng.integers(path.stat().st_size)), int(rng.integers(8))
