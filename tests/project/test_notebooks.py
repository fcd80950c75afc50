"""The notebooks run from their first cell to the last, and are stored with what they show."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import nbformat
import pytest

from tools.notebooks import FOLDER, executed, tidy

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def test_there_are_two() -> None:
    assert [one.stem for one in NOTEBOOKS] == ["denoising", "start"]


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
    assert shown(executed(notebook, tmp_path)) == shown(stored), (
        f"run `python -m tools.notebooks {notebook.stem}`"
    )


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda one: one.stem)
def test_outputs_are_text_and_small_pictures(notebook: Path) -> None:
    assert notebook.stat().st_size < 300_000
    document = nbformat.read(notebook, as_version=4)
    assert document == tidy(nbformat.read(notebook, as_version=4)), (
        "run `python -m tools.notebooks`"
    )
    kinds = {kind for cell in shown(document) for kind in cell}
    assert kinds == {"stdout", "image/png"}
