"""A Hugging Face `datasets` folder: `load_dataset("out")` gives train and test with images.

Parquet as the hub keeps it: each image is a struct of PNG bytes and a path, and the schema's
metadata tell `datasets` that these are images.  float32 pictures become Array2D columns.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..dataset.card import hub_fields
from ..dataset.folder import dataset_settings
from ..dataset.pair_dataset import PairDataset
from ..errors import FactoryError
from ..labels import classes_of
from .objects import shown_in
from .pictures import Sample, is_picture, named, png, samples, write_notes

SAMPLES_PER_FILE = 1000
# The hub reads whole row groups to show one row.
_SAMPLES_PER_GROUP = 100


def write_huggingface(pairs: PairDataset, folder: Path) -> str:
    """Fill `folder` with data/SPLIT-NNNNN-of-NNNNN.parquet and the card that names them."""
    try:
        import pyarrow  # noqa: F401  (an extra)
    except ImportError as error:
        raise FactoryError(
            "--to huggingface needs the pyarrow package: pip install 'simnfnd[export]'"
        ) from error
    (folder / "data").mkdir()
    files = 0
    for split, count in pairs.splits.items():
        found = samples(pairs, split)
        parts = -(-count // SAMPLES_PER_FILE)
        for part in range(parts):
            path = folder / "data" / f"{split}-{part:05d}-of-{parts:05d}.parquet"
            _write_part(pairs, islice(found, SAMPLES_PER_FILE), path)
        files += parts
    _write_card(pairs, folder)
    return f"{files} parquet files, {len(pairs)} samples"


def _write_part(pairs: PairDataset, found: Iterator[Sample], path: Path) -> None:
    import pyarrow
    from pyarrow import parquet

    schema = _schema(pairs)
    # PNG bytes do not get smaller, so compression is for the table alone.
    with parquet.ParquetWriter(path, schema, compression="snappy") as writer:
        while rows := [_row(pairs, sample) for sample in islice(found, _SAMPLES_PER_GROUP)]:
            writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))


def _row(pairs: PairDataset, sample: Sample) -> dict[str, Any]:
    row: dict[str, Any] = {}
    if "instance" in sample.images and "segmentation" in sample.images:
        row["objects"] = [
            {"bbox": list(one.box), "category": one.label, "area": int(one.mask.sum())}
            for one in shown_in(sample, classes_of(pairs.form.config), pairs.folder)
        ]
    for name, image in sample.images.items():
        if is_picture(image.dtype):
            row[name] = {"bytes": png(image), "path": f"{sample.key}.{name}.png"}
        else:
            row[name] = list(image)
    return {**row, **sample.record}


def _schema(pairs: PairDataset) -> Any:
    import pyarrow

    image = pyarrow.struct({"bytes": pyarrow.binary(), "path": pyarrow.string()})
    fields: list[tuple[str, Any]] = []
    features: dict[str, dict[str, Any]] = {}
    for layer, dtype in pairs.form.layers.items():
        name = named(layer)
        if is_picture(dtype):
            fields.append((name, image))
            features[name] = {"_type": "Image"}
        else:
            values = pyarrow.from_numpy_dtype(dtype)
            fields.append((name, pyarrow.list_(pyarrow.list_(values))))
            shape = list(pairs.shape)
            features[name] = {"_type": "Array2D", "shape": shape, "dtype": str(dtype)}
    if {"instance", "segmentation"} <= set(pairs.layers):
        number, integer = pyarrow.int32(), {"_type": "Value", "dtype": "int32"}
        one = {"bbox": pyarrow.list_(number), "category": pyarrow.int64(), "area": number}
        fields.append(("objects", pyarrow.list_(pyarrow.struct(list(one.items())))))
        names = {"_type": "ClassLabel", "names": list(classes_of(pairs.form.config))}
        kinds = {"bbox": {"_type": "List", "feature": integer}, "category": names, "area": integer}
        features["objects"] = {"_type": "List", "feature": kinds}
    for column in pairs.form.columns:
        dtype = np.dtype(column.dtype)
        text = dtype.kind == "S"
        fields.append((column.name, pyarrow.string() if text else pyarrow.from_numpy_dtype(dtype)))
        features[column.name] = {"_type": "Value", "dtype": "string" if text else str(dtype)}
    described = json.dumps({"info": {"features": features}})
    return pyarrow.schema(fields).with_metadata({"huggingface": described})


def _write_card(pairs: PairDataset, folder: Path) -> None:
    settings = dataset_settings(pairs.folder)
    name, licence = str(settings.get("name") or "dataset"), settings.get("licence")
    fields = hub_fields(name, str(licence) if licence else None, len(pairs))
    files = [{"split": split, "path": f"data/{split}-*.parquet"} for split in pairs.splits]
    configs = yaml.safe_dump({"configs": [{"config_name": "default", "data_files": files}]})
    write_notes(pairs, folder, _NOTES, front=f"---\n{fields}\n{configs}---\n\n")


_NOTES = """\
`noisy` is the input of a denoiser, `clean` its target, `shadow` is 255 where no echo arrives. The
other columns say which frame a sample is of and every number that was drawn for it (NaN: not
drawn).

```python
from datasets import load_dataset

pairs = load_dataset("PATH_OF_THIS_FOLDER")
```
"""
