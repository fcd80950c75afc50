"""Small things that cost a newcomer's first hour."""

from __future__ import annotations

from pathlib import Path

import h5py
import pytest

from simnfnd.command import main
from tests.fake_source import FakeConfig
from tests.project_files import ROOT, modules
from tests.run_fake import make


def test_bars_of_logs_are_few_lines_for_every_verb() -> None:
    """tqdm itself writes a line a step into a file; `progress_bar` does not."""
    own = {Path("factory/progress.py"), Path("factory/scheduler/progress.py")}
    for path in set(modules("factory", "models", "evaluation", "simnfnd")) - own:
        assert "tqdm" not in (ROOT / path).read_text(encoding="utf-8"), path


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    make(tmp_path / "data", FakeConfig(), scheduler={"backend": "serial"})
    return tmp_path / "data"


def test_a_preview_that_cannot_be_written_names_its_option(
    dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = dataset / "manifest.json" / "sheet.png"
    assert main(["preview", str(dataset), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: --out: cannot write ")
    assert "dataset.dir" not in said


def test_a_stale_index_has_a_remedy_that_works(
    dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with h5py.File(dataset / "index.h5", "r+") as index:
        del index["test"]
    assert main(["validate", str(dataset)]) == 1
    assert "run the command that made the dataset again" in capsys.readouterr().out
    (dataset / "index.h5").unlink()
    make(dataset, FakeConfig(), scheduler={"backend": "serial"})
    assert main(["validate", str(dataset)]) == 0
