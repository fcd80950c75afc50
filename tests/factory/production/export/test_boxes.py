"""Boxes by convention and objects by visibility, from a dataset to its exports."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.manifest import Manifest, save_manifest
from simnfnd.factory.dataset.schema import Provenance, config_hash
from simnfnd.factory.dataset.writer import write_shard
from simnfnd.factory.production.export import export
from simnfnd.factory.production.export.object_boxes import parse_places
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.pairs.pair_maker import PairMaker
from simnfnd.factory.simulation.pairs.views import Views
from tests.factory.production.export import export_dataset
from tests.factory.simulation.labels.test_beam_edge import frame_of, image_of, settings, shapes


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One image of a tyre with all that the conventions need."""
    root = tmp_path_factory.mktemp("boxes")
    config = settings()
    pair = image_of(frame_of(shapes()["tyre"], -2.0, 2.6), config)
    maker = PairMaker(config, Views({}))
    values = identity(config)
    provenance = Provenance(values, config_hash(values), "simnfnd 0.1.0")
    path = "train/shard-00000.h5"
    info = write_shard(
        root, path, [pair], maker.axes(), maker.columns(), provenance, config.dataset
    )
    assert info is not None
    manifest = Manifest(provenance.config_hash, provenance.generator, values)
    save_manifest(root, manifest.with_shard(info))
    block = {"name": "boxes", "licence": None, "dtype": "uint8"}
    (root / "config.yaml").write_text(yaml.safe_dump({**values, "dataset": block}))
    return root


def coco_annotations(folder: Path) -> list[dict[str, Any]]:
    document = json.loads((folder / "annotations" / "instances_train.json").read_text())
    listed: list[dict[str, Any]] = document["annotations"]
    return listed


def test_coco_has_the_boxes_of_the_convention(dataset: Path, tmp_path: Path) -> None:
    boxes: dict[str, list[int]] = {}
    for convention in ("echo", "echo+shadow", "object"):
        export(dataset, "coco", tmp_path / convention, box=convention)
        (annotation,) = coco_annotations(tmp_path / convention)
        boxes[convention] = list(annotation["bbox"])
        assert f"`{convention}`" in (tmp_path / convention / "README.md").read_text()
    left, top, width, height = boxes["echo"]
    assert boxes["echo+shadow"][1] < top - 5
    assert boxes["echo+shadow"][1] + boxes["echo+shadow"][3] == top + height
    assert boxes["object"][2] >= width
    assert boxes["object"][3] >= height
    assert boxes["object"] != boxes["echo"]
    assert left >= 0


def test_yolo_has_the_corners_of_the_box(dataset: Path, tmp_path: Path) -> None:
    export(dataset, "coco", tmp_path / "coco", box="echo+shadow")
    export(dataset, "yolo", tmp_path / "yolo", box="echo+shadow")
    (annotation,) = coco_annotations(tmp_path / "coco")
    left, top, width, height = annotation["bbox"]
    (line,) = next((tmp_path / "yolo" / "labels").glob("*/*.txt")).read_text().splitlines()
    corners = np.array(line.split()[1:], float).reshape(-1, 2) * 256
    np.testing.assert_allclose(corners.min(axis=0), [left, top], atol=1e-3)
    np.testing.assert_allclose(corners.max(axis=0), [left + width, top + height], atol=1e-3)


def test_faint_objects_are_left_out_and_counted(dataset: Path, tmp_path: Path) -> None:
    assert "1 objects" in export(dataset, "coco", tmp_path / "shown", min_visibility_db=3)
    summary = export(dataset, "coco", tmp_path / "faint", min_visibility_db=60)
    assert "0 objects" in summary
    assert "1 fainter than 60 dB" in summary
    assert coco_annotations(tmp_path / "faint") == []


def test_what_a_dataset_cannot_give_is_refused(tmp_path: Path) -> None:
    plain = export_dataset.write(tmp_path / "plain", labels=True)
    out = tmp_path / "out"
    with pytest.raises(FactoryError, match="--min-visibility"):
        export(plain, "coco", out, min_visibility_db=3)
    with pytest.raises(FactoryError, match="--box object"):
        export(plain, "coco", out, box="object")
    with pytest.raises(FactoryError, match="--box shadow"):
        export(plain, "coco", out, box="shadow")
    with pytest.raises(FactoryError, match="--to mot"):
        export(plain, "mot", out, box="object")
    assert not out.exists()


@pytest.mark.parametrize("text", ["{", "3", '[{"instance": 1}]', '[{"range_m": [1, 2]}]'])
def test_a_damaged_column_is_one_line(text: str) -> None:
    with pytest.raises(FactoryError, match="column boxes"):
        parse_places(text, "here")
