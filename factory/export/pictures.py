"""Exports of all samples: as PNG pairs, as WebDataset, and what every export writes."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..dataset.folder import dataset_settings
from ..dataset.pair_dataset import PairDataset
from ..errors import FactoryError

SAMPLES_PER_TAR = 1000

# Level 1: a third of the time of the default, a few per cent larger.
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)

Value = float | int | str


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample.

    key: SPLIT-NUMBER, which counts from 0 within the split; sorts as the dataset does.
    images: `named` layer -> (H, W) array as it is stored, rgb (H, W, 3).  record: its row of /meta.
    """

    key: str
    images: Mapping[str, npt.NDArray[Any]]
    record: Mapping[str, Value]

    def json_record(self) -> dict[str, Value | None]:
        """The record as strict JSON can hold it: a parameter that was not drawn (NaN) is null."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in self.record.items()
        }


def named(layer: str) -> str:
    """A layer's name without a slash: `layers/<effect>` is called `layers_<effect>`."""
    return layer.replace("/", "_")


def samples(pairs: PairDataset, split: str) -> Iterator[Sample]:
    """Every sample of one split of a dataset that was opened with all layers.

    Raises FactoryError where a shard has other layers, columns or sizes than the first.
    """
    start = number = 0
    for path in pairs.paths:
        rows = pairs.table(path)
        for row, record in enumerate(rows if path.parent.name == split else ()):
            images = pairs[start + row]
            if any(image.dtype != pairs.form.layers[name] for name, image in images.items()):
                raise FactoryError(f"{path}: its layers differ in type from the other shards'")
            values = {name: record[name].item() for name in rows.dtype.names or ()}
            yield Sample(
                f"{split}-{number:06d}",
                {named(name): image for name, image in images.items()},
                {name: v.decode() if isinstance(v, bytes) else v for name, v in values.items()},
            )
            number += 1
        start += len(rows)


def write_png(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/noisy/NNNNNN.png, SPLIT/clean/..., SPLIT/shadow/... and SPLIT/samples.csv.

    uint8 images without loss, float32 ones with 16 bits (0..65535).  Optional layers that are
    neither go nowhere: a PNG cannot hold metres.
    """
    layers = {named(name): dtype for name, dtype in pairs.form.layers.items()}
    drawn = [n for n, dtype in layers.items() if n in ("noisy", "clean") or is_picture(dtype)]
    for split in pairs.splits:
        for name in drawn:
            (folder / split / name).mkdir(parents=True)
        with (folder / split / "samples.csv").open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["file", *(column.name for column in pairs.form.columns)])
            for sample in samples(pairs, split):
                picture = f"{sample.key.removeprefix(f'{split}-')}.png"
                for name in drawn:
                    (folder / split / name / picture).write_bytes(png(sample.images[name]))
                rows.writerow([picture, *sample.json_record().values()])
    write_notes(pairs, folder, _PNG_NOTES)
    written = f"{len(pairs)} samples as PNG ({', '.join(drawn)})"
    if left_out := [name for name in layers if name not in drawn]:
        written += f"; left out, as no PNG holds them: {', '.join(left_out)}"
    return written


def write_webdataset(pairs: PairDataset, folder: Path) -> str:
    """Numbered tars of `KEY.noisy.png`, `KEY.clean.png`, `KEY.shadow.png`, `KEY.json`.

    What no PNG holds without loss is `.npy`.
    """
    from webdataset import TarWriter  # an extra

    tars = 0
    for split, count in pairs.splits.items():
        found = samples(pairs, split)
        for number in range(-(-count // SAMPLES_PER_TAR)):
            path = folder / f"{split}-{number:06d}.tar"
            # A time stamp and a user name would make every export another file.
            with TarWriter(str(path), encoder=False, mtime=0.0, user="", group="") as tar:
                for sample in islice(found, SAMPLES_PER_TAR):
                    tar.write(_entry(sample))
            tars += 1
    write_notes(pairs, folder, _WEBDATASET_NOTES)
    counts = " and ".join(f"{count} {split} samples" for split, count in pairs.splits.items())
    return f"{tars} tars, {counts}"


def _entry(sample: Sample) -> dict[str, str | bytes]:
    files: dict[str, str | bytes] = {"__key__": sample.key}
    for name, image in sample.images.items():
        if is_picture(image.dtype):
            files[f"{name}.png"] = png(image)
        else:
            buffer = io.BytesIO()
            np.save(buffer, image, allow_pickle=False)
            files[f"{name}.npy"] = buffer.getvalue()
    files["json"] = json.dumps(sample.json_record(), allow_nan=False).encode()
    return files


def is_picture(dtype: np.dtype[np.generic]) -> bool:
    """Whether a PNG holds this type without loss."""
    return dtype in (np.bool_, np.uint8, np.uint16)


def png(image: npt.NDArray[Any]) -> bytes:
    """(H, W) uint8, uint16, bool (as 0 and 255) or float in 0..1 (16 bits), or RGB uint8 -> PNG."""
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    elif not is_picture(image.dtype):
        image = np.rint(image.astype(np.float64) * 65535).astype(np.uint16)
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, encoded = cv2.imencode(".png", image, _PNG)
    assert done  # only unknown types and empty images fail
    return encoded.tobytes()


def write_notes(pairs: PairDataset, folder: Path, reading: str, *, front: str = "") -> None:
    """Write README.md; `reading` says in Markdown what the files are, `front` comes before all."""
    settings = dataset_settings(pairs.folder)
    counts = "".join(f"- {split}: {count} samples\n" for split, count in pairs.splits.items())
    rows, columns = pairs.shape
    text = f"""\
{front}# {settings.get("name") or "dataset"}

Pairs of simulated forward-looking-sonar images, exported from a SimNFND dataset (config hash \
`{pairs.config_hash}`). {rows} x {columns} pixels, {pairs.dtype}, {pairs.layout} layout.

{counts}
## What the files are

{reading}
## Licence

{settings.get("licence") or "not stated"}. The terms of the source images hold for what is derived \
from them.
"""
    (folder / "README.md").write_text(text, encoding="utf-8")


_PNG_NOTES = """\
Pictures of one name belong together: `train/noisy/000000.png` is the input of which
`train/clean/000000.png` is the target, and `train/shadow/000000.png` is 255 in acoustic shadow.
`samples.csv` has one row a sample: its file name and its record (empty: not drawn). uint8 data are
stored as they are, float32 data (0..1) as 16 bits (0..65535).
"""

_WEBDATASET_NOTES = """\
One sample is `KEY.noisy.png`, `KEY.clean.png` (input and target), `KEY.shadow.png` (255 in acoustic
shadow), any optional layer by its name, and `KEY.json`, the sample's record (null: not drawn).
float32 images are `.npy`.

```python
import webdataset

pairs = webdataset.WebDataset("train-000000.tar", shardshuffle=False).decode("l8")
for noisy, clean, record in pairs.to_tuple("noisy.png", "clean.png", "json"):
    ...
```
"""
