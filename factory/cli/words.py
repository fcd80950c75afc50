"""Words of the command line as Hydra's grammar reads them: paths need no quotes of their own.

Hydra takes blanks inside a value, but neither `~`, umlauts, brackets nor an equals sign.  A value
that its grammar cannot read, and that does not look like a list, mapping or function of it, is
meant as text.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

# What Hydra's grammar surely reads as one value.
_PLAIN = re.compile(r"[A-Za-z0-9_./:@%+|*-]*", re.ASCII)
_KEY = re.compile(r"[+~]{0,2}[A-Za-z_][\w./@:-]*", re.ASCII)
# Hydra's own forms: mistakes in them are for Hydra to explain.
_OWN_FORM = re.compile(
    r"[{'\"]|\$\{|(choice|range|interval|glob|shuffle|sort|tag|cast|int|float|str|bool|extend_list"
    r"|list_extend|dict_extend)\("
)


def readable(words: Sequence[str]) -> list[str]:
    """`words` with every KEY=VALUE whose value is text quoted, and `~` at its start expanded."""
    sweep = any(word in ("-m", "--multirun") for word in words)
    return [_readable(word, sweep) for word in words]


def _readable(word: str, sweep: bool) -> str:
    key, equals, value = word.partition("=")
    if not equals or not _KEY.fullmatch(key):
        return word
    if value.startswith("[") and value.endswith("]"):
        if re.search("['\"]", value) and _reads(word):
            return word  # a comma between quotes parts nothing
        parts = [_home(part.strip()) for part in value[1:-1].split(",")]
        if _reads(f"{key}=[{','.join(parts)}]"):
            return f"{key}=[{','.join(parts)}]"
        quoted = f"{key}=[{','.join(_quoted(key, part) for part in parts)}]"
        return quoted if _reads(quoted) else word
    if sweep and "," in value:
        value = ",".join(map(_home, value.split(",")))
        if _reads(f"{key}={value}") or _OWN_FORM.match(value):
            return f"{key}={value}"
        return f"{key}={','.join(_quoted(key, part) for part in value.split(','))}"
    return f"{key}={_quoted(key, _home(value))}"


def _quoted(key: str, value: str) -> str:
    if _OWN_FORM.match(value) or value.startswith("[") or _reads(f"{key}={value}"):
        return value
    # Backslashes count only before a quote; one at the end would hide the closing one.
    text = re.sub(r"(\\*)(['])", lambda found: 2 * found[1] + "\\'", value)
    text += "\\" * (len(text) - len(text.rstrip("\\")))
    return f"'{text}'"


def _home(value: str) -> str:
    return os.path.expanduser(value) if value.startswith("~") else value


def _reads(word: str) -> bool:
    """Whether Hydra's grammar reads the word."""
    if _PLAIN.fullmatch(word.partition("=")[2]):
        return True
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        OverridesParser.create().parse_override(word)
    except HydraException:
        return False
    return True
