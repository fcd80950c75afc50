"""A shard and its settings: what a stranger with h5py alone relies on."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.manifest import damage
from simnfnd.factory.dataset.meaning import CLASSES
from simnfnd.factory.dataset.schema import OPTIONAL_LAYERS, ROOT_ATTRIBUTES, layers
from simnfnd.factory.simulation.noise.registry import NoiseSettings
from simnfnd.factory.simulation.pairs.requested_columns import requested
from simnfnd.factory.simulation.pairs.sample_table import columns
from tests.factory.dataset.hostile import whole
from tests.factory.dataset.some_shards import PROVENANCE, SOURCE, some_pairs, write
from tests.project.page_steps import run, steps
from tests.project_files import ROOT


def test_h5py_alone_reads_back_what_was_written(tmp_path: Path) -> None:
    pairs = some_pairs(3)
    info = write(tmp_path, iter(pairs))
    assert info is not None
    with h5py.File(tmp_path / info.path, "r") as file:
        assert set(file) == {"noisy", "clean", "shadow", "meta", "axes", "checksums"}
        for name in ("noisy", "clean", "shadow"):
            stack = file[name]
            np.testing.assert_array_equal(stack[:], [getattr(pair, name) for pair in pairs])
            assert stack.chunks == (1, 24, 20)
            assert (stack.compression, stack.compression_opts) == ("gzip", 1)
            assert stack.fletcher32
            assert not stack.shuffle
            assert [dimension.label for dimension in stack.dims] == ["sample", "ahead", "right"]
            for dimension, axis in enumerate(SOURCE.axes(), start=1):
                scale = stack.dims[dimension][0]
                assert scale.name == f"/axes/{axis.name}"
                assert scale.attrs["units"] == "m"
                np.testing.assert_array_equal(scale[:], axis.values)
        assert (file["noisy"].dtype, file["shadow"].dtype) == (np.uint8, np.bool_)
        table = file["meta"][:]
        assert table.dtype.names == tuple(column.name for column in SOURCE.columns())
        for row, pair in zip(table, pairs, strict=True):
            for name, value in pair.record.items():
                stored = row[name].decode() if isinstance(value, str) else row[name]
                assert stored == value
        assert file["meta"].attrs["noise.background.density.units"] == "1"
        assert file.attrs["schema"] == "simnfnd/1"
        assert file.attrs["split"] == "train"
        assert file.attrs["generator"] == "simnfnd 0.1.0"
        assert file.attrs["config_hash"] == PROVENANCE.config_hash
        assert json.loads(file.attrs["config"]) == PROVENANCE.config
        assert list(file.attrs["value_range"]) == [0, 255]
    assert info.samples == 3
    assert info.split == "train"
    assert damage(tmp_path, info) is None


def test_bytes_repeat_in_another_second(tmp_path: Path) -> None:
    first = write(tmp_path / "one")
    time.sleep(1.1)  # HDF5's time stamps, which must not be there, count seconds
    assert first is not None
    assert first == write(tmp_path / "two")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"noisy": np.zeros((24, 21), np.uint8)}, "noisy is (24, 21); expected (24, 20)"),
        ({"clean": np.zeros((24, 20), np.float64)}, "clean is float64"),
        ({"clean": np.full((24, 20), np.nan, np.float32)}, "or NaN"),
        ({"noisy": np.full((24, 20), 1.5, np.float32)}, "outside 0..1"),
        ({"shadow": np.zeros((24, 20), np.uint8)}, "shadow is uint8"),
        ({"scene": "a-name-of-17-byte"}, "column scene is text of at most 16 bytes and cannot"),
        ({"variant": 2**31}, "column variant is int32"),
        ({"variant": 0.5}, "column variant is int32"),
        ({"frame": "\udcff"}, "column frame is text"),
        ({"extra": 1}, "disagree about extra"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, changes: dict[str, Any], message: str
) -> None:
    pair = some_pairs(1)[0]
    images = changes.keys() <= {"noisy", "clean", "shadow"}
    pair = replace(pair, **(changes if images else {"record": {**pair.record, **changes}}))
    with pytest.raises(FactoryError) as caught:
        write(tmp_path, [pair])
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.rglob("*.h5"))


PAGE = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8")
PYTHON = [step for step in steps(ROOT / "docs" / "dataset.md") if step.kind == "python"]


def test_every_layer_column_and_attribute_is_documented() -> None:
    """By its name; layers with their meaning, which files state for columns, too."""
    requested_columns = requested(
        ("pose", "intrinsics", "calibration", "boxes", "visibility", "tracks")
    )
    names = [
        *(f"/{entry.name}" for entry in (*layers("uint8"), *OPTIONAL_LAYERS)),
        *(entry.name for entry in columns(NoiseSettings()) if not entry.name.startswith("noise.")),
        *(entry.name for entry in requested_columns),
        *ROOT_ATTRIBUTES,
    ]
    assert [name for name in names if f"`{name}`" not in PAGE] == []
    described = [entry.description for entry in (*layers("uint8"), *OPTIONAL_LAYERS)]
    assert [text for text in described if text not in PAGE] == []
    assert ", ".join(f"{number} {name}" for number, name in enumerate(CLASSES)) in PAGE


def test_the_python_of_the_documentation_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole(tmp_path / "outputs" / "demo")
    assert len(PYTHON) == 2
    for block in PYTHON:
        run(block, tmp_path)
        printed = capsys.readouterr().out
        if "blake2b" in block.text:
            computed, stated = printed.split()
            assert computed == stated
