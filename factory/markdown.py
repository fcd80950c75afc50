"""Tables in Markdown, as every report and card writes them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_RULES = {"l": "---", "r": "---:", "c": ":---:"}


def table(head: Sequence[str], rows: Iterable[Sequence[object]], align: str = "lr") -> str:
    """A table, without a newline at its end.

    align: a letter a column, l, r or c; the last one counts for all further columns.  In cells a
    vertical bar is escaped and a line end becomes a space.  Raises ValueError for a row that has
    not as many cells as the head.
    """
    letters = align.ljust(len(head), align[-1])
    lines = [_line(head), f"|{'|'.join(_RULES[letter] for letter in letters[: len(head)])}|"]
    for row in rows:
        if len(row) != len(head):
            raise ValueError(f"{len(row)} cells under a head of {len(head)}: {row}")
        lines.append(_line(row))
    return "\n".join(lines)


def _line(cells: Sequence[object]) -> str:
    return "| " + " | ".join(map(_cell, cells)) + " |"


def _cell(content: object) -> str:
    return str(content).replace("\n", " ").replace("|", "\\|")
