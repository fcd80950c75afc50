"""Messages of the command line in the words of Python: `--topic NAME` becomes `topic=NAME`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from .factory.common.errors import FactoryError

_WITH_VALUE = re.compile(r"^--([a-z]+) (\S+?):")
_OPTION = re.compile(r"--([a-z]+)\b(?: (auto|cpu|gpu|none|polar|[A-Z]{2,}))?\b")


def python_words(message: str) -> str:
    """The message with parameters for options; commands in backticks stay as they are."""
    parts = message.split("`")
    parts[0] = _WITH_VALUE.sub(r"\1=\2:", parts[0])
    return "`".join(
        part if number % 2 else _OPTION.sub(_parameter, part) for number, part in enumerate(parts)
    )


def _parameter(option: re.Match[str]) -> str:
    """An option as a parameter; a value in lower case is a text, one in capitals a placeholder."""
    value = option[2] or ""
    return f'{option[1]}="{value}"' if value.islower() else f"{option[1]}={value}"


@contextmanager
def in_python_words() -> Iterator[None]:
    """Within the block, a FactoryError names parameters and not options."""
    try:
        yield
    except FactoryError as error:
        words = python_words(str(error))
        if words == str(error):
            raise
        raise type(error)(words) from error
