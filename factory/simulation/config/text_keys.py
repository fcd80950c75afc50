"""Keys that hold names and paths: their values are put in Hydra's quotes, as they are typed.

Hydra's grammar takes `2023_05_01` for a number and `dive(2)` for a function.
"""

from __future__ import annotations

import re
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin

from ...common.words import escape_interpolations, quote_if_needed

# An item of a list or of a sweep: quoted, in brackets, or all up to the next comma.
_ITEM = re.compile(
    r"""\s*(?:'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|\[.*?\]|\{.*?\})\s*(?=,|$)|[^,]+""", re.DOTALL
)
_POINT = re.compile(_ITEM.pattern.replace("[^,]+", r"(?:[^,]|,(?=\s))+"), re.DOTALL)
_QUOTED = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*\"""", re.DOTALL)
_SWEEP_FUNCTION = re.compile(r"(choice|range|interval|glob|sort|shuffle|tag)\(.*\)", re.DOTALL)


class TextKey(NamedTuple):
    """A key that holds text.

    is_list: whether it holds several.  words: constants beside a list, such as `auto`.
    """

    is_list: bool
    words: frozenset[str] = frozenset()


def text_keys(settings: Any, prefix: str = "") -> dict[str, TextKey]:
    """Dotted keys of a settings class that hold names or paths, or lists of them."""
    keys: dict[str, TextKey] = {}
    for name, field in settings.__pydantic_fields__.items():
        key = f"{prefix}{field.alias or name}"
        members = list(_members(field.annotation))
        for member in members:
            if hasattr(member, "__pydantic_fields__"):
                keys |= text_keys(member, f"{key}.")
        if str in members and not {int, float} & set(members):
            keys[key] = TextKey(is_list=False)
        elif any(_is_text_list(member) for member in members):
            words = (get_args(member) for member in members if get_origin(member) is Literal)
            keys[key] = TextKey(True, frozenset(word for group in words for word in group))
    return keys


def _members(annotation: Any) -> Iterator[Any]:
    """The types that a value may have: members of unions, without what Annotated adds."""
    if hasattr(annotation, "__metadata__"):
        yield from _members(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, types.UnionType):
        for member in get_args(annotation):
            yield from _members(member)
    else:
        yield annotation


def _is_text_list(kind: Any) -> bool:
    origin = get_origin(kind)
    is_sequence = isinstance(origin, type) and issubclass(origin, Sequence)
    return is_sequence and not issubclass(origin, Mapping) and str in _members(get_args(kind)[0])


def hydra_value(value: str, key: TextKey, *, in_sweep: bool, roots: frozenset[str]) -> str:
    """A value as typed, in Hydra's grammar.

    in_sweep: commas without a space after them separate points of a sweep.
    roots: first names of the keys that `${...}` may refer to; any other is text.
    """
    if in_sweep and _SWEEP_FUNCTION.fullmatch(value):
        return value
    points = _POINT.findall(value) if in_sweep else [value]
    return ",".join(_point(point, key, roots) for point in points)


def _point(value: str, key: TextKey, roots: frozenset[str]) -> str:
    stripped = value.strip()
    if stripped in ("null", *key.words):
        return value
    if not key.is_list:
        return _text(value, roots)
    if stripped.startswith("[") and stripped.endswith("]"):
        stripped = stripped[1:-1]
        items = [item.strip() for item in _ITEM.findall(stripped)]
    else:
        items = [stripped] if stripped else []
    return f"[{','.join(_text(item, roots) for item in items if item)}]"


def _text(text: str, roots: frozenset[str]) -> str:
    """A name or path in quotes; `${` stays an interpolation only where it can be one."""
    if _QUOTED.fullmatch(text.strip()):
        return text
    known = "|".join(map(re.escape, sorted(roots)))
    parts = re.split(rf"(\$\{{(?:[A-Za-z_][\w.]*:[^{{}}]*|(?:{known})(?:\.\w+)*)\}})", text)
    parts[::2] = map(escape_interpolations, parts[::2])
    return quote_if_needed("".join(parts))
