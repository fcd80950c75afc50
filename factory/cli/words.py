"""Words of the command line: paths without quotes of their own, and the key nearest to a typo."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any

import yaml

_KEY = re.compile(r"[+]{0,2}[A-Za-z_][\w./@:-]*", re.ASCII)
# What Hydra's grammar reads as one value or several, and its own forms, which it explains itself.
_READS = re.compile(r"[A-Za-z0-9_./:@%+|*,-]*|[\[{'\"].*|.*\$\{.*|\w+\(.*", re.ASCII | re.DOTALL)


def readable(words: Sequence[str]) -> list[str]:
    """`words` with `~` at the start of a value expanded, and text that is no Hydra value quoted."""
    return [_readable(word) for word in words]


def _readable(word: str) -> str:
    key, equals, value = word.partition("=")
    if not equals or not _KEY.fullmatch(key):
        return word
    if value.startswith("~"):
        value = os.path.expanduser(value)
    if _READS.fullmatch(value):
        return f"{key}={value}"
    # Backslashes count only before a quote; one at the end would hide the closing one.
    text = re.sub(r"(\\*)'", lambda found: 2 * found[1] + "\\'", value)
    ends = "\\" * (len(text) - len(text.rstrip("\\")))
    return f"{key}='{text}{ends}'"


def explained(problem: str, name: str) -> str | None:
    """One line for a key or choice that Hydra does not know, with what is nearest; else None.

    problem: Hydra's message.  name: of the root configuration, conf/<name>.yaml.
    """
    if found := re.search(r"Could not find '([^'/]+)/([^']+)'", problem):
        group, choice = found[1], found[2]
        choices = sorted(_choices(group))
        near = [f"{group}={one}" for one in _near(choice, choices, 0.5)]
        hint = f"did you mean {' or '.join(near)}?" if near else f"there are {', '.join(choices)}"
        return f"{group}={choice}: no such choice; {hint}"
    if found := re.search(r"Could not (?:override|delete from config\.) '([^']+)'", problem):
        key, keys = found[1], sorted(set(_keys(name)))
        if key in keys:
            return f"{key}: the chosen `{key.split('.')[0]}` has no such key (see `--cfg job`)"
        last = [one for one in keys if one.rpartition(".")[2] == key.rpartition(".")[2]]
        near = _near(key, keys, 0.7) or last[:3]
        hint = f"did you mean {' or '.join(near)}?" if near else "`--cfg job` shows every key"
        return f"{key}: no such key; {hint}"
    if found := re.search(r"Ambiguous value for argument '([^=]+)=", problem):
        return f"{found[1]}: several values are a sweep, `-m`, or a list, {found[1]}=[a,b]"
    return None


def _near(word: str, known: Sequence[str], cutoff: float) -> list[str]:
    """Those most like a word; one alone where that is a slip of a letter."""
    near = difflib.get_close_matches(word, known, cutoff=cutoff)
    slip = near and difflib.SequenceMatcher(None, word, near[0]).ratio() > 0.9
    return near[:1] if slip else near


def _choices(group: str) -> list[str]:
    folder = files("simnfnd.conf").joinpath(group)
    names = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
    return [name.removesuffix(".yaml") for name in names if name.endswith(".yaml")]


def _keys(name: str) -> Iterator[str]:
    """Dotted keys of a root configuration and of every choice of its groups, and the groups."""
    root = _load(f"{name}.yaml")
    yield from _flat({key: value for key, value in root.items() if key != "hydra"})
    groups = [next(iter(entry)) for entry in root.get("defaults", ()) if isinstance(entry, dict)]
    for group in (group for group in groups if " " not in group):
        yield group
        for choice in _choices(group):
            yield from _flat(_load(f"{group}/{choice}.yaml"), f"{group}.")


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in values.items():
        if key != "defaults":
            yield f"{prefix}{key}"
            if isinstance(value, dict):
                yield from _flat(value, f"{prefix}{key}.")


def _load(path: str) -> dict[str, Any]:
    text = files("simnfnd.conf").joinpath(path).read_text(encoding="utf-8")
    values = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)) or {}
    # An experiment sets keys of others.
    return {} if "# @package _global_" in text and "/" in path else dict(values)
