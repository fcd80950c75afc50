"""Run the notebooks of docs/notebooks and store their outputs: `python -m tools.notebooks`.

Needs what `make setup` installs.  The tests run them too, and store nothing.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "notebooks"


def executed(notebook: Path, folder: Path, timeout_s: float = 300) -> nbformat.NotebookNode:
    """The notebook with the outputs of running it in `folder`, which gets the examples.

    Raises nbclient's CellExecutionError when a cell fails.
    """
    if not (folder / "examples").exists():
        shutil.copytree(ROOT / "examples" / "didson", folder / "examples" / "didson")
    document = nbformat.read(notebook, as_version=4)  # type: ignore[no-untyped-call]
    client = NotebookClient(
        document,
        timeout=int(timeout_s),
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    return tidy(document)


def tidy(document: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Without what differs from run to run or names this machine: times, numbers of cells."""
    document.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for number, cell in enumerate(document.cells):
        cell.metadata = {}
        cell.id = f"cell-{number}"
        for output in cell.get("outputs", []):
            if "data" in output:
                output.metadata = {}
                if "image/png" in output.data:
                    output.data = {"image/png": output.data["image/png"]}
    return document


def main(names: Sequence[str]) -> None:
    """Run the notebooks of these names (default: all) and write them back."""
    for notebook in sorted(FOLDER.glob("*.ipynb")):
        if not names or notebook.stem in names:
            with tempfile.TemporaryDirectory() as folder:
                document = executed(notebook, Path(folder))
            nbformat.write(document, notebook)  # type: ignore[no-untyped-call]
            print(f"{notebook.relative_to(ROOT)}: {notebook.stat().st_size} bytes")


if __name__ == "__main__":
    main(sys.argv[1:])
