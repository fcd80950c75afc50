"""The pieces of HTML that the sections of the page share."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from simnfnd.evaluation.report.names import METRIC_NAMES


def table(head: str, lines: Sequence[str], kind: str = "board") -> str:
    """A table that scrolls sideways where it is too wide."""
    return (
        f'<div class="scroll" tabindex="0"><table class="{kind}"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def head(label: str, first: str, left: bool = False) -> str:
    """A column's head that sorts by it."""
    side = ' class="left"' if left else ""
    return f'<th data-first="{first}"{side}><button type="button">{escape(label)}</button></th>'


def first(name: str) -> str:
    """The order that puts the best of a metric on top."""
    return "ascending" if METRIC_NAMES[name].better < 0 else "descending"


def cell(value: float | None, text: str) -> str:
    """A cell that sorts by its value."""
    return f'<td data-value="{"" if value is None else repr(float(value))}">{text}</td>'


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f'<p class="soft">{escape(text)}</p>' if text else ""
