"""Turns configurations into datasets and sweeps, for the verbs and for Python."""

from __future__ import annotations

PRELOADED = ("simnfnd.factory.production.cli.preloaded",)
"""What the workers of `make` are forked with."""


def markdown(names: list[str], rows: list[list[str]]) -> str:
    """A Markdown table with aligned columns."""
    widths = [max(len(cell) for cell in column) for column in zip(names, *rows, strict=True)]
    lines = [names, ["-" * width for width in widths], *rows]
    return "".join(
        "| "
        + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        + " |\n"
        for line in lines
    )
