"""`simnfnd preview DIR`: contact sheet of a dataset."""

from __future__ import annotations

from pathlib import Path

from simnfnd.factory.cli import Parser
from simnfnd.factory.dataset.describe.preview import preview


def main(words: list[str]) -> None:
    """Draw the contact sheet that `words` ask for."""
    parser = Parser(prog="simnfnd preview")
    parser.add_argument("dir", type=Path, help="folder of a dataset")
    parser.add_argument("--out", type=Path, help="picture to write (default: DIR/preview.png)")
    parser.add_argument("--pairs", type=int, default=8, help="pairs to show")
    given = parser.parse_args(words)
    print(f"preview: {preview(given.dir, out=given.out, pairs=given.pairs)}")
