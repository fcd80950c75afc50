"""Every key and group of a configuration, and those nearest to a word that is none of them.

Read from the YAML files themselves, without Hydra: a mistake and a completion are answered alike.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import yaml

_SHOWN = 3
_SLIP = 0.93
# The forms of a distribution are parts of its value (`simnfnd.factory.distribution`).
_FORMS = frozenset({"uniform", "choice", "normal"})


@dataclass(frozen=True)
class Catalogue:
    """What a root configuration can be told.

    keys: key (dotted) -> the choices GROUP=NAME that have it; none for keys of the root itself.
    groups: group -> its choices.
    values: key -> its value there (of one of the choices).
    """

    keys: Mapping[str, tuple[str, ...]]
    groups: Mapping[str, tuple[str, ...]]
    values: Mapping[str, Any]


@cache
def catalogue(name: str) -> Catalogue:
    """The catalogue of conf/<name>.yaml and the groups that it has."""
    conf = files("simnfnd.conf")
    root = _load(conf.joinpath(f"{name}.yaml").read_text(encoding="utf-8"))
    named = [next(iter(entry)) for entry in root.get("defaults", ()) if isinstance(entry, dict)]
    keys: dict[str, tuple[str, ...]] = {}
    values: dict[str, Any] = {}
    groups: dict[str, tuple[str, ...]] = {}
    own = {key: value for key, value in root.items() if key not in ("defaults", "hydra")}
    for key, value in _flat(own):
        keys[key], values[key] = (), value
    for group in (group for group in named if " " not in group):
        folder = conf.joinpath(group)
        choices = sorted(f.name.removesuffix(".yaml") for f in folder.iterdir() if _is_yaml(f.name))
        groups[group] = tuple(choices)
        for choice in choices:
            text = folder.joinpath(f"{choice}.yaml").read_text(encoding="utf-8")
            package = re.search(r"^# @package (\S+)", text, re.MULTILINE)
            if package and package[1] == "_global_":
                continue  # it sets keys of others
            chosen = {k: v for k, v in (_load(text) or {}).items() if k != "defaults"}
            inside = {package[1] if package else group: chosen}
            for key, value in _flat(inside):
                if key not in keys or keys[key]:
                    keys[key] = (*keys.get(key, ()), f"{group}={choice}")
                values.setdefault(key, value)
    return Catalogue(keys, groups, values)


def explained(problem: str, name: str) -> str | None:
    """One line for what Hydra says about a key, group or choice that is none; else None.

    problem: Hydra's message.  name: of the root configuration.
    """
    if found := re.search(r"Could not find '([^'/]+)/([^']+)'", problem):
        return _no_choice(found[1], found[2], catalogue(name))
    if found := re.search(
        r"(Could not override|Could not delete from config\.) '([^']+)'", problem
    ):
        return _no_key(found[2], catalogue(name))
    if found := re.search(r"Ambiguous value for argument '([^=]+)=", problem):
        key = found[1]
        return (
            f"{key}: several values with commas between them are a sweep, `-m`; a list is "
            f"{key}=[a,b], and a comma of a name is quoted: '{key}=\"a,b\"'"
        )
    return None


def near(word: str, known: Iterable[str], cutoff: float = 0.6) -> list[str]:
    """Those of `known` that are most like `word`, the nearest first, and those it begins.

    One alone where that is a slip of a letter.
    """
    names = list(dict.fromkeys(known))
    close = difflib.get_close_matches(word, names, n=_SHOWN, cutoff=cutoff)
    if close and difflib.SequenceMatcher(None, word, close[0]).ratio() > _SLIP:
        return close[:1]
    begun = [one for one in names if len(word) > 1 and one.startswith(word)]
    return list(dict.fromkeys([*close, *begun]))[:_SHOWN]


def did_you_mean(names: Iterable[str]) -> str:
    """`; did you mean a or b?`, or nothing."""
    told = " or ".join(names)
    return f"; did you mean {told}?" if told else ""


def _no_choice(group: str, choice: str, known: Catalogue) -> str:
    choices = known.groups.get(group, ())
    close = near(choice, choices, 0.5)
    hint = did_you_mean(f"{group}={one}" for one in close)
    return f"{group}={choice}: no such choice{hint or '; there are ' + ', '.join(choices)}"


def _no_key(key: str, known: Catalogue) -> str:
    if where := known.keys.get(key) or _below(key, known):
        group = where[0].split("=")[0]
        have = f"{', '.join(where[:-1])} and {where[-1]} have" if where[1:] else f"{where[0]} has"
        return f"{key}: the chosen `{group}` has no such key; {have} it"
    candidates = near(key, [*known.keys, *known.groups], 0.7)
    last = key.rpartition(".")[2]
    if not candidates:
        same = [one for one in known.keys if one.rpartition(".")[2] == last]
        candidates = same[:_SHOWN] or near(key, _branches(known))
    if not candidates:
        ends = near(last, [one.rpartition(".")[2] for one in known.keys], 0.75)
        candidates = [one for one in known.keys if one.rpartition(".")[2] in ends[:1]][:_SHOWN]
    return f"{key}: no such key{did_you_mean(candidates) or '; `--cfg job` shows every key'}"


def _below(key: str, known: Catalogue) -> tuple[str, ...]:
    """The choices that have keys below `key`."""
    found = [where for one, where in known.keys.items() if one.startswith(f"{key}.")]
    return tuple(dict.fromkeys(choice for where in found for choice in where))


def _branches(known: Catalogue) -> list[str]:
    parts = [one.split(".") for one in known.keys]
    return [".".join(p[:depth]) for p in parts for depth in range(1, len(p))]


def _flat(values: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict) and value and not _FORMS.issuperset(value):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _is_yaml(name: str) -> bool:
    return name.endswith(".yaml")


def _load(text: str) -> Any:
    # In C where it is there: a completion waits for it.
    return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
