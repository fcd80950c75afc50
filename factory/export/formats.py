"""The formats that datasets are exported to: PNG, WebDataset, Hugging Face, COCO and YOLO."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from ..cli import markdown
from ..dataset.card import hub_fields, source_terms, stated_licence
from ..dataset.folder import dataset_settings
from ..dataset.meaning import grey_meaning, pixel_meaning
from ..dataset.pair_dataset import PairDataset
from ..dataset.schema import CORE, Layer, stored_image
from ..dataset.schema import layers as known_layers
from ..errors import FactoryError
from ..labels import classes_of

SAMPLES_PER_FILE = 1000
# A loader of WebDataset gives each worker tars of its own.
_TARS_PER_SPLIT = 8
# The hub reads whole row groups to show one row.
_SAMPLES_PER_GROUP = 100
LEAST_PX = 8
"""An object that shows in fewer pixels is no larger than a speckle, and is left out."""

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
            yield Sample(
                key=f"{split}-{number:06d}",
                images={named(name): image for name, image in images.items()},
                record={name: _plain(record[name].item()) for name in rows.dtype.names or ()},
            )
            number += 1
        start += len(rows)


def _plain(value: Any) -> Value:
    """A value of the table with text as str."""
    return value.decode() if isinstance(value, bytes) else value


def _files(
    pairs: PairDataset, name: str, *, least_files: int = 1
) -> Iterator[tuple[str, Iterator[Sample]]]:
    """Name and samples of each file; a file has at most SAMPLES_PER_FILE samples.

    name: pattern of split, number of the file and number of files.  least_files: minimum number of
    files per split, if it has as many samples.
    """
    for split, count in pairs.splits.items():
        samples_per_file = min(SAMPLES_PER_FILE, max(1, count // least_files))
        files = -(-count // samples_per_file)
        of_split = samples(pairs, split)
        for number in range(files):
            yield name.format(split, number, files), islice(of_split, samples_per_file)


def is_image(dtype: np.dtype[np.generic]) -> bool:
    """Whether a PNG holds this type without loss."""
    return dtype in (np.bool_, np.uint8, np.uint16)


def png(image: npt.NDArray[Any]) -> bytes:
    """(H, W) uint8, uint16, bool (as 0 and 255) or float in 0..1 (16 bits), or RGB -> PNG."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    elif not is_image(image.dtype):
        image = np.rint(image.astype(np.float64) * 65535).astype(np.uint16)
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
## What the numbers mean

- **Grey values.** Of noisy and clean as the dataset stores them: \
{grey_meaning(pairs.form.config, str(pairs.dtype))}
- **Pixels.** {pixel_meaning(pairs.layout, columns)} These names are in the record of each sample.

{_described(pairs)}
## Licence

{stated_licence(settings.get("licence"), pairs.form.config) or "not stated"}. \
{source_terms(pairs.form.config)}
"""
    (folder / "README.md").write_text(text, encoding="utf-8")


def _described(pairs: PairDataset) -> str:
    """A Markdown table of the units and descriptions of all layers and columns."""
    rows = [(named(layer.name), layer.units, layer.description) for layer in _layers(pairs)]
    rows += [(column.name, column.units, column.description) for column in pairs.form.columns]
    table = [[name, units, text.replace("|", "\\|")] for name, units, text in rows]
    return markdown(["name", "unit", "what it is"], table)


def _layers(pairs: PairDataset) -> tuple[Layer, ...]:
    dtype = str(pairs.form.layers["noisy"])
    return known_layers(dtype, set(pairs.form.layers) - set(CORE))


def write_png(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/noisy/NNNNNN.png, SPLIT/clean/..., SPLIT/shadow/... and SPLIT/samples.csv.

    uint8 images without loss, float32 ones with 16 bits (0..65535).  Optional layers that are
    neither go nowhere: a PNG cannot hold metres.
    """
    layers = {named(name): dtype for name, dtype in pairs.form.layers.items()}
    drawn = [n for n, dtype in layers.items() if n in ("noisy", "clean") or is_image(dtype)]
    for split in pairs.splits:
        for name in drawn:
            (folder / split / name).mkdir(parents=True)
        with (folder / split / "samples.csv").open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(["file", *(column.name for column in pairs.form.columns)])
            for sample in samples(pairs, split):
                file_name = f"{sample.key.removeprefix(f'{split}-')}.png"
                for name in drawn:
                    (folder / split / name / file_name).write_bytes(png(sample.images[name]))
                rows.writerow([file_name, *sample.json_record().values()])
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
    for name, file_samples in _files(pairs, "{}-{:06d}.tar", least_files=_TARS_PER_SPLIT):
        tars += 1
        # A time stamp and a user name would make every export another file.
        with TarWriter(str(folder / name), encoder=False, mtime=0.0, user="", group="") as tar:
            for sample in file_samples:
                entry: dict[str, str | bytes] = {"__key__": sample.key}
                for layer, image in sample.images.items():
                    if is_image(image.dtype):
                        entry[f"{layer}.png"] = png(image)
                        continue
                    buffer = io.BytesIO()
                    np.save(buffer, image, allow_pickle=False)
                    entry[f"{layer}.npy"] = buffer.getvalue()
                entry["json"] = json.dumps(sample.json_record(), allow_nan=False).encode()
                tar.write(entry)
    write_notes(pairs, folder, _WEBDATASET_NOTES)
    counts = " and ".join(f"{count} {split} samples" for split, count in pairs.splits.items())
    return f"{tars} tars, {counts}"


def write_huggingface(pairs: PairDataset, folder: Path) -> str:
    """Fill `folder` with data/SPLIT-NNNNN-of-NNNNN.parquet and the card that names them.

    `load_dataset("out")` gives train and test with images.  Parquet as the hub keeps it: each image
    is a struct of PNG bytes and a path, and the schema's metadata tell `datasets` that these are
    images.  float32 images become Array2D columns.
    """
    import pyarrow
    from pyarrow import parquet

    complex_layers = [name for name, dtype in pairs.form.layers.items() if dtype.kind == "c"]
    if complex_layers:
        raise FactoryError(
            f"--to huggingface: parquet holds no complex numbers ({complex_layers[0]}); export "
            "with --to webdataset"
        )
    (folder / "data").mkdir()
    schema = _schema(pairs)
    files = 0
    for name, file_samples in _files(pairs, "{}-{:05d}-of-{:05d}.parquet"):
        files += 1
        # PNG bytes do not get smaller, so compression is for the table alone.
        with parquet.ParquetWriter(folder / "data" / name, schema, compression="snappy") as writer:
            while group := list(islice(file_samples, _SAMPLES_PER_GROUP)):
                rows = [_row(pairs, sample) for sample in group]
                writer.write_table(pyarrow.Table.from_pylist(rows, schema=schema))
    settings = dataset_settings(pairs.folder)
    licence = stated_licence(settings.get("licence"), pairs.form.config)
    fields = hub_fields(settings.get("name") or "dataset", licence, len(pairs))
    places = [{"path": f"data/{split}-*.parquet", "split": split} for split in pairs.splits]
    fields["configs"] = [{"config_name": "default", "data_files": places}]
    front = f"---\n{yaml.safe_dump(fields, sort_keys=False)}---\n\n"
    write_notes(pairs, folder, _HUGGINGFACE_NOTES, front=front)
    return f"{files} parquet files, {len(pairs)} samples"


def _row(pairs: PairDataset, sample: Sample) -> dict[str, Any]:
    row: dict[str, Any] = {}
    if "instance" in sample.images and "segmentation" in sample.images:
        row["objects"] = [
            {"bbox": list(shown.box), "category": shown.label, "area": int(shown.mask.sum())}
            for shown in shown_in(sample, classes_of(pairs.form.config), pairs.folder)
        ]
    for name, image in sample.images.items():
        if is_image(image.dtype):
            row[name] = {"bytes": png(image), "path": f"{sample.key}.{name}.png"}
        else:
            row[name] = list(image)
    return {**row, **sample.record}


class _Column(NamedTuple):
    """A column of a parquet file: its Arrow type, and the `feature` that `datasets` reads."""

    arrow_type: Any
    feature: dict[str, Any]


def _schema(pairs: PairDataset) -> Any:
    """The Arrow schema of all columns, with the features of `datasets` as its metadata."""
    import pyarrow

    columns = {named(layer): _image_column(pairs, layer) for layer in pairs.form.layers}
    if {"instance", "segmentation"} <= set(pairs.layers):
        columns["objects"] = _object_column(pairs)
    for column in pairs.form.columns:
        columns[column.name] = _value_column(np.dtype(column.dtype))

    texts = {named(layer.name): (layer.units, layer.description) for layer in _layers(pairs)}
    texts |= {column.name: (column.units, column.description) for column in pairs.form.columns}
    fields = []
    for name, (arrow_type, _) in columns.items():
        units, description = texts.get(name, ("", ""))
        metadata = {"units": units, "description": description}
        fields.append(pyarrow.field(name, arrow_type, metadata=metadata))

    features = {name: feature for name, (_, feature) in columns.items()}
    document = json.dumps({"info": {"features": features}})
    return pyarrow.schema(fields).with_metadata({"huggingface": document})


def _image_column(pairs: PairDataset, layer: str) -> _Column:
    """PNG files of a layer; arrays of a layer that no PNG holds without loss."""
    import pyarrow

    dtype = pairs.form.layers[layer]
    if is_image(dtype):
        png_file = pyarrow.struct({"bytes": pyarrow.binary(), "path": pyarrow.string()})
        return _Column(png_file, {"_type": "Image"})
    rows = pyarrow.list_(pyarrow.list_(pyarrow.from_numpy_dtype(dtype)))
    shape = list(pairs.form.sizes[layer])
    return _Column(rows, {"_type": "Array2D", "shape": shape, "dtype": str(dtype)})


def _object_column(pairs: PairDataset) -> _Column:
    """Boxes, classes and areas of the objects in an image."""
    import pyarrow

    number = pyarrow.int32()
    object_fields = {"bbox": pyarrow.list_(number), "category": pyarrow.int64(), "area": number}
    arrow_type = pyarrow.list_(pyarrow.struct(list(object_fields.items())))

    integer = {"_type": "Value", "dtype": "int32"}
    features = {
        "bbox": {"_type": "List", "feature": integer},
        "category": {"_type": "ClassLabel", "names": list(classes_of(pairs.form.config))},
        "area": integer,
    }
    return _Column(arrow_type, {"_type": "List", "feature": features})


def _value_column(dtype: np.dtype[np.generic]) -> _Column:
    """A column of the sample table."""
    import pyarrow

    if dtype.kind == "S":
        return _Column(pyarrow.string(), {"_type": "Value", "dtype": "string"})
    return _Column(pyarrow.from_numpy_dtype(dtype), {"_type": "Value", "dtype": str(dtype)})


# --- objects, for detectors


class Box(NamedTuple):
    """The smallest box around an object, pixels."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class Shown:
    """An object in an image: its class, 1 or more, and the pixels (H, W) that show it."""

    label: int
    mask: npt.NDArray[np.bool_]

    @property
    def box(self) -> Box:
        """The box around the pixels of the mask."""
        return Box(*cv2.boundingRect(self.mask.astype(np.uint8)))


def shown_in(sample: Sample, classes: tuple[str, ...], directory: Path) -> Iterator[Shown]:
    """The pixels of each number in /instance, with the label that most of them have."""
    numbers = sample.images["instance"]
    labels = sample.images["segmentation"]
    for number in np.unique(numbers[numbers > 0]):
        mask = numbers == number
        label = int(np.bincount(labels[mask]).argmax())
        if label >= len(classes):
            raise FactoryError(
                f"{directory}: {sample.key}: /segmentation has a value {label}, "
                "which names no class"
            )
        if label:
            yield Shown(label, mask)


def _objects(
    pairs: PairDataset, folder: Path, split: str, counts: Counter[str]
) -> Iterator[tuple[str, list[Shown]]]:
    """Write images/SPLIT/KEY.png and clean/ of every sample, and give its key and its objects.

    counts: of objects, and of those left out.  Raises FactoryError for a dataset without labels.
    """
    if not {"segmentation", "instance"} <= set(pairs.layers):
        raise FactoryError(
            f"{pairs.folder} has no labels (/segmentation and /instance); make it from scenes with "
            "labels and dataset.layers=[segmentation], or export with --to png"
        )
    for sample in samples(pairs, split):
        for name, layer in (("images", "noisy"), ("clean", "clean")):
            path = folder / name / split / f"{sample.key}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(png(stored_image(sample.images[layer], "uint8")))
        shown_objects = list(shown_in(sample, classes_of(pairs.form.config), pairs.folder))
        large = [shown for shown in shown_objects if int(shown.mask.sum()) >= LEAST_PX]
        counts.update(objects=len(large), small=len(shown_objects) - len(large))
        yield sample.key, large


def _counted(pairs: PairDataset, counts: Counter[str]) -> str:
    small = f"{counts['small']} below {LEAST_PX} pixels left out"
    return f"{len(pairs)} images, {counts['objects']} objects; {small}"


def write_coco(pairs: PairDataset, folder: Path) -> str:
    """images/SPLIT/NAME.png and annotations/instances_SPLIT.json, with boxes and masks.

    Categories have the numbers of the classes (`simnfnd.factory.labels`), from 1.  clean/SPLIT
    holds the ideal images.  Format: https://cocodataset.org/#format-data.
    """
    height, width = pairs.shape
    counts = Counter[str]()
    (folder / "annotations").mkdir()
    for split in pairs.splits:
        images: list[dict[str, Any]] = []
        annotations: list[dict[str, Any]] = []
        for key, shown_objects in _objects(pairs, folder, split, counts):
            size = {"width": width, "height": height}
            images.append({"id": len(images) + 1, "file_name": f"{key}.png", **size})
            for shown in shown_objects:
                annotation = {
                    "id": len(annotations) + 1,
                    "image_id": len(images),
                    "category_id": shown.label,
                    "bbox": shown.box,
                    "area": int(shown.mask.sum()),
                    "segmentation": run_lengths(shown.mask),
                    "iscrowd": 0,
                }
                annotations.append(annotation)
        document = {
            "info": {"description": f"SimNFND, {split}; masks as run lengths", "version": "1.0"},
            "images": images,
            "annotations": annotations,
            "categories": [
                {"id": label, "name": name, "supercategory": "object"}
                for label, name in enumerate(classes_of(pairs.form.config))
                if label
            ],
        }
        text = json.dumps(document, separators=(",", ":"))
        (folder / "annotations" / f"instances_{split}.json").write_text(text + "\n")
    write_notes(pairs, folder, _COCO_NOTES)
    return _counted(pairs, counts)


def run_lengths(mask: npt.NDArray[np.bool_]) -> dict[str, list[int]]:
    """(H, W) as COCO's uncompressed runs: of 0, of 1, of 0, ... down each column in turn."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat, prepend=False))
    counts = np.diff(changes, prepend=0, append=flat.size)
    return {"counts": counts.tolist(), "size": list(mask.shape)}


def write_yolo(pairs: PairDataset, folder: Path) -> str:
    """images/SPLIT/NAME.png, labels/SPLIT/NAME.txt and data.yaml, as Ultralytics reads them.

    A line of labels is a polygon: its class, then its corners as fractions of width and height;
    detectors use the box around it.  An object in separate parts has a line for each part; holes,
    which the format cannot express, are filled.  Format:
    https://docs.ultralytics.com/datasets/segment.
    """
    splits = tuple(pairs.splits)
    counts = Counter[str]()
    for split in splits:
        (folder / "labels" / split).mkdir(parents=True)
        for key, shown_objects in _objects(pairs, folder, split, counts):
            text = "".join(_yolo_lines(shown) for shown in shown_objects)
            (folder / "labels" / split / f"{key}.txt").write_text(text)

    # Without `path`, places are relative to data.yaml.  Ultralytics requires both keys.
    places = {
        key: f"images/{split if split in splits else splits[0]}"
        for key, split in (("train", "train"), ("val", "test"))
    }
    names = dict(enumerate(classes_of(pairs.form.config)[1:]))
    text = yaml.safe_dump({**places, "names": names}, sort_keys=False)
    (folder / "data.yaml").write_text(text)
    write_notes(pairs, folder, _YOLO_NOTES)
    return _counted(pairs, counts)


def _yolo_lines(shown: Shown) -> str:
    """A line for each part of an object; YOLO counts classes from 0."""
    height, width = shown.mask.shape
    lines = []
    for outline in outlines(shown.mask):
        corners = (outline / (width, height)).ravel()
        numbers = " ".join(f"{value:.6f}" for value in corners)
        lines.append(f"{shown.label - 1} {numbers}\n")
    return "".join(lines)


def outlines(mask: npt.NDArray[np.bool_]) -> list[npt.NDArray[np.int64]]:
    """Return the outline of each connected part of an (H, W) mask, (corners, 2) columns and rows.

    Pixels that touch at a corner are connected.  A pixel (column c, row r) covers c to c + 1 and
    r to r + 1, and outlines run along these edges.
    """
    # At twice the resolution, the outer pixels show which side of their pixel lies outside.
    double = np.repeat(np.repeat(mask.astype(np.uint8), 2, axis=0), 2, axis=1)
    contours, _ = cv2.findContours(double, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    rings = []
    for contour in contours:
        vertices = (contour[:, 0].astype(np.int64) + 1) // 2
        is_new = np.any(vertices != np.roll(vertices, 1, axis=0), axis=1)
        vertices = vertices[is_new]
        # Of straight lines the ends alone.
        step = vertices - np.roll(vertices, 1, axis=0)
        is_corner = np.any(step != np.roll(step, -1, axis=0), axis=1)
        rings.append(np.asarray(vertices[is_corner]))
    return rings


_PNG_NOTES = """\
Images of one name belong together: `train/noisy/000000.png` is the input of which
`train/clean/000000.png` is the target, and `train/shadow/000000.png` is 255 in acoustic shadow.
`samples.csv` has one row a sample: its file name and its record (empty: not drawn). uint8 data are
stored as they are, float32 data (0..1) as 16 bits (0..65535).
"""

_WEBDATASET_NOTES = """\
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

_HUGGINGFACE_NOTES = """\
`noisy` is the input of a denoiser, `clean` its target, `shadow` is 255 where no echo arrives. The
other columns say which frame a sample is of and every number that was drawn for it (NaN: not
drawn). Units and descriptions are in the metadata of the Parquet schema, too
(`pyarrow.parquet.read_schema(FILE).field("range_min_m").metadata`).

```python
from datasets import load_dataset

pairs = load_dataset("PATH_OF_THIS_FOLDER")
```
"""

_COCO_NOTES = f"""\
`annotations/instances_SPLIT.json` holds, in the format of COCO, the objects in the images of
`images/SPLIT`: box, area in pixels, and the mask as run lengths, which pycocotools reads
(`annToMask`); `--to yolo` has polygons. Objects that show in fewer than {LEAST_PX} pixels are left
out. `clean/SPLIT` has the same images without noise.

```python
from pycocotools.coco import COCO

objects = COCO("annotations/instances_train.json")
```
"""

_YOLO_NOTES = f"""\
`labels/SPLIT/NAME.txt` has a line for each object in `images/SPLIT/NAME.png`: its class (`names` of
`data.yaml`), then the corners of a polygon along the edges of its pixels, as fractions of width and
height. An object in parts that do not touch has a line for each part; holes are filled. Objects
that show in fewer than {LEAST_PX} pixels are left out. `data.yaml` takes the test split to
validate, or the only one that was exported. `clean/SPLIT` has the same images without
noise.

```sh
yolo segment train data=data.yaml   # or: yolo detect train
```
"""
