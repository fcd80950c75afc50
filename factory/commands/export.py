"""`simnfnd export DIR --to FORMAT --out DIR`: a dataset for other ecosystems."""

from __future__ import annotations

from pathlib import Path

from simnfnd.factory.cli import Parser
from simnfnd.factory.dataset.format.schema import SPLITS
from simnfnd.factory.export import FORMATS, export
from simnfnd.factory.extras import Need, require

# Format -> the module of the export extra that writes it.
_NEEDS = {"webdataset": "webdataset", "huggingface": "pyarrow"}


def main(words: list[str]) -> None:
    """Write the export that `words` ask for."""
    parser = Parser(prog="simnfnd export")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    parser.add_argument("--to", required=True, choices=FORMATS, help="format")
    parser.add_argument("--out", required=True, type=Path, help="new or empty folder to fill")
    parser.add_argument("--split", choices=(*SPLITS, "all"), default="all", help="default: all")
    given = parser.parse_args(words)
    if module := _NEEDS.get(given.to):
        require([Need(f"--to {given.to}", module, extra="export")])
    print(f"export: {export(given.dir, given.to, given.out, given.split)}")
    print(f"folder: {given.out}")
