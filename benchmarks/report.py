"""What a benchmark gives: tables of numbers, told as Markdown and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

Cell = str | int | float


@dataclass(frozen=True)
class Options:
    """What the user asks of all benchmarks.

    quick: the smallest amounts that still run every line of the code; the figures mean nothing.
    frame: folder of FLSea VI whose first frame is taken beside the procedural one.
    peer: checkout of another simulator, to compare with.  peer_python: what runs that.
    shards: how many of them `streams` reads.
    """

    quick: bool = False
    frame: str = ""
    peer: str = ""
    peer_python: str = ""
    shards: int = 10_000

    def amount(self, full: int, quick: int = 1) -> int:
        """`full`, or `quick` where only the code is to be tried."""
        return quick if self.quick else full


@dataclass(frozen=True)
class Table:
    """One table.

    rows: numbers are rounded to three digits where they are shown, and kept whole in the JSON.
    bars, log_x, lines: what the picture shows of it: the column whose numbers are bars (labelled
        by the first column), or (x, y...) columns that are lines.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""
    note: str = ""
    bars: str = ""
    lines: tuple[str, ...] = ()

    def column(self, name: str) -> list[Cell]:
        """All cells below a heading."""
        index = self.columns.index(name)
        return [row[index] for row in self.rows]

    def markdown(self) -> str:
        """The table with its title and note."""
        numeric = [
            all(isinstance(cell, int | float) for cell in self.column(name))
            for name in self.columns
        ]
        lines = [
            _line(self.columns),
            _line(["---:" if right else "---" for right in numeric]),
            *(_line([shown(cell) for cell in row]) for row in self.rows),
        ]
        parts = [f"### {self.title}" if self.title else "", "\n".join(lines), self.note]
        return "\n\n".join(part for part in parts if part)


@dataclass(frozen=True)
class Section:
    """What one benchmark found.  failed: why its outcome is wrong, where it checks one."""

    tables: tuple[Table, ...] = ()
    note: str = ""
    failed: str = ""
    seconds: float = field(default=0.0, compare=False)

    def markdown(self, name: str) -> str:
        """The section under its heading."""
        parts = [f"## {name}", self.note, *(table.markdown() for table in self.tables)]
        if self.failed:
            parts.append(f"**Failed: {self.failed}**")
        parts.append(f"({self.seconds:.0f} s)")
        return "\n\n".join(part for part in parts if part) + "\n"


def to_json(section: Section) -> dict[str, Any]:
    """Plain values of a section."""
    values: dict[str, Any] = json.loads(json.dumps(asdict(section)))
    return values


def from_json(values: Mapping[str, Any]) -> Section:
    """The section that `to_json` took apart."""
    tables = tuple(
        Table(
            **{
                **table,
                "columns": tuple(table["columns"]),
                "rows": tuple(tuple(row) for row in table["rows"]),
                "lines": tuple(table["lines"]),
            }
        )
        for table in values["tables"]
    )
    return Section(**{**values, "tables": tables})


def shown(cell: Cell) -> str:
    """A cell as people read it: three digits of a number that is not whole."""
    if isinstance(cell, float):
        if cell == 0 or 1e-3 <= abs(cell) < 1e6:
            return f"{cell:.0f}" if abs(cell) >= 100 else f"{cell:.3g}"
        return f"{cell:.2g}"
    return str(cell)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
