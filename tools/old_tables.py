"""`python -m tools.old_tables`: tables of measurements that are older than two versions.

A table is as old as its newest line: the version that the checkout had when that line was written.
Prints one line per table, and nothing where there is no history.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
VERSION_FILE = "factory/__init__.py"
MOST_VERSIONS = 2
"""A table may be so many versions old."""
LEAST_NUMBERS = 6
"""Decimal numbers that make a table one of measurements."""


class Table(NamedTuple):
    """A table of a page: its first and last line, from 1."""

    page: Path
    first: int
    last: int


def main() -> None:
    """Print the tables that are too old."""
    versions = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    for page in sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md")]):
        for table in tables_of(page):
            version = version_of(table)
            if version in versions and versions.index(version) > MOST_VERSIONS:
                name = page.relative_to(ROOT)
                print(f"{name}:{table.first}: measured for version {version}; measure it again")


def tables_of(page: Path) -> Iterator[Table]:
    """The tables of a page that hold measurements."""
    lines = page.read_text(encoding="utf-8").splitlines()
    first = None
    for number, line in enumerate([*lines, ""], 1):
        if line.startswith("|"):
            first = first or number
        elif first is not None:
            text = "\n".join(lines[first - 1 : number - 1])
            if len(re.findall(r"\d*\.\d+", text)) >= LEAST_NUMBERS:
                yield Table(page, first, number - 1)
            first = None


def version_of(table: Table) -> str:
    """The version in which the newest line of a table was written; "" where that is unknown."""
    span = f"-L{table.first},{table.last}"
    blamed = _git("blame", "--line-porcelain", span, "--", str(table.page))
    times = re.findall(r"^author-time (\d+)$", blamed, re.MULTILINE)
    commits = re.findall(r"^([0-9a-f]{40}) ", blamed, re.MULTILINE)
    if not times:
        return ""
    _, commit = max(zip(map(int, times), commits, strict=True))
    return _version_at(commit)


@cache
def _version_at(commit: str) -> str:
    found = re.search(r'__version__ = "(.*)"', _git("show", f"{commit}:{VERSION_FILE}"))
    return found[1] if found else ""


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout


if __name__ == "__main__":
    main()
