"""The page `reference/python.md`: what `from simnfnd import ...` gives, from its docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterator
from typing import Any

import simnfnd

_HEAD = """\
# Python

*Written from the docstrings when the site is built.*

Names are imported when they are first used, so `import simnfnd` costs nothing; `PairDataset` needs
numpy and h5py alone. [Read the pairs](../how-to/read.md) has examples.
"""
_ORDER = ("PairDataset", "denoise", "make_pair", "Pair", "FactoryError", "FrameError")


def markdown() -> str:
    """The page."""
    names = [*_ORDER, *(name for name in simnfnd.__all__ if name not in (*_ORDER, "__version__"))]
    lines = [_HEAD]
    for name in names:
        lines += [f"## {name}", ""]
        one = getattr(simnfnd, name)
        lines += list(_class(one) if inspect.isclass(one) else _function(name, one))
    return "\n".join(lines)


def _class(kind: type) -> Iterator[str]:
    if not issubclass(kind, Exception):
        yield from _signature(f"class {kind.__name__}", kind)
    yield from _text(kind.__doc__)
    for name, member in vars(kind).items():
        own = member.__func__ if isinstance(member, staticmethod | classmethod) else member
        text = own.fget.__doc__ if isinstance(own, property) else getattr(own, "__doc__", None)
        special = name.startswith("_") and name not in ("__len__", "__getitem__")
        if special or not text or not (callable(own) or isinstance(own, property)):
            continue
        yield from (f"### `{kind.__name__}.{name}`", "")
        if not isinstance(own, property):
            yield from _signature(name, own)
        yield from _text(text)


def _function(name: str, function: Callable[..., Any]) -> Iterator[str]:
    yield from _signature(name, function)
    yield from _text(function.__doc__)


def _signature(name: str, one: Callable[..., Any]) -> Iterator[str]:
    shown = inspect.signature(one)
    given = [p for p in shown.parameters.values() if p.name != "self"]
    words = [_parameter(parameter) for parameter in given]
    back = shown.return_annotation
    arrow = "" if back in (inspect.Signature.empty, "None") else f" -> {_type(back)}"
    star = next((i for i, p in enumerate(given) if p.kind is p.KEYWORD_ONLY), None)
    if star is not None and not any(p.kind is p.VAR_POSITIONAL for p in given):
        words.insert(star, "*")
    line = f"{name}({', '.join(words)}){arrow}"
    if len(line) > 80:
        line = f"{name}(\n    " + ",\n    ".join(words) + f",\n){arrow}"
    yield from ("```python", line, "```", "")


def _parameter(one: inspect.Parameter) -> str:
    default = "" if one.default is one.empty else f" = {one.default!r}"
    # A field that is made anew for every object.
    return f"{one.name}: {_type(one.annotation)}{default.replace('<factory>', '{}')}"


def _type(annotation: object) -> str:
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")
    return re.sub(r"\bnpt\.", "", text)


def _text(docstring: str | None) -> Iterator[str]:
    """A docstring as Markdown: `name: words` at the left margin become a list."""
    paragraphs = inspect.cleandoc(docstring or "").split("\n\n")
    entry = re.compile(r"^[a-z_]+(?:, [a-z_]+)*: ")
    for paragraph in paragraphs:
        lines = paragraph.splitlines()
        if any(entry.match(line) for line in lines):
            items: list[str] = []
            for line in lines:
                if entry.match(line) or not items or line[:6] in ("Raises", "Return"):
                    items.append(line)
                else:
                    items[-1] += " " + line.strip()
            for item in items:
                named = entry.match(item)
                yield f"- **`{item.split(': ')[0]}`**: {item.split(': ', 1)[1]}" if named else item
        else:
            yield " ".join(line.strip() for line in lines)
        yield ""
