"""Words of the command line that hold names and paths: written so that Hydra and a shell read them.

Hydra takes `2023_05_01` for a number, `dive(2)` for a function and `[raw] dive` for a list; inside
quotes it takes text as it stands.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable

# Text that Hydra's grammar reads as that very text.
_PLAIN = re.compile(r"(?=.*[A-Za-z/])[A-Za-z_./][A-Za-z0-9_./:@%|*-]*", re.ASCII)
_CONSTANTS = frozenset({"null", "true", "false", "nan", "inf"})


def quote(text: str) -> str:
    """A text in Hydra's quotes, whatever characters it has."""
    # Backslashes count only before a quote; one at the end would hide the closing one.
    escaped = re.sub(r"(\\*)'", lambda match: 2 * match[1] + "\\'", text)
    trailing = len(escaped) - len(escaped.rstrip("\\"))
    return f"'{escaped}{trailing * chr(92)}'"


def quote_if_needed(text: str) -> str:
    """A text as Hydra reads it back: as it stands where that goes, else in quotes."""
    is_plain = _PLAIN.fullmatch(text) is not None and text.lower() not in _CONSTANTS
    # `.5` and `.` are a number and nothing.
    return text if is_plain and not re.fullmatch(r"\.[0-9.]*([eE].*)?", text) else quote(text)


def list_word(key: str, texts: Iterable[str]) -> str:
    """`key=[a,'b c']`, which means the same to a shell that removes the quotes and to Hydra."""
    return f"{key}=[{','.join(map(_list_item, texts))}]"


def _list_item(text: str) -> str:
    if re.fullmatch(r"[\w./*-]+", text):  # read as text in a list, whatever number it looks like
        return text
    # Without them a list would have another item, or a shell would take more than the quotes.
    is_simple = text == text.strip() and not re.search(r'[,"$`\\!\[\]{}]', text)
    if is_simple:
        return f'"{text}"' if "'" in text else f"'{text}'"
    return quote(escape_interpolations(text))


def escape_interpolations(text: str) -> str:
    """Text in which OmegaConf reads `${` as it stands."""
    # It takes an even number of backslashes before `${` for half as many.
    return re.sub(r"(\\*)\$\{", lambda match: 2 * match[1] + "\\${", text)


def shell_line(words: Iterable[str]) -> str:
    """A command line that can be pasted into a shell."""
    return shlex.join(words)
