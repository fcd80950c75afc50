"""Text files of numbers: lines with their line numbers, and the numbers of a line."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from .errors import FactoryError
from .small_files import one_line, read_regular


def numbered_lines(path: Path) -> list[tuple[int, str]]:
    """(line number, text) of the lines that are neither empty nor comments (`#`).

    Raises FactoryError when the file cannot be read, or is no text.
    """
    return [(number, line) for number, line in text_lines(path) if not line.startswith("#")]


def text_lines(path: Path) -> list[tuple[int, str]]:
    """(line number, text) of the lines that are not empty; see `numbered_lines`."""
    try:
        text = read_regular(path).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FactoryError(
            f"{path}: not a text file that can be read ({one_line(error)})"
        ) from error
    numbered = enumerate((line.strip() for line in text.splitlines()), start=1)
    return [(number, line) for number, line in numbered if line]


def numbers_in(path: Path, numbered_line: tuple[int, str], names: Iterable[str]) -> list[float]:
    """The finite numbers of a line, one for each name.  Raises FactoryError that names the line."""
    number, line = numbered_line
    expected = list(names)
    try:
        numbers = [float(word) for word in line.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != len(expected) or not np.isfinite(numbers).all():
        raise FactoryError(
            f"{path}:{number}: expected {len(expected)} numbers, {' '.join(expected)}, got "
            f"{line[:60]!r}"
        )
    return numbers
