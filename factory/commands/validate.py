"""`simnfnd validate DIR`: is a dataset whole, consistent and without leaks."""

from __future__ import annotations

from ..cli import Parser
from ..dataset.validate import validate
from ..storage.copies import local_folder


def main(words: list[str]) -> int:
    """Print what is wrong with the dataset; 0 when nothing is, else 1."""
    parser = Parser(prog="simnfnd validate")
    parser.add_argument("dir", help="folder or URL of a dataset")
    parser.add_argument("--deep", action="store_true", help="read every picture, too")
    given = parser.parse_args(words)
    report = validate(local_folder(given.dir, fresh=True), given.deep)
    for finding in report.findings:
        print(finding)
    what = f"{report.samples} samples in {report.shards} shards"
    depth = "every picture was read" if given.deep else "pictures were not read (--deep reads them)"
    if report.errors:
        print(f"invalid: {given.dir}: {len(report.errors)} error(s) in {what}")
        return 1
    print(f"valid: {given.dir}: {what}; {depth}")
    return 0
