"""The page of configuration keys: names, types and limits from the settings classes.

What a key means is said by the docstring of its class, or else by the comment in `conf`.
"""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from importlib import resources
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from simnfnd.factory.distribution import Distribution
from tools.pages.comments import comments


@dataclass(frozen=True)
class Key:
    """A line of the page.  name: dotted.  allowed, default, meaning: Markdown."""

    name: str
    allowed: str
    default: str
    meaning: str


def keys(
    settings: type, values: Mapping[str, Any], said: Mapping[str, str], prefix: str = ""
) -> Iterator[Key]:
    """Every key of a settings class and of the classes in it, in order.

    values: the configuration as it is without any words; defaults are taken from there first.
    said: comments by dotted key, for keys that no docstring explains.
    """
    hints = get_type_hints(settings, include_extras=True)
    texts = _explained(settings)
    for one in fields(settings):
        name = f"{prefix}{one.name}"
        inner = _settings_in(hints[one.name])
        if len(inner) == 1:
            given = values.get(one.name)
            below = given if isinstance(given, Mapping) else {}
            yield from keys(inner[0], below, said, f"{name}.")
        elif not inner:
            meaning = texts.get(one.name) or _comment(name, said) or _mentioned(settings, one.name)
            default = _default(one, values)
            yield Key(name, allowed(hints[one.name]), default, _sentence(meaning))


def _comment(name: str, said: Mapping[str, str]) -> str:
    """Of the key, or else of the block that it stands in (but not of a whole file)."""
    block = name.rpartition(".")[0]
    return said.get(name) or said.get(block, "")


def _mentioned(settings: type, name: str) -> str:
    """The entry of another key in which this one is named, or what the class says of itself."""
    around = [text for text in _explained(settings).values() if re.search(rf"\b{name}\b", text)]
    own = " ".join(inspect.cleandoc(settings.__doc__ or "").split("\n\n")[0].split())
    named = re.search(rf"\b{name}\b", own) or "`" not in own
    return around[0] if around else own * bool(named)


def _settings_in(hint: Any) -> list[type]:
    """The settings classes that a key may hold; several where a `kind` chooses among them."""
    if is_dataclass(hint) and isinstance(hint, type) and hint is not Distribution:
        return [hint]
    if get_origin(hint) is Annotated:
        return _settings_in(get_args(hint)[0])
    if get_origin(hint) in (Union, types.UnionType):
        return [found for part in get_args(hint) for found in _settings_in(part)]
    return []


def allowed(hint: Any) -> str:
    """What a key may hold, in words."""
    if get_origin(hint) is Annotated:
        base, *rest = get_args(hint)
        if _is_distribution(base):
            return "number or distribution"
        limits = _limits(rest)
        return f"{allowed(base)} {limits}".strip()
    if get_origin(hint) is Literal:
        return " \\| ".join(f"`{word}`" for word in get_args(hint))
    if get_origin(hint) in (Union, types.UnionType):
        parts = [part for part in get_args(hint) if part is not type(None)]
        words = [allowed(part) for part in parts]
        words += ["`null`"] if len(parts) < len(get_args(hint)) else []
        return " or ".join(dict.fromkeys(words))
    if _is_distribution(hint):
        return "number or distribution"
    if get_origin(hint) in (tuple, list):
        return f"list of {allowed(get_args(hint)[0])}"
    if get_origin(hint) in (dict, Mapping) or hint is dict or "Mapping" in str(hint):
        return "mapping"
    names = {bool: "`true` \\| `false`", int: "integer", float: "number", str: "text"}
    if is_dataclass(hint) and isinstance(hint, type):
        return "mapping of " + ", ".join(f"`{one.name}`" for one in fields(hint))
    return names.get(hint, "any")


def _is_distribution(hint: Any) -> bool:
    return hint is Distribution


def _limits(marks: list[Any]) -> str:
    signs = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
    flat = [part for mark in marks for part in (mark, *getattr(mark, "metadata", ()))]
    found = [
        f"{sign} {getattr(mark, name)}"
        for mark in flat
        for name, sign in signs.items()
        if isinstance(getattr(mark, name, None), int | float)
    ]
    return ", ".join(dict.fromkeys(found))


def _default(one: Field[Any], values: Mapping[str, Any]) -> str:
    if one.name in values:
        given = values[one.name]
        text = _yaml(given)
        return "required" if text == "???" else f"`{text}`" if len(text) < 90 else "`--cfg job`"
    if one.default is not MISSING:
        return f"`{_yaml(one.default)}`"
    if one.default_factory is not MISSING:
        return f"`{_yaml(one.default_factory())}`"
    return "required"


def _yaml(value: Any) -> str:
    """As it is written on the command line."""
    if isinstance(value, Distribution):
        value = value.plain()
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_yaml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_yaml(one) for one in value) + "]"
    return str(value)


def _explained(settings: type) -> dict[str, str]:
    """By field, what the docstrings of the class and its bases say of it."""
    found: dict[str, str] = {}
    for kind in reversed(settings.__mro__):
        if not is_dataclass(kind):
            continue
        names = [one.name for one in fields(kind)]
        text = " ".join(inspect.cleandoc(kind.__doc__ or "").split())
        # An entry begins a sentence: the head's end, or two words further on.
        any_name = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
        head = re.compile(rf"(?:^|(?<=[.:;)] )|(?<=\S ))((?:{any_name})(?:, (?:{any_name}))*): ")
        marks = list(head.finditer(text))
        for number, mark in enumerate(marks):
            end = marks[number + 1].start() if number + 1 < len(marks) else len(text)
            for name in mark.group(1).split(", "):
                found[name] = text[mark.end() : end]
    return found


def _sentence(text: str) -> str:
    """Fit for a cell of a table."""
    text = " ".join(text.split()).rstrip(".;")
    text = re.sub(r"(?<![`\\])\|", r"\\|", text)
    return text


def conf_comments(*files: tuple[str, str]) -> dict[str, str]:
    """Comments of files of `conf` by dotted key.  files: (file, prefix of its keys)."""
    found: dict[str, str] = {}
    for name, prefix in files:
        text = resources.files("simnfnd.conf").joinpath(name).read_text(encoding="utf-8")
        for key, said in comments(text).items():
            found.setdefault(prefix + key, said)
    return found


def composed(name: str, *words: str) -> dict[str, Any]:
    """The values of a configuration of `conf` as they are with `words`."""
    from hydra import compose, initialize_config_module
    from omegaconf import OmegaConf

    with initialize_config_module("simnfnd.conf", version_base="1.3"):
        values = OmegaConf.to_container(compose(name, overrides=list(words)), resolve=False)
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items()}
