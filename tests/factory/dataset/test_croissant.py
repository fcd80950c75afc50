"""croissant.json is valid for mlcroissant, tells the truth, and its records load."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from simnfnd.factory.dataset.describe.card import PAPER, write_card
from simnfnd.factory.dataset.describe.croissant import write_croissant
from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.errors import FactoryError
from tests.factory.export.export_dataset import write


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = write(tmp_path_factory.mktemp("croissant"), labels=True)
    describe(root)
    return root


def describe(root: Path, licence: str | None = "CC-BY-4.0") -> dict[str, Any]:
    manifest = load_manifest(root)
    assert manifest is not None
    path = write_croissant(root, manifest, DatasetSettings(name="little", licence=licence))
    stated: dict[str, Any] = json.loads(path.read_text())
    return stated


def test_mlcroissant_finds_no_fault(dataset) -> None:
    import mlcroissant

    assert faults(dataset) == []
    metadata = mlcroissant.Dataset(jsonld=str(dataset / "croissant.json")).metadata
    assert metadata.name == "little"
    assert metadata.license == ["CC-BY-4.0"]


def test_the_check_above_finds_faults(dataset, tmp_path) -> None:
    text = (dataset / "croissant.json").read_text()
    assert '"shards/sha256"' in text
    broken = text.replace('"sha256": "', '"sha512": "')
    (tmp_path / "croissant.json").write_text(broken)
    with pytest.raises(Exception, match="sha256"):
        faults(tmp_path)


def test_mlcroissant_loads_the_shards(dataset) -> None:
    import mlcroissant

    records = list(mlcroissant.Dataset(jsonld=str(dataset / "croissant.json")).records("shards"))
    manifest = load_manifest(dataset)
    assert manifest is not None
    assert [record["shards/path"].decode() for record in records] == sorted(manifest.shards)
    for record in records:
        shard = manifest.shards[record["shards/path"].decode()]
        assert record["shards/samples"] == shard.samples
        assert record["shards/sha256"].decode() == shard.sha256


def test_every_file_is_there_with_its_checksum(dataset) -> None:
    stated = json.loads((dataset / "croissant.json").read_text())
    listed = {file["contentUrl"]: file for file in stated["distribution"]}
    shards = {str(path.relative_to(dataset)) for path in dataset.glob("*/*.h5")}
    assert set(listed) == {"manifest.json", *shards}
    for name, file in listed.items():
        content = (dataset / name).read_bytes()
        assert file["sha256"] == hashlib.sha256(content).hexdigest()
        assert file["contentSize"] == f"{len(content)} B"


def test_pictures_and_columns_are_explained(dataset) -> None:
    stated = json.loads((dataset / "croissant.json").read_text())
    variables = {item["name"]: item for item in stated["variableMeasured"]}
    assert {"/noisy", "/clean", "/shadow", "/range", "/segmentation"} <= set(variables)
    assert variables["/range"]["unitText"] == "m"
    assert variables["/meta range_max_m"]["unitText"] == "m"
    assert "20 x 16 pixels" in variables["/noisy"]["description"]


def test_the_card_explains_the_pictures_and_cites_the_paper(dataset) -> None:
    manifest = load_manifest(dataset)
    assert manifest is not None
    provenance = Provenance(manifest.config, manifest.config_hash, manifest.generator)
    card = write_card(dataset, manifest, provenance, DatasetSettings(licence="MIT")).read_text()
    pictures = card.split("## Pictures")[1].split("##")[0].strip().splitlines()[2:]
    names = [line.split("|")[1].strip(" `") for line in pictures]
    assert names == ["/noisy", "/clean", "/shadow", "/range", "/segmentation", "/instance"]
    assert "| float32 | m |" in next(line for line in pictures if "/range" in line)
    assert PAPER in card


def test_a_licence_is_told_only_when_it_was_given(tmp_path) -> None:
    root = write(tmp_path)
    assert "license" not in describe(root, None)
    one = (root / "croissant.json").read_bytes()
    describe(root, None)
    assert (root / "croissant.json").read_bytes() == one
    assert faults(root) == []


def faults(root: Path) -> list[str]:
    """What mlcroissant finds wrong, without what the factory cannot know: who, where, when."""
    import mlcroissant

    issues = mlcroissant.Dataset(jsonld=str(root / "croissant.json")).metadata.ctx.issues
    unknown = ("creator", "datePublished", "license", "url")
    return [
        issue
        for issue in [*issues.errors, *issues.warnings]
        if not any(f'"https://schema.org/{word}" is recommended' in issue for word in unknown)
    ]


def test_an_unreadable_shard_is_named(tmp_path) -> None:
    root = write(tmp_path)
    (root / "test/shard-00000.h5").write_bytes(b"no")
    with pytest.raises(FactoryError, match=r"test/shard-00000.h5: not a readable HDF5 file"):
        describe(root)
