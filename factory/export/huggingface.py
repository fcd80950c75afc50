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
    if received := [name for name, dtype in pairs.form.layers.items() if dtype.kind == "c"]:
        raise FactoryError(
            f"--to huggingface: parquet holds no complex numbers ({received[0]}); export with "
            "--to webdataset"
        )
    (folder / "data").mkdir()
    files = 0
    for split, count in pairs.splits.items():
        found = samples(pairs, split)
        parts = -(-count // SAMPLES_PER_FILE)
        for part in range(parts):
            path = folder / "data" / f"{split}-{part:05d}-of-{parts:05d}.parquet"
            _write_part(pairs, islice(found, SAMPLES_PER_FILE), path)
        files += parts
    settings = dataset_settings(pairs.folder)
    fields = hub_fields(settings.get("name") or "dataset", settings.get("licence"), len(pairs))
    places = [{"path": f"data/{split}-*.parquet", "split": split} for split in pairs.splits]
    fields["configs"] = [{"config_name": "default", "data_files": places}]
    front = f"---\n{yaml.safe_dump(fields, sort_keys=False)}---\n\n"
    write_notes(pairs, folder, _NOTES, front=front)
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
    columns: dict[str, tuple[Any, dict[str, Any]]] = {}
    for layer, dtype in pairs.form.layers.items():
        columns[named(layer)] = image, {"_type": "Image"}
        if not is_picture(dtype):
            values = pyarrow.list_(pyarrow.list_(pyarrow.from_numpy_dtype(dtype)))
            feature = {"_type": "Array2D", "shape": list(pairs.shape), "dtype": str(dtype)}
            columns[named(layer)] = values, feature
    if {"instance", "segmentation"} <= set(pairs.layers):
        number, integer = pyarrow.int32(), {"_type": "Value", "dtype": "int32"}
        one = {"bbox": pyarrow.list_(number), "category": pyarrow.int64(), "area": number}
        names = {"_type": "ClassLabel", "names": list(classes_of(pairs.form.config))}
        kinds = {"bbox": {"_type": "List", "feature": integer}, "category": names, "area": integer}
        objects = pyarrow.list_(pyarrow.struct(list(one.items())))
        columns["objects"] = objects, {"_type": "List", "feature": kinds}
    for column in pairs.form.columns:
        dtype = np.dtype(column.dtype)
        text = dtype.kind == "S"
        kind = pyarrow.string() if text else pyarrow.from_numpy_dtype(dtype)
        feature = {"_type": "Value", "dtype": "string" if text else str(dtype)}
        columns[column.name] = kind, feature
    features = {name: feature for name, (_, feature) in columns.items()}
    schema = pyarrow.schema([(name, kind) for name, (kind, _) in columns.items()])
    return schema.with_metadata({"huggingface": json.dumps({"info": {"features": features}})})


_NOTES = """\
`noisy` is the input of a denoiser, `clean` its target, `shadow` is 255 where no echo arrives. The
other columns say which frame a sample is of and every number that was drawn for it (NaN: not
drawn).

```python
from datasets import load_dataset

pairs = load_dataset("PATH_OF_THIS_FOLDER")
```
"""
