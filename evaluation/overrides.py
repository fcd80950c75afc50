"""Plain words of a command line as Hydra overrides."""

from __future__ import annotations

from collections.abc import Sequence

from ..factory.errors import FactoryError


def named(words: Sequence[str], first: str, rest: str | None = None) -> list[str]:
    """Words without `=` as overrides: the first one of `first`, the others a list of `rest`."""
    plain = [word for word in words if "=" not in word and not word.startswith("-")]
    overrides = [word for word in words if word not in plain]
    if plain:
        overrides.append(f"{first}={_quoted(plain[0])}")
    if plain[1:]:
        if rest is None:
            raise FactoryError(f"{plain[1]}: unexpected; only one folder is taken here")
        overrides.append(f"{rest}={listed(plain[1:])}")
    return overrides


def listed(words: Sequence[str]) -> str:
    """Words as a list in Hydra's grammar."""
    return f"[{','.join(_quoted(word) for word in words)}]"


def _quoted(word: str) -> str:
    """A path as Hydra's grammar takes it, whatever characters it has."""
    return "'" + word.replace("\\", "\\\\").replace("'", "\\'") + "'"
