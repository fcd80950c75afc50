"""Values of keys that hold text: a name or path means itself, whatever Hydra's grammar makes of it.

Which keys hold text, lists of text, or mappings with text in them is known by the types of the
settings.
"""

from __future__ import annotations

import re
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Union, get_args, get_origin

from ...common.words import escape_interpolations, quote_if_needed

_INTERPOLATION = re.compile(r"\$\{")
# `${oc.env:HOME}`, `${hydra:job.num}`: a resolver and what it is asked.
_RESOLVER = re.compile(r"\$\{[A-Za-z_][\w.]*:[^{}]*\}", re.ASCII)
_REFERENCE = re.compile(r"\$\{([A-Za-z_]\w*)(?:\.\w+)*\}", re.ASCII)
_SWEEP_FUNCTION = re.compile(r"(choice|range|interval|glob|sort|shuffle|tag)\(.*\)", re.DOTALL)
_OPENING = {"[": "]", "{": "}", "(": ")"}


@dataclass(frozen=True)
class ValueForm:
    """What the values of a key look like.

    is_text: one name or path.  items: of a list.  fields: of a mapping, by key; "*" is any key.
    words: constants that are meant as such where the text could be one (`auto`).
    """

    is_text: bool = False
    items: ValueForm | None = None
    fields: Mapping[str, ValueForm] = field(default_factory=dict)
    words: frozenset[str] = frozenset()

    @property
    def holds_text(self) -> bool:
        """Whether there is text in it anywhere."""
        return self.is_text or self.items is not None or bool(self.fields)

    def at(self, key: str) -> ValueForm:
        """The form of a dotted key below this one."""
        form = self
        for name in key.split("."):
            form = form.fields.get(name) or form.fields.get("*") or ValueForm()
        return form


def form_of(kind: Any) -> ValueForm:
    """The form of values of a type: a settings class, `str`, lists, mappings and unions of them."""
    if kind is str:
        return ValueForm(is_text=True)
    if settings := getattr(kind, "__pydantic_fields__", None):
        fields = {info.alias or name: form_of(info.annotation) for name, info in settings.items()}
        return ValueForm(fields=_with_text(fields))
    if hasattr(kind, "__metadata__"):  # Annotated
        return form_of(get_args(kind)[0])

    origin = get_origin(kind)
    arguments = get_args(kind)
    if origin is Literal:
        return ValueForm(words=frozenset(map(str, arguments)))
    if origin in (Union, types.UnionType):
        if {int, float} & set(arguments):  # a text among numbers is typed as in Hydra
            return ValueForm()
        return _joined([form_of(member) for member in arguments])
    if not isinstance(origin, type) or not arguments:
        return ValueForm()
    if issubclass(origin, Mapping):
        return ValueForm(fields=_with_text({"*": form_of(arguments[1])}))
    if issubclass(origin, Sequence):
        items = form_of(arguments[0])
        return ValueForm(items=items) if items.holds_text else ValueForm()
    return ValueForm()


def _with_text(fields: Mapping[str, ValueForm]) -> dict[str, ValueForm]:
    return {name: form for name, form in fields.items() if form.holds_text}


def _joined(forms: Sequence[ValueForm]) -> ValueForm:
    """The form of a value that has one of several."""
    fields: dict[str, ValueForm] = {}
    for form in forms:
        for name, value in form.fields.items():
            fields[name] = _joined([fields[name], value]) if name in fields else value
    items = [form.items for form in forms if form.items is not None]
    return ValueForm(
        is_text=any(form.is_text for form in forms),
        items=_joined(items) if items else None,
        fields=fields,
        words=frozenset[str]().union(*(form.words for form in forms)),
    )


def hydra_value(value: str, form: ValueForm, *, in_sweep: bool, roots: frozenset[str]) -> str:
    """A value as typed, in Hydra's grammar.

    in_sweep: commas outside of brackets, without a space after them, separate points of a sweep.
    roots: first names of the keys that `${...}` may refer to; any other is text.
    """
    if in_sweep and not (_SWEEP_FUNCTION.fullmatch(value) or _quoted_whole(value)):
        points = _split(value, separator=r",(?!\s)")
        if len(points) > 1:
            return ",".join(_one_value(point, form, roots) for point in points)
    if in_sweep and _SWEEP_FUNCTION.fullmatch(value):
        return value
    return _one_value(value, form, roots)


def _one_value(value: str, form: ValueForm, roots: frozenset[str]) -> str:
    stripped = value.strip()
    if stripped == "null":
        return value
    if form.items is not None:
        return _list_value(stripped, form, roots)
    if _quoted_whole(stripped):
        return value
    if form.fields and stripped.startswith("{") and stripped.endswith("}"):
        return _mapping_value(stripped, form, roots)
    return _text(value, roots) if form.is_text else value


def _list_value(value: str, form: ValueForm, roots: frozenset[str]) -> str:
    items = form.items or ValueForm()
    if value in form.words or _is_reference(value, roots):
        return value
    if value.startswith("[") and value.endswith("]"):
        parts = [part for part in _split(value[1:-1]) if part.strip()]
        return f"[{','.join(_item(part.strip(), items, roots) for part in parts)}]"
    if items.is_text and not form.is_text and value:
        # Several without brackets: Hydra says what they may mean.
        return value if len(_split(value)) > 1 else f"[{_item(value, items, roots)}]"
    return _text(value, roots) if form.is_text else value


def _item(value: str, form: ValueForm, roots: frozenset[str]) -> str:
    if form.is_text:  # no item is null
        return value if _quoted_whole(value) else _text(value, roots)
    return _one_value(value, form, roots)


def _mapping_value(value: str, form: ValueForm, roots: frozenset[str]) -> str:
    entries = []
    for entry in _split(value[1:-1]):
        key, colon, text = entry.partition(":")
        stated = _one_value(text.strip(), form.at(key.strip()), roots) if colon else ""
        entries.append(f"{key.strip()}: {stated}" if colon else entry)
    return "{" + ", ".join(entries) + "}"


def _text(text: str, roots: frozenset[str]) -> str:
    """A name or path; `${` stays an interpolation only where it can be one."""
    pieces = []
    start = 0
    for match in _INTERPOLATION.finditer(text):
        if _is_reference(text[match.start() :], roots, whole=False):
            pieces += [escape_interpolations(text[start : match.start()]), match[0]]
            start = match.end()
    return quote_if_needed("".join(pieces) + escape_interpolations(text[start:]))


def _is_reference(text: str, roots: frozenset[str], *, whole: bool = True) -> bool:
    """Whether text is (or begins with) an interpolation that Hydra or OmegaConf can resolve."""
    for pattern in (_RESOLVER, _REFERENCE):
        match = pattern.fullmatch(text) if whole else pattern.match(text)
        if match:
            return pattern is _RESOLVER or match[1] in roots
    return False


def _quoted_whole(value: str) -> bool:
    """Whether quotes at both ends belong together."""
    return len(value) > 1 and value[0] in "'\"" and _closing_quote(value, 0) == len(value) - 1


def _closing_quote(text: str, opening: int) -> int | None:
    """Place of the quote that closes the one at `opening`; those after a backslash do not."""
    place = opening + 1
    while place < len(text):
        if text[place] == "\\":
            place += 2
            continue
        if text[place] == text[opening]:
            return place
        place += 1
    return None


def _split(text: str, separator: str = ",") -> list[str]:
    """The parts between separators that stand neither in quotes nor in brackets.

    A quote counts at the start of a part, where one closes it; brackets where they are balanced.
    """
    places = list(_separators(text, separator))
    ends = [*places, len(text)]
    starts = [0, *(place + 1 for place in places)]
    return [text[start:end] for start, end in zip(starts, ends, strict=True)]


def _separators(text: str, separator: str) -> Iterator[int]:
    """Places where a separator divides a text: outside of quotes and of brackets that close."""
    expected: list[str] = []  # closing brackets
    at_start = True
    place = 0
    while place < len(text):
        letter = text[place]
        closing = _closing_quote(text, place) if at_start and letter in "'\"" else None
        if closing is not None and re.match(r"\s*([,\]}:)]|$)", text[closing + 1 :]):
            place = closing + 1
            at_start = False
            continue
        if letter in _OPENING and _closes(text, place):
            expected.append(_OPENING[letter])
        elif expected and letter == expected[-1]:
            expected.pop()
        elif not expected and re.match(separator, text[place:]):
            yield place
        at_start = letter in ",[{:" or (at_start and letter.isspace())
        place += 1


def _closes(text: str, opening: int) -> bool:
    """Whether a bracket has its counterpart, counting those of its kind alone."""
    depth = 0
    for letter in text[opening:]:
        depth += letter == text[opening]
        depth -= letter == _OPENING[text[opening]]
        if depth == 0:
            return True
    return False
