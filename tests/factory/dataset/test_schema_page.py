"""docs/dataset.md says what the schema says, and its Python runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from simnfnd.factory.config import digest
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.format_page import markdown
from tests.factory.dataset.hostile import whole
from tests.fake_source import FakeConfig, FakeSource, refs
from tests.project import readme_steps
from tests.project_files import ROOT


def test_the_format_is_documented_as_it_is() -> None:
    text = (ROOT / "docs" / "dataset.md").read_text(encoding="utf-8")
    assert text == markdown(), "run `python -m simnfnd.factory.format_page > docs/dataset.md`"


def test_a_stranger_can_compute_the_config_hash(tmp_path: Path) -> None:
    """With the Python of the documentation, of a shard as the factory writes it."""
    config = {"seed": 7, "noise": {"rate": 0.1, "modes": ("radial", "ärger")}, "limit": None}
    source = FakeSource(FakeConfig())
    write_shard(
        tmp_path / "outputs/demo",
        "train/shard-00000.h5",
        source.pairs(refs(1, "alpha")[0], (0,)),
        source.axes(),
        source.columns(),
        Provenance(config, digest(config), "tests"),
        DatasetSettings(),
    )
    (block,) = (step for step in readme_steps.steps(markdown()) if "blake2b" in step.text)
    done = subprocess.run(
        [sys.executable, "-c", block.text], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.stdout.split() == [digest(config)] * 2, done.stderr


def test_the_python_of_the_documentation_runs(tmp_path: Path) -> None:
    whole(tmp_path / "outputs" / "demo")
    blocks = [step for step in readme_steps.steps(markdown()) if step.kind == "python"]
    assert len(blocks) == 4
    for block in blocks:
        done = subprocess.run(
            [sys.executable, "-c", block.text],
            cwd=tmp_path,
            env={"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
    assert "8 (24, 20) (0.0, 1.0) m b'alpha'" in done.stdout
