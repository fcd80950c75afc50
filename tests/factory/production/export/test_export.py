"""Every export is loaded back by the library of its own ecosystem and equals the source."""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import yaml

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.meaning import CLASSES
from simnfnd.factory.production.export import FORMATS, export
from simnfnd.factory.production.export.objects import MIN_OBJECT_PX
from simnfnd.factory.production.export.yolo import join_outlines, trace_outlines
from tests.factory.dataset.hostile import admit, reseal
from tests.factory.production.export import export_dataset
from tests.factory.production.export.export_dataset import COUNTS, write

TOTALS = {split: sum(counts) for split, counts in COUNTS.items()}


def stored(root: Path, split: str, name: str) -> np.ndarray:
    """All images of one layer, or the table, by h5py alone."""
    parts = []
    for path in sorted((root / split).glob("*.h5")):
        with h5py.File(path) as file:
            parts.append(file[name][:])
    return np.concatenate(parts)


def same_record(record: dict[str, Any], row: np.void) -> None:
    assert list(record) == list(row.dtype.names or ())
    for name, value in record.items():
        expected = row[name].decode() if isinstance(row[name], bytes) else row[name].item()
        if isinstance(expected, float) and math.isnan(expected):
            assert value is None or math.isnan(value), name
        else:
            assert value == expected, name


@pytest.fixture(scope="module")
def fans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("fans"), labels=True)


@pytest.fixture(scope="module")
def floats(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("floats"), dtype="float32")


@pytest.mark.parametrize("which", ["fans", "floats"])
def test_webdataset_gives_back_every_sample(which, request, tmp_path) -> None:
    import webdataset

    source = request.getfixturevalue(which)
    stated = export(source, "webdataset", tmp_path / "out")
    assert stated == "12 tars, 9 train samples and 3 test samples"
    for split, total in TOTALS.items():
        urls = [
            path.as_uri().replace("file://", "file:")
            for path in sorted((tmp_path / "out").glob(f"{split}-*.tar"))
        ]
        samples = list(webdataset.WebDataset(urls, shardshuffle=False).decode("l8"))
        assert [sample["__key__"] for sample in samples] == [
            f"{split}-{number:06d}" for number in range(total)
        ]
        table = stored(source, split, "meta")
        for name in ("noisy", "clean"):
            actual = [s.get(f"{name}.png", s.get(f"{name}.npy")) for s in samples]
            np.testing.assert_array_equal(np.stack(actual), stored(source, split, name))
            assert actual[0].dtype == stored(source, split, name).dtype
        shadow = np.stack([sample["shadow.png"] for sample in samples])
        np.testing.assert_array_equal(shadow > 0, stored(source, split, "shadow"))
        if which == "fans":
            for name, key in (("segmentation", "segmentation.png"), ("range", "range.npy")):
                actual = np.stack([sample[key] for sample in samples])
                np.testing.assert_array_equal(actual, stored(source, split, name))
        for sample, row in zip(samples, table, strict=True):
            same_record(sample["json"], row)


@pytest.mark.parametrize("which", ["fans", "floats"])
def test_load_dataset_gives_back_every_sample(which, request, monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setattr("simnfnd.factory.production.export.samples.SAMPLES_PER_FILE", 6)
    import datasets
    from pyarrow import parquet

    source = request.getfixturevalue(which)
    out = tmp_path / "out"
    export(source, "huggingface", out)
    assert sorted(path.name for path in (out / "data").iterdir()) == [
        "test-00000-of-00001.parquet",
        "train-00000-of-00002.parquet",
        "train-00001-of-00002.parquet",
    ]
    loaded = datasets.load_dataset(str(out), cache_dir=str(tmp_path / "cache"))
    assert {split: len(rows) for split, rows in loaded.items()} == TOTALS
    schema = parquet.read_schema(out / "data/test-00000-of-00001.parquet")
    about = schema.field("range_max_m").metadata
    assert about == {b"units": b"m", b"description": b""}
    assert b"input of a denoiser" in schema.field("noisy").metadata[b"description"]
    for split, rows in loaded.items():
        assert isinstance(rows.features["shadow"], datasets.Image)
        samples = list(rows.with_format(None))
        for name in ("noisy", "clean"):
            expected = stored(source, split, name)
            actual = np.stack([np.asarray(s[name], dtype=expected.dtype) for s in samples])
            np.testing.assert_array_equal(actual, expected)
        shadow = np.stack([np.asarray(sample["shadow"]) for sample in samples])
        np.testing.assert_array_equal(shadow > 0, stored(source, split, "shadow"))
        if which == "fans":
            objects = rows.features["objects"]
            assert isinstance(objects["category"].feature, datasets.ClassLabel)
            for name in ("segmentation", "instance", "range"):
                actual = np.stack([np.asarray(sample[name]) for sample in samples])
                np.testing.assert_array_equal(actual, stored(source, split, name))
        columns = [column.name for column in export_dataset.COLUMNS]
        for sample, row in zip(samples, stored(source, split, "meta"), strict=True):
            same_record({name: sample[name] for name in columns}, row)


@pytest.mark.parametrize("which", ["fans", "floats"])
def test_png_pairs_are_the_images(which, request, tmp_path) -> None:
    source = request.getfixturevalue(which)
    stated = export(source, "png", tmp_path / "out")
    assert ("range" in stated) == (which == "fans")  # what no PNG holds is said
    for split, total in TOTALS.items():
        folder = tmp_path / "out" / split
        for name in ("noisy", "clean", "shadow"):
            files = sorted((folder / name).iterdir())
            assert [file.name for file in files] == [f"{k:06d}.png" for k in range(total)]
            actual = np.stack([cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files])
            expected = stored(source, split, name)
            if name == "shadow":
                np.testing.assert_array_equal(actual, expected * np.uint8(255))
            elif which == "fans":
                np.testing.assert_array_equal(actual, expected)
                assert actual.dtype == np.uint8
            else:
                # 16 bits: half a step of rounding and no more.
                assert actual.dtype == np.uint16
                assert np.abs(actual / 65535 - expected.astype(float)).max() <= 0.5001 / 65535
        with (folder / "samples.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert [row["file"] for row in rows] == [f"{k:06d}.png" for k in range(total)]
        table = stored(source, split, "meta")
        assert [row["frame"].encode() for row in rows] == list(table["frame"])
        assert [float(row["range_max_m"]) for row in rows] == list(table["range_max_m"])


# The others need tracks (test_tracks.py) or the device's geometry (test_robots.py).
@pytest.mark.parametrize(
    "to", [name for name in FORMATS if name not in ("mot", "coco_video", "mcap", "ply")]
)
def test_the_same_dataset_gives_the_same_bytes(to, tmp_path, fans) -> None:
    for name in ("one", "two"):
        export(fans, to, tmp_path / name)
    files = [path for path in sorted((tmp_path / "one").rglob("*")) if path.is_file()]
    assert len(files) > 2
    for path in files:
        twin = tmp_path / "two" / path.relative_to(tmp_path / "one")
        assert path.read_bytes() == twin.read_bytes(), path.name


@pytest.mark.parametrize(
    ("to", "package"), [("webdataset", "webdataset"), ("huggingface", "pyarrow")]
)
def test_an_absent_library_is_named_with_its_cure(to, package, monkeypatch, tmp_path, fans) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(FactoryError, match=rf'{package}.*pip install "simnfnd\[export\]"'):
        export(fans, to, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_shard_leaves_no_half_export(tmp_path) -> None:
    source = write(tmp_path / "source")
    path = source / "train/shard-00001.h5"
    with h5py.File(path) as file:
        at = file["noisy"].id.get_chunk_info(2)
    content = bytearray(path.read_bytes())
    content[at.byte_offset + 20] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(FactoryError, match=r"shard-00001.h5: /noisy sample 2 is damaged"):
        export(source, "png", tmp_path / "out")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["source"]


Masks = dict[str, dict[int, tuple[int, np.ndarray]]]


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Little images with ragged objects that have parts and holes, and a few tiny ones."""
    root = write(tmp_path_factory.mktemp("labelled"), labels=True)
    rng = np.random.default_rng(5)
    for path in sorted(root.glob("*/*.h5")):
        with h5py.File(path, "r+") as file:
            for row in range(len(file["instance"])):
                ragged = cv2.GaussianBlur(rng.random((20, 16)), (0, 0), 1.0) > 0.5
                numbers = np.zeros((20, 16), np.uint16)
                numbers[:12, :9] = 700
                numbers[:12, 9:] = 3
                numbers *= ragged
                numbers[16, 2:4] = 41
                file["instance"][row] = numbers
                file["segmentation"][row] = np.select(
                    [numbers == 700, numbers == 3, numbers == 41], [9, 20, 1], 0
                )
            reseal(file)
    admit(root)
    return root


def truth(root: Path, split: str) -> list[list[tuple[int, np.ndarray]]]:
    """(label, mask) of the objects that are large enough, image for image."""
    actual = []
    for path in sorted((root / split).glob("*.h5")):
        with h5py.File(path) as file:
            for numbers in file["instance"][()]:
                masks = [(label, numbers == n) for n, label in ((3, 20), (41, 1), (700, 9))]
                actual.append([(label, m) for label, m in masks if m.sum() >= MIN_OBJECT_PX])
    return actual


def test_coco_is_what_pycocotools_reads(labelled: Path, tmp_path: Path) -> None:
    from pycocotools.coco import COCO

    out = tmp_path / "out"
    said = export(labelled, "coco", out)
    everything = truth(labelled, "train") + truth(labelled, "test")
    assert said.startswith(f"12 images, {sum(map(len, everything))} objects of 2 classes; 12 ")
    for split, count in (("train", 9), ("test", 3)):
        coco = COCO(str(out / "annotations" / f"instances_{split}.json"))
        names = {
            annotation["id"]: annotation["name"] for annotation in coco.loadCats(coco.getCatIds())
        }
        assert names == {1: "Tire", 2: "Barrel"}  # those that occur
        assert len(coco.getImgIds()) == count
        wanted = truth(labelled, split)
        for image, masks in zip(coco.loadImgs(sorted(coco.getImgIds())), wanted, strict=True):
            pixels = cv2.imread(str(out / "images" / split / image["file_name"]), -1)
            assert pixels is not None
            assert pixels.shape == (image["height"], image["width"]) == (20, 16)
            assert (out / "clean" / split / image["file_name"]).is_file()
            actual = coco.loadAnns(coco.getAnnIds(image["id"]))
            assert [names[annotation["category_id"]] for annotation in actual] == [
                CLASSES[label] for label, _ in masks
            ]
            for annotation, (_, mask) in zip(actual, masks, strict=True):
                np.testing.assert_array_equal(coco.annToMask(annotation), mask)
                rows, columns = mask.nonzero()
                left, top, width, height = annotation["bbox"]
                assert (left, top) == (columns.min(), rows.min())
                assert (left + width, top + height) == (columns.max() + 1, rows.max() + 1)
                assert annotation["area"] == mask.sum()


def ultralytics_boxes(image_path: Path, class_count: int) -> np.ndarray:
    """The boxes (N, 5) of a label file: class, left, top, right, bottom as fractions.

    Refuses what `verify_image_label` of Ultralytics refuses or leaves out.
    """
    assert image_path.suffix == ".png"
    # Ultralytics finds the labels by these changes of the image's name.
    label_path = Path(str(image_path).replace("/images/", "/labels/")).with_suffix(".txt")
    rows = []
    for line in label_path.read_text().splitlines():
        values = np.array(line.split(), np.float32)
        assert values.size >= 7  # a polygon of three corners
        assert values.size % 2 == 1
        corners = values[1:].reshape(-1, 2)
        assert corners.min() >= 0
        assert corners.max() <= 1
        assert 0 <= values[0] < class_count
        assert values[0] == int(values[0])
        rows.append([values[0], *corners.min(axis=0), *corners.max(axis=0)])
    boxes = np.array(rows, np.float32).reshape(-1, 5)
    assert len(np.unique(boxes, axis=0)) == len(boxes)  # duplicates are removed
    return boxes


def test_a_line_of_yolo_is_an_object_of_coco(labelled: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    said = export(labelled, "yolo", out)
    everything = truth(labelled, "train") + truth(labelled, "test")
    assert said.startswith(f"12 images, {sum(map(len, everything))} objects of 2 classes; 12 ")
    data = yaml.safe_load((out / "data.yaml").read_text())
    assert data["names"] == {0: "Tire", 1: "Barrel"}
    for key, split in (("train", "train"), ("val", "test")):
        images = sorted((out / data[key]).iterdir())
        for path, masks in zip(images, truth(labelled, split), strict=True):
            boxes = ultralytics_boxes(path, len(data["names"]))
            assert [data["names"][int(box[0])] for box in boxes] == [CLASSES[m[0]] for m in masks]
            for box, (_, mask) in zip(boxes, masks, strict=True):
                rows, columns = mask.nonzero()
                sides = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
                np.testing.assert_allclose(box[1:] * (16, 20, 16, 20), sides, atol=1e-4)


def test_the_parts_of_an_object_are_one_polygon() -> None:
    mask = np.zeros((12, 30), bool)
    mask[1:4, 1:6] = mask[6:10, 3:8] = mask[2:5, 14:20] = mask[8:11, 25:28] = True
    polygon = join_outlines(trace_outlines(mask))
    np.testing.assert_array_equal(covered(polygon.astype(float), (12, 30)), mask)
    # Every bridge is crossed twice, so the joined polygon has the area of the parts.
    x, y = polygon.T
    area = abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    assert area == mask.sum()


def test_chosen_classes_are_numbered_as_asked(labelled: Path, tmp_path: Path) -> None:
    export(labelled, "coco", tmp_path / "coco", class_names=("Barrel", "Anchor"))
    document = json.loads((tmp_path / "coco/annotations/instances_train.json").read_text())
    assert [entry["name"] for entry in document["categories"]] == ["Barrel", "Anchor"]
    barrels = [mask for masks in truth(labelled, "train") for label, mask in masks if label == 20]
    assert [entry["category_id"] for entry in document["annotations"]] == [1] * len(barrels)
    with pytest.raises(FactoryError, match="Submarine"):
        export(labelled, "yolo", tmp_path / "yolo", class_names=("Submarine",))
    with pytest.raises(FactoryError, match="twice"):
        export(labelled, "yolo", tmp_path / "yolo", class_names=("Tire", "Tire"))
    with pytest.raises(FactoryError, match="--classes"):
        export(labelled, "png", tmp_path / "png", class_names=("Tire",))


def test_objects_are_lists_as_of_the_hub(labelled: Path, tmp_path: Path) -> None:
    from datasets import ClassLabel, Features
    from pyarrow import parquet

    export(labelled, "huggingface", tmp_path / "out")
    table = parquet.read_table(tmp_path / "out/data/train-00000-of-00001.parquet")
    rows = table.column("objects").to_pylist()
    expected = truth(labelled, "train")
    for row, objects in zip(rows, expected, strict=True):
        assert row["area"] == [int(mask.sum()) for _, mask in objects]
        assert len(row["bbox"]) == len(row["category"]) == len(objects)
        for box, (_, mask) in zip(row["bbox"], objects, strict=True):
            assert box[2:] == [np.ptp(axis) + 1 for axis in mask.nonzero()[::-1]]
    assert any(row["area"] for row in rows)
    category = Features.from_arrow_schema(table.schema)["objects"]["category"].feature
    assert isinstance(category, ClassLabel)
    assert category.names == ["Tire", "Barrel"]
    # Versions of the library before 4.0 know no other name for a list.
    assert b'"List"' not in table.schema.metadata[b"huggingface"]


def covered(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Pixels whose centres lie inside a polygon."""
    from pycocotools import mask as tool

    coded = tool.frPyObjects([corners.ravel().tolist()], *shape)
    return np.asarray(tool.decode(coded)[..., 0], bool)


def test_labels_that_name_no_class_are_refused(tmp_path: Path) -> None:
    root = write(tmp_path / "odd", labels=True)
    with h5py.File(root / "test/shard-00000.h5", "r+") as file:
        file["instance"][1] = 5
        file["segmentation"][1] = 200
        reseal(file)
    admit(root)
    with pytest.raises(FactoryError, match=r"test-000001: /segmentation .*200"):
        export(root, "coco", tmp_path / "out", "test")


def test_without_labels_there_is_a_way_out(tmp_path: Path) -> None:
    plain = write(tmp_path / "plain")
    for to in ("coco", "yolo"):
        with pytest.raises(FactoryError, match=r"no labels.*dataset.layers=\[segmentation\]"):
            export(plain, to, tmp_path / "out")
