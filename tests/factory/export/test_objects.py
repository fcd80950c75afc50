"""Objects of exports, read back by pycocotools, and as YOLO's programs read their lines."""

from __future__ import annotations

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import yaml

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.export import export
from simnfnd.factory.export.objects import LEAST_PX, outlines, run_lengths
from simnfnd.factory.labels import CLASSES
from tests.factory.dataset.hostile import admit, reseal
from tests.factory.export.export_dataset import write

Masks = dict[str, dict[int, tuple[int, np.ndarray]]]


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Little pictures with ragged objects that have parts and holes, and a few tiny ones."""
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
    """(label, mask) of the objects that are large enough, picture for picture."""
    found = []
    for path in sorted((root / split).glob("*.h5")):
        with h5py.File(path) as file:
            for numbers in file["instance"][()]:
                masks = [(label, numbers == n) for n, label in ((3, 20), (41, 1), (700, 9))]
                found.append([(label, m) for label, m in masks if m.sum() >= LEAST_PX])
    return found


def test_coco_is_what_pycocotools_reads(labelled: Path, tmp_path: Path) -> None:
    from pycocotools.coco import COCO

    out = tmp_path / "out"
    said = export(labelled, "coco", out)
    everything = truth(labelled, "train") + truth(labelled, "test")
    assert said.startswith(f"12 pictures, {sum(map(len, everything))} objects; 12 below 8 pixels")
    for split, count in (("train", 9), ("test", 3)):
        coco = COCO(str(out / "annotations" / f"instances_{split}.json"))
        names = {one["id"]: one["name"] for one in coco.loadCats(coco.getCatIds())}
        assert names == {k: name for k, name in enumerate(CLASSES) if k}
        assert len(coco.getImgIds()) == count
        wanted = truth(labelled, split)
        for image, masks in zip(coco.loadImgs(sorted(coco.getImgIds())), wanted, strict=True):
            picture = cv2.imread(str(out / "images" / split / image["file_name"]), -1)
            assert picture is not None
            assert picture.shape == (image["height"], image["width"]) == (20, 16)
            assert (out / "clean" / split / image["file_name"]).is_file()
            found = coco.loadAnns(coco.getAnnIds(image["id"]))
            assert [one["category_id"] for one in found] == [label for label, _ in masks]
            for one, (_, mask) in zip(found, masks, strict=True):
                np.testing.assert_array_equal(coco.annToMask(one), mask)
                rows, columns = mask.nonzero()
                left, top, width, height = one["bbox"]
                assert (left, top) == (columns.min(), rows.min())
                assert (left + width, top + height) == (columns.max() + 1, rows.max() + 1)
                assert one["area"] == mask.sum()


def test_yolo_lines_are_the_objects(labelled: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export(labelled, "yolo", out)
    data = yaml.safe_load((out / "data.yaml").read_text())
    assert data["names"] == dict(enumerate(CLASSES[1:]))
    for key, split in (("train", "train"), ("val", "test")):
        pictures = sorted((out / data[key]).iterdir())
        for path, masks in zip(pictures, truth(labelled, split), strict=True):
            # Ultralytics finds the labels by these changes of the picture's name.
            place = Path(str(path).replace("/images/", "/labels/")).with_suffix(".txt")
            lines = [line.split() for line in place.read_text().splitlines()]
            assert {int(line[0]) + 1 for line in lines} == {label for label, _ in masks}
            filled = np.zeros((20, 16), bool)
            for line in lines:
                corners = np.array(line[1:], float).reshape(-1, 2)
                assert 0 <= corners.min() <= corners.max() <= 1
                assert len(corners) > 3
                filled |= covered(corners * (16, 20), (20, 16))
            for _, mask in masks:
                assert filled[mask].all()
            # Holes alone are filled beside.
            union = np.logical_or.reduce([mask for _, mask in masks], initial=False)
            rows, columns = union.nonzero()
            outside = filled.copy()
            outside[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = False
            assert not outside.any()


def covered(corners: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Pixels whose centres lie inside a polygon."""
    from pycocotools import mask as tool

    coded = tool.frPyObjects([corners.ravel().tolist()], *shape)
    return np.asarray(tool.decode(coded)[..., 0], bool)


@pytest.mark.parametrize("density", [0.1, 0.5, 0.9])
def test_run_lengths_and_outlines_lose_no_pixel(density: float) -> None:
    from pycocotools import mask as tool
    from scipy import ndimage

    rng = np.random.default_rng(2)
    for _ in range(20):
        rows, columns = (int(size) for size in rng.integers(1, 30, 2))
        mask = rng.random((rows, columns)) < density
        coded = tool.frPyObjects(run_lengths(mask), rows, columns)
        np.testing.assert_array_equal(tool.decode(coded), mask)
        rings = [covered(ring.astype(float), (rows, columns)) for ring in outlines(mask)]
        filled = np.logical_or.reduce(rings, initial=False)
        holes_filled = ndimage.binary_fill_holes(mask)
        np.testing.assert_array_equal(np.broadcast_to(filled, mask.shape), holes_filled)


def test_labels_that_name_no_class_are_refused(tmp_path: Path) -> None:
    root = write(tmp_path / "odd", labels=True)
    with h5py.File(root / "test/shard-00000.h5", "r+") as file:
        file["instance"][1] = 5
        file["segmentation"][1] = 200
        reseal(file)
    admit(root)
    with pytest.raises(FactoryError, match=r"odd: test-000001: /segmentation has a value 200"):
        export(root, "coco", tmp_path / "out", "test")


def test_without_labels_there_is_a_way_out(tmp_path: Path) -> None:
    plain = write(tmp_path / "plain")
    for to in ("coco", "yolo"):
        with pytest.raises(FactoryError, match=r"no labels.*dataset.layers=\[segmentation\]"):
            export(plain, to, tmp_path / "out")
