"""Which room of the project uses which, read from the source: imports, `-m` words, named targets.

    python -m tests.project.rooms

prints the table of ALLOWED in test_rooms.py as the source has it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

from tests.project_files import PACKAGES, ROOT, modules

# Modules that lie in no folder of their own, by what floor they belong to; the rest is the ground.
UPPER = {
    "factory": {
        "config",
        "format_page",
        "loops",
        "pairs",
        "selection",
    },
    "models": set(),
    "evaluation": {"command", "compare"},
}
_TARGET = re.compile(r"simnfnd(\.\w+)+(:\w+)?")
_CODE = re.compile(r"\s*(?:from|import)\s+(simnfnd(?:\.\w+)*)")


@dataclass(frozen=True)
class Arrow:
    """Module `source` (by import name) uses module `target`; top: when it is imported itself."""

    source: str
    line: int
    target: str
    top: bool


def import_name(path: Path) -> str:
    """`factory/seeds.py` -> `simnfnd.factory.seeds`."""
    parts = path.with_suffix("").parts
    parts = parts[:-1] if parts[-1] == "__init__" else parts
    return ".".join(parts if parts[0] == "simnfnd" else ("simnfnd", *parts))


@cache
def names() -> frozenset[str]:
    """Import names of all modules and packages, `simnfnd` and `simnfnd.conf` among them."""
    return frozenset(import_name(path) for path in modules(*PACKAGES, "simnfnd"))


def room_of(name: str) -> str:
    """The room of a module: its folder below the house, `house: upper` or `house: ground`."""
    house, *rest = name.split(".")[1:] or [""]
    if house not in UPPER or rest == ["__main__"]:
        return "conf" if house == "conf" else "simnfnd"
    if len(rest) > 1 or (rest and (ROOT / house / rest[0]).is_dir()):
        return f"{house}/{rest[0]}"
    return f"{house}: {'upper' if rest and rest[0] in UPPER[house] else 'ground'}"


def arrows() -> Iterator[Arrow]:
    """Every use of one module by another, but those for types alone."""
    for path in modules("factory", "models", "evaluation", "simnfnd"):
        source = (ROOT / path).read_text(encoding="utf-8")
        yield from arrows_in(import_name(path), source)


def arrows_in(name: str, source: str) -> Iterator[Arrow]:
    """The same of one module with that source."""
    tree = ast.parse(source)
    silent = {id(node) for part in ast.walk(tree) for node in _silent(part)}
    inside = {
        id(node)
        for part in ast.walk(tree)
        if isinstance(part, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for node in ast.walk(part)
    }
    for node in ast.walk(tree):
        if id(node) in silent:
            continue
        imported = isinstance(node, ast.Import | ast.ImportFrom)
        for target in _targets(node):
            if (found := _known(target)) != name:
                line = node.lineno if isinstance(node, ast.stmt | ast.expr) else 0
                yield Arrow(name, line, found, imported and id(node) not in inside)


def _silent(part: ast.AST) -> Iterator[ast.AST]:
    """What runs nothing: docstrings, and imports for types."""
    if isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant):
        yield part.value
    if isinstance(part, ast.If) and ast.unparse(part.test) == "TYPE_CHECKING":
        for statement in part.body:
            yield from ast.walk(statement)


def _targets(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (a.name for a in node.names if a.name.split(".")[0] == "simnfnd")
    elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "simnfnd":
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        if _TARGET.fullmatch(node.value) and node.value.split(":")[0] in names():
            yield node.value.split(":")[0]
        if code := _CODE.match(node.value):
            yield code[1]
    elif isinstance(node, ast.List | ast.Tuple):
        words = [e.value if isinstance(e, ast.Constant) else None for e in node.elts]
        for option, word in pairwise(words):
            if option == "-m" and word == "simnfnd":
                yield word
    elif isinstance(node, ast.JoinedStr):
        first = node.values[0] if node.values else None
        # A name put together at run time may be any.
        if isinstance(first, ast.Constant) and str(first.value) in ("simnfnd.", "-m simnfnd."):
            yield "simnfnd"


def _known(target: str) -> str:
    """The longest beginning of a dotted name that is a module."""
    while target not in names() and "." in target:
        target = target.rpartition(".")[0]
    return target


def table(found: Iterable[Arrow]) -> dict[str, set[str]]:
    """Room -> the other rooms that it uses."""
    rooms: dict[str, set[str]] = {}
    for arrow in found:
        source, target = room_of(arrow.source), room_of(arrow.target)
        if source != target:
            rooms.setdefault(source, set()).add(target)
    return rooms


def circles(graph: Mapping[str, Iterable[str]]) -> set[frozenset[str]]:
    """Groups of nodes each of which leads to all others of its group (Tarjan)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: set[frozenset[str]] = set()

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for other in graph.get(node, ()):
            if other not in order:
                visit(other)
            if other in stack:
                low[node] = min(low[node], low[other])
        if low[node] == order[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                found.add(frozenset(group))

    for node in graph:
        if node not in order:
            visit(node)
    return found


if __name__ == "__main__":
    for room, used in sorted(table(arrows()).items()):
        print(f"    {room!r}: {{{', '.join(repr(one) for one in sorted(used))}}},")
    for group in circles(table(arrow for arrow in arrows() if arrow.source != "simnfnd.verbs")):
        print("circle:", sorted(group))
