"""Datasets as Parquet files for the library `datasets` and the Hugging Face hub."""

from __future__ import annotations

import json
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from ...common.errors import FactoryError
from ...dataset.card import hub_fields, stated_licence
from ...dataset.folder import dataset_settings
from ...dataset.pair_dataset import PairDataset
from .notes import describe_fields, write_notes
from .object_selection import ClassList, ObjectSelection
from .objects import ExportedObjects, has_labels, survey_objects, visible_objects
from .png import encode_png, fits_png
from .samples import ExportedSample, divide_into_files, flat_name

# The hub reads whole row groups to show one row.
_SAMPLES_PER_GROUP = 100


def write_huggingface(pairs: PairDataset, folder: Path, selection: ObjectSelection) -> str:
    """Fill `folder` with data/SPLIT-NNNNN-of-NNNNN.parquet and the card that names them.

    `load_dataset("out")` gives train and test with images.  Parquet as the hub keeps it: each image
    is a struct of PNG bytes and a path, and the schema's metadata tell `datasets` that these are
    images.  float32 images become Array2D columns.  With labels there is a column `objects`, whose
    classes are those that occur or those of the selection.
    Raises FactoryError for a dataset with complex layers, and for a selection without labels.
    """
    _refuse_complex_layers(pairs)
    exported = None
    if has_labels(pairs) or not selection.is_default:
        exported = survey_objects(pairs, selection)
    file_count = _write_parquet(pairs, folder / "data", exported)
    notes = _NOTES
    if exported is not None:
        notes = f"{_NOTES}\n{_OBJECT_NOTES}{exported.describe(first_number=0)}\n"
    write_notes(pairs, folder, notes, front=_front_matter(pairs, exported))
    summary = f"{file_count} parquet files, {len(pairs)} samples"
    return summary if _licence(pairs) else f"{summary}; {_LICENCE_HINT}"


def _refuse_complex_layers(pairs: PairDataset) -> None:
    for layer, dtype in pairs.form.layers.items():
        if dtype.kind == "c":
            raise FactoryError(
                f"--to huggingface: parquet holds no complex numbers ({layer}); export "
                "with --to webdataset"
            )


def _write_parquet(pairs: PairDataset, folder: Path, exported: ExportedObjects | None) -> int:
    """Write all samples into the new folder; returns the number of files."""
    import pyarrow
    from pyarrow import parquet

    folder.mkdir()
    schema = _schema(pairs, exported)
    file_count = 0
    for file in divide_into_files(pairs, "{}-{:05d}-of-{:05d}.parquet"):
        # PNG bytes do not get smaller, so compression is for the table alone.
        with parquet.ParquetWriter(folder / file.name, schema, compression="snappy") as writer:
            while group := list(islice(file.samples, _SAMPLES_PER_GROUP)):
                rows = [_row_of(sample, pairs, exported) for sample in group]
                writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))
        file_count += 1
    return file_count


def _licence(pairs: PairDataset) -> str | None:
    return stated_licence(dataset_settings(pairs.folder).get("licence"), pairs.form.config)


def _front_matter(pairs: PairDataset, exported: ExportedObjects | None) -> str:
    """The YAML at the top of the card, from which the hub knows licence, size and files."""
    name = dataset_settings(pairs.folder).get("name") or "dataset"
    tasks = ["image-to-image"]
    if exported is not None:
        tasks.append("object-detection")
    fields = hub_fields(name, _licence(pairs), len(pairs), tasks, "parquet")
    data_files = [{"path": f"data/{split}-*.parquet", "split": split} for split in pairs.splits]
    fields["configs"] = [{"config_name": "default", "data_files": data_files}]
    return f"---\n{yaml.safe_dump(fields, sort_keys=False)}---\n\n"


def _row_of(
    sample: ExportedSample, pairs: PairDataset, exported: ExportedObjects | None
) -> dict[str, Any]:
    """A row of a Parquet file: column -> value."""
    row: dict[str, Any] = {}
    if exported is not None:
        objects = [
            shown
            for shown in visible_objects(sample, pairs, exported.selection)
            if exported.has_room_for(shown)
        ]
        row["objects"] = {
            "bbox": [list(shown.box) for shown in objects],
            "category": [exported.classes.number(shown.class_name) - 1 for shown in objects],
            "area": [shown.area_px for shown in objects],
        }
    for layer, image in sample.images.items():
        if fits_png(image.dtype):
            row[layer] = {"bytes": encode_png(image), "path": f"{sample.key}.{layer}.png"}
        else:
            row[layer] = list(image)
    return {**row, **sample.record}


class _Column(NamedTuple):
    """A column of a Parquet file: its Arrow type, and the `feature` that `datasets` reads."""

    arrow_type: Any
    feature: dict[str, Any]


def _schema(pairs: PairDataset, exported: ExportedObjects | None) -> Any:
    """The Arrow schema of all columns, with the features of `datasets` as its metadata."""
    import pyarrow

    columns = {flat_name(layer): _image_column(pairs, layer) for layer in pairs.form.layers}
    if exported is not None:
        columns["objects"] = _object_column(exported.classes)
    for table_column in pairs.form.columns:
        columns[table_column.name] = _value_column(np.dtype(table_column.dtype))

    metadata = {name: {"units": "", "description": ""} for name in columns}
    for name, units, description in describe_fields(pairs):
        metadata[name] = {"units": units, "description": description}
    fields = [
        pyarrow.field(name, column.arrow_type, metadata=metadata[name])
        for name, column in columns.items()
    ]

    features = {name: column.feature for name, column in columns.items()}
    document = json.dumps({"info": {"features": features}})
    return pyarrow.schema(fields).with_metadata({"huggingface": document})


def _image_column(pairs: PairDataset, layer: str) -> _Column:
    """PNG files of a layer; arrays of a layer that no PNG holds without loss."""
    import pyarrow

    dtype = pairs.form.layers[layer]
    if fits_png(dtype):
        png_file = pyarrow.struct({"bytes": pyarrow.binary(), "path": pyarrow.string()})
        return _Column(png_file, {"_type": "Image"})
    rows = pyarrow.list_(pyarrow.list_(pyarrow.from_numpy_dtype(dtype)))
    shape = list(pairs.form.sizes[layer])
    return _Column(rows, {"_type": "Array2D", "shape": shape, "dtype": str(dtype)})


def _object_column(classes: ClassList) -> _Column:
    """Lists of the boxes, classes and areas of the objects in an image.

    One table of lists, as detection datasets of the hub have it.  The name `Sequence` is known to
    all versions of `datasets`, `List` to those since 4.0.
    """
    import pyarrow

    number = pyarrow.int32()
    lists = {
        "bbox": pyarrow.list_(pyarrow.list_(number)),
        "category": pyarrow.list_(pyarrow.int64()),
        "area": pyarrow.list_(number),
    }
    integer = {"_type": "Value", "dtype": "int32"}
    features = {
        "bbox": {"_type": "Sequence", "feature": integer, "length": -1},
        "category": {"_type": "ClassLabel", "names": list(classes.names)},
        "area": integer,
    }
    column_feature = {"_type": "Sequence", "feature": features, "length": -1}
    return _Column(pyarrow.struct(list(lists.items())), column_feature)


def _value_column(dtype: np.dtype[np.generic]) -> _Column:
    """A column of the sample table."""
    import pyarrow

    if dtype.kind == "S":
        return _Column(pyarrow.string(), {"_type": "Value", "dtype": "string"})
    return _Column(pyarrow.from_numpy_dtype(dtype), {"_type": "Value", "dtype": str(dtype)})


_NOTES = """\
`noisy` is the input of a denoiser, `clean` its target, `shadow` is 255 where no echo arrives. The
other columns say which frame a sample is of and every number that was drawn for it (NaN: not
drawn). Units and descriptions are in the metadata of the Parquet schema, too
(`pyarrow.parquet.read_schema(FILE).field("range_min_m").metadata`).

```python
from datasets import load_dataset

pairs = load_dataset("PATH_OF_THIS_FOLDER")
```
"""

_OBJECT_NOTES = """\
`objects` holds lists of the boxes (`bbox`: left, top, width, height in pixels), categories
(`category`) and areas (`area`) of the objects in an image. Categories are numbers of their own;
`segmentation` has the numbers of the dataset.
"""

_LICENCE_HINT = (
    "the card states no licence, because the dataset has none: add `license:` to README.md before "
    "you publish"
)
