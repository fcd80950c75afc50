"""`simnfnd export DIR --to FORMAT --out DIR`: a dataset for other ecosystems."""

from __future__ import annotations

from pathlib import Path

from ..cli import Parser
from ..dataset.schema import SPLITS
from ..export import FORMATS, export
from ..storage.copies import local_folder


def main(words: list[str]) -> None:
    """Write the export that `words` ask for."""
    parser = Parser(prog="simnfnd export")
    parser.add_argument("dir", help="folder or URL of a dataset")
    parser.add_argument("--to", required=True, choices=FORMATS, help="format")
    parser.add_argument("--out", required=True, type=Path, help="new or empty folder to fill")
    parser.add_argument("--split", choices=(*SPLITS, "all"), default="all", help="default: all")
    arguments = parser.parse_args(words)
    folder = local_folder(arguments.dir)
    print(f"export: {export(folder, arguments.to, arguments.out, arguments.split)}")
    print(f"folder: {arguments.out}")
    if arguments.to == "huggingface":
        print(f"upload: hf upload OWNER/NAME {arguments.out} --repo-type dataset")
