"""PNG pairs: SPLIT/noisy/NNNNNN.png, SPLIT/clean/NNNNNN.png, SPLIT/shadow/NNNNNN.png.

The layout of most restoration code (paired folders, equal names), with SPLIT/samples.csv beside it.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from ..dataset.source import Source, json_record
from .pictures import is_picture, png, sixteen_bit, write_notes


def write(source: Source, folder: Path) -> str:
    """Fill `folder`; uint8 images without loss, float32 ones with 16 bits (0..65535).

    Optional layers that are neither go nowhere: a PNG cannot hold metres.
    """
    drawn = ["noisy", "clean", *(n for n, d in source.layers.items() if is_picture(d))]
    drawn = list(dict.fromkeys(drawn))
    for split in source.splits:
        for name in drawn:
            (folder / split / name).mkdir(parents=True)
        with (folder / split / "samples.csv").open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["file", *(column.name for column in source.columns)])
            for sample in source.samples(split):
                picture = f"{sample.number:06d}.png"
                for name in drawn:
                    image = sample.images[name]
                    if image.dtype == np.float32:
                        image = sixteen_bit(image)
                    (folder / split / name / picture).write_bytes(png(image))
                rows.writerow([picture, *json_record(sample.record).values()])
    write_notes(source, folder, _NOTES)
    left_out = [name for name in source.layers if name not in drawn]
    written = f"{sum(source.splits.values())} samples as PNG ({', '.join(drawn)})"
    if left_out:
        written += f"; left out, as no PNG holds them: {', '.join(left_out)}"
    return written


_NOTES = """\
Pictures of one name belong together: `train/noisy/000000.png` is the input of which
`train/clean/000000.png` is the target, and `train/shadow/000000.png` is 255 in acoustic shadow.
`samples.csv` has one row a sample: its file name and its record (empty: not drawn). uint8 data are
stored as they are, float32 data (0..1) as 16 bits (0..65535).
"""
