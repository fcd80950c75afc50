"""docs/dataset.md says what the schema says, and its Python runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from simnfnd.factory.dataset.schema import (
    OPTIONAL_LAYERS,
    ROOT_ATTRIBUTES,
    layers,
)
from simnfnd.factory.labels import CLASSES
from simnfnd.factory.noise.registry import NoiseSettings
from simnfnd.factory.sample_table import columns, requested
from tests.factory.dataset.hostile import whole
from tests.project.page_steps import run, steps
from tests.project_files import ROOT

PAGE = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8")
PYTHON = [step for step in steps(ROOT / "docs" / "dataset.md") if step.kind == "python"]


def test_every_layer_column_and_attribute_is_documented() -> None:
    """By its name, and with its type, unit and meaning in the same line of a table."""
    lines = [line for line in PAGE.splitlines() if line.startswith("| ")]
    asked = requested(("pose", "intrinsics", "calibration", "boxes"))
    expected = [
        *((f"/{one.name}", one.units, one.description) for one in layers("uint8")),
        *((f"/{one.name}", one.dtype, one.units, one.description) for one in OPTIONAL_LAYERS),
        *((one.name, one.dtype, one.units) for one in columns(NoiseSettings())),
        *((one.name, one.dtype, one.units, one.description) for one in asked),
        *ROOT_ATTRIBUTES.items(),
    ]
    for name, *words in expected:
        found = [line for line in lines if line.startswith(f"| `{name}` |")]
        assert any(all(word in line for word in words) for line in found), (name, words)
    assert ", ".join(f"{number} {name}" for number, name in enumerate(CLASSES)) in PAGE


def test_the_python_of_the_documentation_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole(tmp_path / "outputs" / "demo")
    assert len(PYTHON) == 3
    for block in PYTHON:
        run(block, tmp_path)
        printed = capsys.readouterr().out
        if "blake2b" in block.text:
            computed, stated = printed.split()
            assert computed == stated
