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


def explained(problem: str) -> str | None:
    """One line for a key or choice that Hydra does not know, with what is nearest; else None.

    problem: Hydra's message.
    """
    if found := re.search(r"Could not find '([^'/]+)/([^']+)'", problem):
        group, choice = found[1], found[2]
        choices = sorted(_stems(group))
        near = difflib.get_close_matches(choice, choices, cutoff=0.5)
        hint = f"did you mean {group}={near[0]}?" if near else f"there are {', '.join(choices)}"
        return f"{group}={choice}: no such choice; {hint}"
    if found := re.search(r"Could not (?:override|delete from config\.) '([^']+)'", problem):
        key, keys = found[1], sorted(set(_all_keys()))
        if key in keys:
            return f"{key}: the chosen `{key.split('.')[0]}` has no such key (see `--cfg job`)"
        last = [one for one in keys if one.rpartition(".")[2] == key.rpartition(".")[2]]
        near = difflib.get_close_matches(key, keys, cutoff=0.7) or last[:3]
        hint = f"did you mean {' or '.join(near)}?" if near else "`--cfg job` shows every key"
        return f"{key}: no such key; {hint}"
    if found := re.search(r"Ambiguous value for argument '([^=]+)=", problem):
        return f"{found[1]}: several values are a sweep, `-m`, or a list, {found[1]}=[a,b]"
    return None


def _stems(group: str) -> list[str]:
    folder = files("simnfnd.conf").joinpath(group)
    names = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
    return [name.removesuffix(".yaml") for name in names if name.endswith(".yaml")]


def _all_keys() -> Iterator[str]:
    """Dotted keys of every configuration, and the names of the groups."""
    conf = files("simnfnd.conf")
    for entry in conf.iterdir():
        if entry.name.endswith(".yaml"):
            yield from _flat(entry.read_text(encoding="utf-8"), "")
        elif entry.is_dir() and (names := _stems(entry.name)):
            yield entry.name
            for name in names:
                text = entry.joinpath(f"{name}.yaml").read_text(encoding="utf-8")
                package = re.search(r"^# @package (\S+)", text, re.MULTILINE)
                if not package or package[1] != "_global_":
                    yield from _flat(text, f"{package[1] if package else entry.name}.")


def _flat(text: str, prefix: str) -> Iterator[str]:
    def below(values: Mapping[str, Any], prefix: str) -> Iterator[str]:
        for key, value in values.items():
            yield f"{prefix}{key}"
            if isinstance(value, dict) and key != "hydra":
                yield from below(value, f"{prefix}{key}.")

    values = yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    return below({k: v for k, v in (values or {}).items() if k != "defaults"}, prefix)
