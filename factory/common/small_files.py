"""Small untrusted files: regular ones of bounded size, safely parsed; lines of numbers."""

from __future__ import annotations

import errno
import json
import math
import os
import stat
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from .errors import FactoryError

MOST_BYTES = 1 << 28
"""Of a file that is read whole; a manifest of 300,000 shards takes half of it."""
# Most bytes of settings; reading YAML's numbers in base sixty takes time that grows with the
# square of their length.
_MOST_YAML_BYTES = 1 << 18
_MOST_DEPTH = 64
# Windows has no pipes that wait here, and would translate line ends.
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading.  Raises OSError for any other kind.

    A pipe would wait for a writer for ever, and some devices never end.
    """
    file = os.fdopen(os.open(path, _FLAGS), "rb")
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "no regular file", str(path))
    return file


def read_regular(path: Path, most_bytes: int = MOST_BYTES) -> bytes:
    """The content of a regular file.  Raises OSError for any other kind, or a longer one."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most_bytes:
            raise OSError(errno.EFBIG, f"longer than {most_bytes} bytes", str(path))
        return file.read(size)  # it may be growing


def parse_json(content: bytes | str) -> Any:
    """What JSON says.  Raises ValueError for anything else."""
    try:
        return json.loads(content)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def load_yaml(path: Path) -> Any:
    """What a regular file of YAML without aliases says.  Raises OSError or ValueError."""
    import yaml  # whoever reads images alone does without

    loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    depth = 0
    try:
        text = read_regular(path, _MOST_YAML_BYTES).decode()
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError("uses aliases, of which a few lines can stand for gigabytes")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _MOST_DEPTH:
                raise ValueError("nested too deeply")
        return yaml.load(text, Loader=loader)
    except yaml.YAMLError as error:
        raise ValueError(one_line(error)) from error


def one_line(error: BaseException, most: int = 160) -> str:
    """What an error says, in one line of bounded length."""
    reason = error.strerror if isinstance(error, OSError) else None
    return " ".join((reason or str(error)).split())[:most]


# --- text files of numbers


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
    if len(numbers) != len(expected) or not all(map(math.isfinite, numbers)):
        raise FactoryError(
            f"{path}:{number}: expected {len(expected)} numbers, {' '.join(expected)}, got "
            f"{line[:60]!r}"
        )
    return numbers


class NumberTable(NamedTuple):
    """A CSV file of numbers below a header.

    names: of its columns.  rows: a number for each name.  lines: the number of each row's line.
    """

    names: tuple[str, ...]
    rows: list[list[float]]
    lines: list[int]


def number_table(path: Path) -> NumberTable:
    """Read a CSV file of numbers; `time_s` must increase where it has such a column.

    Raises FactoryError that names the file and the line.
    """
    (_, header), *lines = numbered_lines(path) or [(0, "")]
    names = tuple(word.strip() for word in header.split(","))
    table = NumberTable(
        names, [numbers_in(path, line, names) for line in lines], [number for number, _ in lines]
    )
    if "time_s" in names:
        times_s = [row[names.index("time_s")] for row in table.rows]
        for number, before_s, time_s in zip(table.lines[1:], times_s, times_s[1:], strict=False):
            if time_s <= before_s:
                raise FactoryError(f"{path}:{number}: time_s does not increase")
    return table
