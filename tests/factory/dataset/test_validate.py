"""Validation, and what becomes of datasets that were damaged or made to do harm."""

from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.isolated import IsolatedProcess
from simnfnd.factory.dataset.manifest import load_manifest, save_manifest
from simnfnd.factory.dataset.schema import Pair, config_hash
from simnfnd.factory.dataset.validate import Report, validate
from simnfnd.factory.dataset.writer import write_index
from tests.factory.dataset.hostile import (
    OBJECTS,
    PROVENANCE,
    admit,
    check,
    reseal,
    whole,
    with_layers,
)
from tests.factory.dataset.some_shards import some_pairs, write


@pytest.fixture(scope="module")
def reader() -> IsolatedProcess:
    return IsolatedProcess()


def add(folder: Path, relative: str, pairs: list[Pair]) -> None:
    """One more shard, in manifest and index."""
    info = write(folder, pairs, relative, PROVENANCE)
    manifest = load_manifest(folder)
    assert info is not None
    assert manifest is not None
    save_manifest(folder, manifest.with_shard(info))
    write_index(folder, manifest.with_shard(info))


def layered(scene: str, first: int = 0, **changes: Any) -> list[Pair]:
    """Two pairs with layers."""
    return [replace(with_layers(pair), **changes) for pair in some_pairs(first + 2, scene)[first:]]


def errors(report: Report) -> str:
    return "\n".join(report.errors)


def test_the_command_says_it_with_its_exit_code(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*words: str) -> tuple[int, str]:
        code = main(["validate", *words])
        said = capsys.readouterr()
        return code, said.out + said.err

    for deep in ([], ["--deep"]):
        code, said = run(str(folder), *deep)
        assert code == 0
        assert said.splitlines()[-1].startswith(f"valid: {folder}: 12 samples in 3 shards")
    (folder / "train/shard-00001.h5").write_bytes(b"no")
    code, said = run(str(folder))
    assert code == 1
    assert "error: train/shard-00001.h5: 2 bytes, the manifest says" in said
    assert "invalid: " in said.splitlines()[-1]
    code, said = run(str(folder / "train"))
    assert code == 2
    assert "manifest.json" in said


def test_leaks_and_samples_twice_are_found(folder: Path) -> None:
    clean = some_pairs(1)[0].clean
    add(folder, "test/shard-00001.h5", layered("delta", clean=clean))
    assert errors(validate(folder)) == ""
    assert "1 clean image(s) are in train and in test" in errors(validate(folder, True))
    add(folder, "test/shard-00001.h5", layered("alpha", 10))
    add(folder, "train/shard-00002.h5", layered("beta", 2))
    text = errors(validate(folder, True))
    assert "1 scene(s) both train and test: reef/alpha" in text
    assert "sample 0 has the same name as train/shard-00001.h5 sample 2" in text
    assert "sample 1 has the same noisy image as train/shard-00001.h5 sample 3" in text


IMPOSSIBLE = (
    ("noisy", np.nan, "sample 1: /noisy has values outside 0..1, or NaN"),
    ("clean", 1.5, "/clean has values outside 0..1"),
    ("elevation", 2.0, "/elevation has values outside -1.5708..1.5708"),
    ("range", -1.0, "/range has values outside 0..inf"),
    ("segmentation", 200, "/segmentation has class 200; the schema knows 21"),
)


def test_values_that_cannot_be_are_found(tmp_path: Path) -> None:
    root = whole(tmp_path / "dataset", dtype="float32")
    with h5py.File(root / "train/shard-00001.h5", "r+") as file:
        for layer, value, _ in IMPOSSIBLE:
            file[layer][1, 3, 4] = value
        reseal(file)
    admit(root)
    assert errors(validate(root, False)) == ""
    found = errors(validate(root, True))
    assert not [words for _, _, words in IMPOSSIBLE if words not in found]


def test_what_is_not_as_the_manifest_says_is_found(folder: Path) -> None:
    manifest = load_manifest(folder)
    assert manifest is not None
    info = manifest.shards["test/shard-00000.h5"]
    manifest = manifest.with_shard(replace(info, samples=3))
    save_manifest(folder, replace(manifest, config_hash=config_hash({}), config={}))
    report = validate(folder, False)
    text = "\n".join(report.findings)
    assert "error: test/shard-00000.h5: 4 samples, the manifest says 3" in text
    assert "error: train/shard-00000.h5: is of another configuration" in text


def test_a_shard_of_another_form_is_found(folder: Path) -> None:
    info = write(folder, some_pairs(1, "delta"), "train/shard-00002.h5", PROVENANCE)
    manifest = load_manifest(folder)
    assert info is not None
    assert manifest is not None
    save_manifest(folder, manifest.with_shard(info))
    assert "train/shard-00002.h5: has another form than" in errors(validate(folder, False))


def edit_manifest(folder: Path, **changes: Any) -> None:
    """Change values of manifest.json as a text editor would; None removes a key."""
    path = folder / "manifest.json"
    document = {**json.loads(path.read_text()), **changes}
    path.write_text(
        json.dumps({key: value for key, value in document.items() if value is not None})
    )


@pytest.mark.parametrize("key", ["samples", "shards", "bytes"])
def test_totals_are_those_of_the_listed_shards(folder: Path, key: str) -> None:
    totals = json.loads((folder / "manifest.json").read_text())["totals"]
    assert not validate(folder).errors
    totals["test"][key] += 1
    edit_manifest(folder, totals=totals)
    (error,) = validate(folder).errors
    assert error.startswith("error: manifest.json: its totals are not ")
    edit_manifest(folder, totals=None)
    (error,) = validate(folder).errors
    assert error.startswith("error: manifest.json: its totals are not ")


def test_every_listed_shard_is_opened(folder: Path) -> None:
    for relative in ("train/shard-00000.h5", "train/shard-00001.h5", "test/shard-00000.h5"):
        content = (folder / relative).read_bytes()
        (folder / relative).unlink()
        (error,) = validate(folder).errors
        assert error.startswith(f"error: {relative}: listed in the manifest but absent")
        (folder / relative).write_bytes(content)


def test_stray_and_missing_files_are_named(folder: Path) -> None:
    shutil.copy(folder / "train/shard-00000.h5", folder / "test/shard-00009.h5")
    shutil.copy(folder / "train/shard-00000.h5", folder / "train/copy of 0.h5")
    (folder / "train/shard-00001.json").write_text("{}")
    (folder / "train/notes\x1b[2J.txt").write_text("mine")
    (folder / "old").mkdir()
    (folder / "config.yaml").unlink(missing_ok=True)
    report = validate(folder)
    named = [tuple(finding.split(": ")[:2]) for finding in report.findings]
    assert ("error", "test/shard-00009.h5") in named
    assert ("error", "train/copy of 0.h5") in named
    assert ("note", "train/shard-00001.json") in named
    assert ("note", "train/notes?[2J.txt") in named
    assert ("note", "old/") in named
    assert ("note", "config.yaml") in named
    assert len(report.errors) == 2


def test_an_index_without_its_hash_is_refused(folder: Path) -> None:
    edit_manifest(folder, index_sha256=None)
    (error,) = validate(folder).errors
    assert error.startswith("error: index.h5: ")
    (folder / "index.h5").unlink()
    assert not validate(folder).errors


def test_a_dataset_without_samples_is_not_valid(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest = load_manifest(folder)
    assert manifest is not None
    empty = tmp_path / "empty"
    empty.mkdir()
    save_manifest(empty, replace(manifest, shards={}, index_sha256=""))
    assert main(["validate", str(empty)]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("invalid: ")


def test_a_shard_whose_config_contradicts_its_hash_is_refused(folder: Path) -> None:
    relative = "train/shard-00001.h5"
    with h5py.File(folder / relative, "r+") as file:
        file.attrs["config"] = '{"seed":8}'
        reseal(file)
    admit(folder)
    (error,) = validate(folder).errors
    assert error.startswith(f"error: {relative}: ")
    assert "config_hash" in error


def test_a_shard_of_another_part_than_the_manifest_says_is_refused(folder: Path) -> None:
    manifest = load_manifest(folder)
    assert manifest is not None
    relative = "train/shard-00001.h5"
    info = replace(manifest.shards[relative], config_hash="0" * 16)
    save_manifest(folder, manifest.with_shard(info))
    admit(folder)
    (error,) = validate(folder).errors
    assert error.startswith(f"error: {relative}: its config_hash is ")


def test_a_place_in_both_splits_is_refused_however_it_is_written(folder: Path) -> None:
    add(folder, "test/shard-00001.h5", layered("ALPHA", 10))
    (error,) = validate(folder).errors
    assert error.startswith("error: manifest.json: 1 scene(s) both train and test: reef/alpha")


def test_scenes_of_one_location_in_both_splits_are_noted(folder: Path) -> None:
    report = validate(folder)
    assert not report.errors
    assert [line for line in report.findings if "1 location(s)" in line and "reef" in line]


def test_pairs_without_noise_are_warned_about(folder: Path) -> None:
    pairs = layered("delta")
    pairs[1] = replace(pairs[1], noisy=pairs[1].clean)
    add(folder, "train/shard-00002.h5", pairs)
    report = validate(folder)
    assert not report.errors
    (warning,) = (line for line in report.findings if line.startswith("warning: "))
    assert "1 sample(s)" in warning
    assert "train/shard-00002.h5 sample 1" in warning


@pytest.mark.parametrize("kind", sorted(OBJECTS))
def test_no_object_that_the_schema_has_not_is_read(
    folder: Path, reader: IsolatedProcess, kind: str
) -> None:
    with h5py.File(folder / "train/shard-00000.h5", "r+") as file:
        OBJECTS[kind](file, "noisy", (folder.parent / "secret.h5").resolve())
    admit(folder)
    read, found = check(folder, reader)
    # Two grey images that changed names are as good as any others, to a program.
    if kind != "swapped names":
        assert read.startswith("refused: "), read
        assert found != "valid"
        assert "train/shard-00000.h5" in read.replace("\\", "/")


def test_what_happens_in_the_isolated_process_is_reported(reader: IsolatedProcess) -> None:
    with pytest.raises(FactoryError, match="crashes"):
        reader.call(os.abort, limit_s=5.0)
    with pytest.raises(FactoryError, match=r"not read within 0\.5 s"):
        reader.call(time.sleep, 60, limit_s=0.5)
    with pytest.raises(FactoryError, match="more memory"):
        reader.call(bytes, 1 << 36, limit_s=5.0)
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        reader.call(divmod, 1, 0, limit_s=5.0)
    assert reader.call(divmod, 7, 2, limit_s=5.0) == [3, 1]
