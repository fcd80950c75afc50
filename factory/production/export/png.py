"""Datasets as folders of PNG files, with a table of the samples, for any program."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from ...common.array_types import Array
from ...dataset.pair_dataset import PairDataset
from .notes import write_notes
from .samples import flat_name, read_samples

# Level 1: a third of the time of the default, a few per cent larger.
_COMPRESSION = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def fits_png(dtype: np.dtype[np.generic]) -> bool:
    """Whether a PNG holds this type without loss."""
    return dtype in (np.bool_, np.uint8, np.uint16)


def encode_png(image: Array) -> bytes:
    """(H, W) uint8, uint16, bool (as 0 and 255) or float in 0..1 (16 bits), or RGB -> PNG."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)

    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    elif not fits_png(image.dtype):
        image = np.rint(image.astype(np.float64) * np.iinfo(np.uint16).max).astype(np.uint16)

    is_encoded, encoded = cv2.imencode(".png", image, _COMPRESSION)
    assert is_encoded  # only unknown types and empty images fail
    return encoded.tobytes()


def write_png(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/noisy/NNNNNN.png, SPLIT/clean/..., SPLIT/shadow/... and SPLIT/samples.csv.

    uint8 images are stored without loss, float32 ones with 16 bits (0..65535).  Optional layers
    that no PNG holds without loss, such as metres, are left out.
    """
    written_layers = [
        flat_name(layer)
        for layer, dtype in pairs.form.layers.items()
        if layer in ("noisy", "clean") or fits_png(dtype)
    ]
    for split in pairs.splits:
        _write_split(pairs, split, folder / split, written_layers)
    layers = [layer for layer in pairs.form.layers if flat_name(layer) in written_layers]
    write_notes(pairs, folder, _NOTES, layers=layers)

    summary = f"{len(pairs)} samples as PNG ({', '.join(written_layers)})"
    left_out = [name for name in map(flat_name, pairs.form.layers) if name not in written_layers]
    if left_out:
        summary += f"; left out, as no PNG holds them: {', '.join(left_out)}"
    return summary


def _write_split(pairs: PairDataset, split: str, folder: Path, layers: list[str]) -> None:
    """Fill `folder` with the images of one split and their table; layers: by `flat_name`."""
    for layer in layers:
        (folder / layer).mkdir(parents=True)

    with (folder / "samples.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["file", *(column.name for column in pairs.form.columns)])
        for sample in read_samples(pairs, split):
            file_name = f"{sample.number}.png"
            for layer in layers:
                (folder / layer / file_name).write_bytes(encode_png(sample.images[layer]))
            table.writerow([file_name, *sample.json_record().values()])


_NOTES = """\
Images of one name belong together: `train/noisy/000000.png` is the input of which
`train/clean/000000.png` is the target, and `train/shadow/000000.png` is 255 in acoustic shadow.
`samples.csv` has one row a sample: its file name and its record (empty: not drawn). uint8 data are
stored as they are, float32 data (0..1) as 16 bits (0..65535).
"""
