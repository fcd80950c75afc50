"""The notebooks run from their first cell to the last, and are stored with what they show."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import nbformat
import pytest

from tools.notebooks import FOLDER, executed

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def shown(document: nbformat.NotebookNode) -> list[list[str]]:
    """For each cell of code: what kinds of things it shows; text may come in pieces."""
    return [
        [
            kind
            for kind, _ in groupby(
                o.get("name") or "+".join(o.get("data", {})) for o in cell.outputs
            )
        ]
        for cell in document.cells
        if cell.cell_type == "code"
    ]


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda one: one.stem)
def test_a_notebook_runs_and_shows_what_is_stored(notebook: Path, tmp_path: Path) -> None:
    stored = nbformat.read(notebook, as_version=4)
    assert notebook.stat().st_size < 300_000
    assert {kind for cell in shown(stored) for kind in cell} == {"stdout", "image/png"}
    assert shown(executed(notebook, tmp_path)) == shown(stored), (
        f"run `python -m tools.notebooks {notebook.stem}`"
    )
