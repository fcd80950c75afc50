"""Datasets as tars for WebDataset, whose loaders read them in sequence."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from ...common.array_types import Array
from ...dataset.pair_dataset import PairDataset
from .notes import write_notes
from .png import encode_png, fits_png
from .samples import ExportedSample, divide_into_files

# A loader of WebDataset gives each worker tars of its own.
_MIN_TARS_PER_SPLIT = 8


def write_webdataset(pairs: PairDataset, folder: Path) -> str:
    """Numbered tars of `KEY.noisy.png`, `KEY.clean.png`, `KEY.shadow.png`, `KEY.json`.

    Layers that no PNG holds without loss are `.npy`.
    """
    from webdataset import TarWriter  # an extra

    tar_count = 0
    for tar in divide_into_files(pairs, "{}-{:06d}.tar", min_files=_MIN_TARS_PER_SPLIT):
        path = str(folder / tar.name)
        # A time stamp and a user name would give every export different bytes.
        with TarWriter(path, encoder=False, mtime=0.0, user="", group="") as writer:
            for sample in tar.samples:
                writer.write(_entry_of(sample))
        tar_count += 1
    write_notes(pairs, folder, _NOTES)

    counts = " and ".join(f"{count} {split} samples" for split, count in pairs.splits.items())
    return f"{tar_count} tars, {counts}"


def _entry_of(sample: ExportedSample) -> dict[str, str | bytes]:
    """The key of a sample, and the bytes of each of its files by their extension."""
    entry: dict[str, str | bytes] = {"__key__": sample.key}
    for layer, image in sample.images.items():
        if fits_png(image.dtype):
            entry[f"{layer}.png"] = encode_png(image)
        else:
            entry[f"{layer}.npy"] = _encode_npy(image)
    entry["json"] = json.dumps(sample.json_record(), allow_nan=False).encode()
    return entry


def _encode_npy(image: Array) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, image, allow_pickle=False)
    return buffer.getvalue()


_NOTES = """\
One sample is `KEY.noisy.png`, `KEY.clean.png` (input and target), `KEY.shadow.png` (255 in acoustic
shadow), any optional layer by its name, and `KEY.json`, the sample's record (null: not drawn).
float32 images are `.npy`. Each split has at least 8 tars where it has as many samples, because
every worker of a loader needs a tar of its own; more workers than tars need `empty_check=False`.

```python
from glob import glob

import webdataset

pairs = webdataset.WebDataset(sorted(glob("train-*.tar")), shardshuffle=False).decode("l8")
for noisy, clean, record in pairs.to_tuple("noisy.png", "clean.png", "json"):
    ...
```
"""
