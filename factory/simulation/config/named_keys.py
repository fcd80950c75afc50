"""The keys that the words of a command line name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

_FORMS = {"uniform", "choice", "normal"}


def named_keys(words: Sequence[str]) -> list[str]:
    """Dotted keys, and names of groups, in the order of the words; of a mapping, each of its keys.

    words: overrides that Hydra can read; flags are passed over.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    overrides = [word for word in words if not word.startswith("-")]
    keys: list[str] = []
    for override in OverridesParser.create().parse_overrides(overrides):
        if override.is_delete() or "/" in override.key_or_group:
            continue
        keys += _leaves(override.key_or_group, override.value())
    return keys


def _leaves(key: str, value: Any) -> Iterator[str]:
    """The key, or those below it where the value is a mapping and no distribution."""
    is_mapping = isinstance(value, Mapping) and len(value) > 0
    if not is_mapping or _FORMS.intersection(map(str, value)):
        yield key
        return
    for name, below in value.items():
        yield from _leaves(f"{key}.{name}", below)
