"""WebDataset: tars of `KEY.noisy.png`, `KEY.clean.png`, `KEY.shadow.png`, `KEY.json`.

float32 images, which no PNG holds, are `.npy`.  Read back with
`webdataset.WebDataset("out/train-{000000..000003}.tar").decode("l8")`.
"""

from __future__ import annotations

import json
from pathlib import Path

from ..dataset.source import Sample, Source, json_record
from ..errors import FactoryError
from .pictures import is_picture, npy, png, write_notes

SAMPLES_PER_TAR = 1000


def write(source: Source, folder: Path) -> str:
    """Fill `folder` with numbered tars of each split; the same dataset gives the same bytes."""
    try:
        from webdataset import TarWriter  # an extra
    except ImportError as error:
        raise FactoryError(
            "--to webdataset needs the webdataset package: pip install 'simnfnd[export]'"
        ) from error
    tars = 0
    for split, count in source.splits.items():
        samples = source.samples(split)
        for number in range(-(-count // SAMPLES_PER_TAR)):
            path = folder / f"{split}-{number:06d}.tar"
            # A time stamp and a user name would make every export another file.
            with TarWriter(str(path), encoder=False, mtime=0.0, user="", group="") as tar:
                for _ in range(min(SAMPLES_PER_TAR, count - number * SAMPLES_PER_TAR)):
                    tar.write(_entry(next(samples)))
            tars += 1
    write_notes(source, folder, _NOTES)
    return f"{tars} tars, {_counts(source)}"


def _entry(sample: Sample) -> dict[str, str | bytes]:
    files: dict[str, str | bytes] = {"__key__": sample.key}
    for name, image in sample.images.items():
        if is_picture(image.dtype):
            files[f"{name}.png"] = png(image)
        else:
            files[f"{name}.npy"] = npy(image)
    files["json"] = json.dumps(json_record(sample.record), allow_nan=False).encode()
    return files


def _counts(source: Source) -> str:
    return " and ".join(f"{count} {split} samples" for split, count in source.splits.items())


_NOTES = """\
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
