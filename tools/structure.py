"""Draw the structure of the code from its imports: `python -m tools.structure`.

It writes docs/images/structure.svg and the table of rooms between two marks of
docs/architecture.md.  A test compares both with the code.

A suite is one of the four packages of `factory`, `models`, `evaluation` or `simnfnd` itself; a room
is a package inside a suite.  Modules beside the rooms of a suite count as one more room.
"""

from __future__ import annotations

import ast
import re
import textwrap
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from html import escape
from pathlib import Path
from typing import NamedTuple

import grimp

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "architecture.md"
IMAGE = ROOT / "docs" / "images" / "structure.svg"
MARKS = "<!-- rooms: python -m tools.structure -->", "<!-- /rooms -->"

SUITES = {
    "simnfnd": "simnfnd",
    "evaluation": "evaluation",
    "models": "models",
    "production": "factory/production",
    "simulation": "factory/simulation",
    "dataset": "factory/dataset",
    "common": "factory/common",
}
"""Suite -> its folder, from the top down."""

# A guard that packages start with, and the files of the configuration.
_LEFT_OUT = {"simnfnd.rooms", "simnfnd.conf"}

_LABEL_PX = 150
_COLUMN_GAP_PX = 22
_ROW_PX = 34
_BOX_HEIGHT_PX = 24
_BAND_GAP_PX = 26
_MARGIN_PX = 14
_LETTER_PX = 7.2
_SUITE_ARROW_PX = 60
_LINE_PX = 15
_LISTING_LETTERS = 120
_FEW_COLUMNS = 2
"""Bands with so few columns have room for the names of the modules beside their rooms."""
_BOX_PADDING_PX = 9


class Room(NamedTuple):
    """A package inside a suite; `name` is empty for the modules beside its rooms."""

    suite: str
    name: str

    @property
    def label(self) -> str:
        """The name that the drawing shows."""
        return self.name or "modules"

    @property
    def folder(self) -> str:
        """The folder, relative to the root of the project."""
        return f"{SUITES[self.suite]}/{self.name}" if self.name else SUITES[self.suite]


@dataclass(frozen=True)
class CodeStructure:
    """What the drawing shows.

    imports: all rooms, and for each the other rooms that it imports.
    beside: suite -> names of the modules that lie in none of its rooms.
    """

    imports: dict[Room, frozenset[Room]]
    beside: dict[str, tuple[str, ...]]

    def inside(self, suite: str) -> dict[Room, frozenset[Room]]:
        """The rooms of a suite, each with what it imports from the same suite."""
        return {
            room: frozenset(used for used in imported if used.suite == suite)
            for room, imported in self.imports.items()
            if room.suite == suite
        }

    def between_suites(self) -> dict[str, frozenset[str]]:
        """Suite -> the other suites that it imports."""
        used: dict[str, set[str]] = {suite: set() for suite in SUITES}
        for room, imported in self.imports.items():
            used[room.suite] |= {other.suite for other in imported} - {room.suite}
        return {suite: frozenset(names) for suite, names in used.items()}

    def upward(self) -> list[tuple[Room, Room]]:
        """Imports of a higher suite by a lower one: there should be none."""
        height = {suite: number for number, suite in enumerate(reversed(SUITES))}
        return [
            (room, used)
            for room, imported in self.imports.items()
            for used in sorted(imported)
            if height[used.suite] > height[room.suite]
        ]

    def circles(self) -> list[list[str]]:
        """For each suite whose rooms import each other in a circle, one such circle."""
        circles = []
        for suite in SUITES:
            try:
                TopologicalSorter(self.inside(suite)).prepare()
            except CycleError as error:
                circles.append([f"{suite}/{room.label}" for room in error.args[1]])
        return circles


@cache
def read_structure() -> CodeStructure:
    """Read the imports of all modules."""
    graph = grimp.build_graph("simnfnd")
    packages = {name for name in graph.modules if graph.find_children(name)}
    imports: defaultdict[Room, set[Room]] = defaultdict(set)
    beside: defaultdict[str, list[str]] = defaultdict(list)
    for module in sorted(graph.modules):
        room = _room_of(module, packages)
        if room is not None and not room.name and module not in packages:
            beside[room.suite].append(module.rpartition(".")[2])
        for imported in graph.find_modules_directly_imported_by(module):
            used = _room_of(imported, packages)
            if room is not None and used is not None:
                imports[room].add(used)
                imports[used].update()
    return CodeStructure(
        imports={room: frozenset(imports[room] - {room}) for room in sorted(imports)},
        beside={suite: tuple(names) for suite, names in beside.items()},
    )


def _room_of(module: str, packages: set[str]) -> Room | None:
    """The room of a module; None for the package `factory`, starts and links."""
    parts = module.split(".")[1:]
    if module in _LEFT_OUT or module == "simnfnd.factory" or parts[-1:] == ["__main__"]:
        return None
    if parts[:1] == ["factory"]:
        parts = parts[1:]
    suite, *inner = parts if parts and parts[0] in SUITES else ["simnfnd", *parts]
    package = module.removesuffix("." + ".".join(inner[1:])) if inner[1:] else module
    is_in_room = bool(inner) and package in packages
    return Room(suite, inner[0] if is_in_room else "")


def draw(structure: CodeStructure) -> str:
    """Return the drawing as SVG: a band a suite, in it a box a room, with arrows to what it uses.

    A room stands to the right of all that it imports from its suite, so arrows point to the left
    and, between suites, down.  Arrows that follow from others are left out; those of a circle or
    of an upward import are red.
    """
    bands = {suite: _columns(structure.inside(suite)) for suite in SUITES}
    width_px = max(_band_width_px(columns) for columns in bands.values())
    shapes: list[str] = []
    tops_px: dict[str, tuple[float, float]] = {}
    y_px = float(_MARGIN_PX)
    for suite, columns in bands.items():
        height_px = _ROW_PX * max((len(column) for column in columns), default=1) + 10
        tops_px[suite] = (y_px, y_px + height_px)
        shapes += _band(suite, columns, structure.inside(suite), y_px, height_px, width_px)
        if len(columns) <= _FEW_COLUMNS:
            names = structure.beside.get(suite, ())
            shapes += _listing(
                names, _band_width_px(columns) + _COLUMN_GAP_PX, y_px + height_px / 2
            )
        y_px += height_px + _BAND_GAP_PX
    shapes += _suite_arrows(structure, tops_px)
    total_width_px = round(width_px + 2 * _MARGIN_PX)
    total_height_px = round(y_px - _BAND_GAP_PX + _MARGIN_PX)
    return "\n".join([_head(total_width_px, total_height_px), *shapes, "</svg>", ""])


def _columns(imports: dict[Room, frozenset[Room]]) -> list[list[Room]]:
    """The rooms of a suite by the length of their longest chain of imports; circles come last."""
    columns: list[list[Room]] = []
    placed: set[Room] = set()
    while len(placed) < len(imports):
        ready = [room for room in imports if room not in placed and imports[room] <= placed]
        columns.append(ready or [room for room in imports if room not in placed])
        placed.update(columns[-1])
    return columns


def _box_width_px(column: list[Room]) -> float:
    return max(len(room.label) for room in column) * _LETTER_PX + 2 * _BOX_PADDING_PX


def _band_width_px(columns: list[list[Room]]) -> float:
    boxes_px = sum(_box_width_px(column) + _COLUMN_GAP_PX for column in columns)
    return _LABEL_PX + boxes_px + _MARGIN_PX - _COLUMN_GAP_PX


class _Box(NamedTuple):
    """Where a box lies, in pixels."""

    left: float
    right: float
    middle: float


def _band(
    suite: str,
    columns: list[list[Room]],
    imports: dict[Room, frozenset[Room]],
    top_px: float,
    height_px: float,
    width_px: float,
) -> list[str]:
    """The shapes of one suite."""
    boxes: dict[Room, _Box] = {}
    left_px = float(_MARGIN_PX + _LABEL_PX)
    for column in columns:
        box_width_px = _box_width_px(column)
        first_px = top_px + (height_px - _ROW_PX * (len(column) - 1)) / 2
        for row, room in enumerate(column):
            middle_px = first_px + row * _ROW_PX
            boxes[room] = _Box(left_px, left_px + box_width_px, middle_px)
        left_px += box_width_px + _COLUMN_GAP_PX
    centre_px = top_px + height_px / 2
    shapes = [
        f'<rect class="band" x="{_MARGIN_PX}" y="{top_px:.0f}" width="{width_px:.0f}" '
        f'height="{height_px:.0f}" rx="6"/>',
        f'<text class="suite" x="{_MARGIN_PX + 12}" y="{centre_px - 2:.0f}">{suite}</text>',
        f'<text class="folder" x="{_MARGIN_PX + 12}" y="{centre_px + 14:.0f}">'
        f"{SUITES[suite]}</text>",
    ]
    for room, used in _needed(imports):
        shapes.append(_arrow_inside(boxes[room], boxes[used]))
    for room, box in boxes.items():
        shapes += [
            f'<rect class="room" x="{box.left:.0f}" y="{box.middle - _BOX_HEIGHT_PX / 2:.0f}" '
            f'width="{box.right - box.left:.0f}" height="{_BOX_HEIGHT_PX}" rx="4"/>',
            f'<text x="{(box.left + box.right) / 2:.0f}" y="{box.middle + 4:.0f}" '
            f'text-anchor="middle">{escape(room.label)}</text>',
        ]
    return shapes


def _listing(names: tuple[str, ...], left_px: float, middle_px: float) -> list[str]:
    """The names of modules in small letters, on as many lines as they need."""
    lines = textwrap.wrap(", ".join(names), _LISTING_LETTERS)
    first_px = middle_px + 4 - _LINE_PX * (len(lines) - 1) / 2
    return [
        f'<text class="folder" x="{left_px:.0f}" y="{first_px + row * _LINE_PX:.0f}">'
        f"{escape(line)}</text>"
        for row, line in enumerate(lines)
    ]


def _arrow_inside(user: _Box, used: _Box) -> str:
    """An arrow to the left in the row of the used room; red where the rooms form a circle."""
    kind = "arrow" if used.right < user.left else "wrong"
    bend_px = user.left - _COLUMN_GAP_PX / 2
    points = (
        f"{user.left:.0f},{user.middle:.0f} {bend_px:.0f},{used.middle:.0f} "
        f"{used.right:.0f},{used.middle:.0f}"
    )
    return f'<polyline class="{kind}" points="{points}" marker-end="url(#tip)"/>'


def _needed(imports: dict[Room, frozenset[Room]]) -> list[tuple[Room, Room]]:
    """Imports that do not follow from others."""
    reached: dict[Room, set[Room]] = {}
    for column in _columns(imports):
        for room in column:
            reached[room] = set(imports[room])
            for used in imports[room]:
                reached[room] |= reached.get(used, set())
    return [
        (room, used)
        for room, direct in imports.items()
        for used in sorted(direct)
        if not any(used in reached[other] for other in direct - {used})
    ]


def _suite_arrows(structure: CodeStructure, edges_px: dict[str, tuple[float, float]]) -> list[str]:
    """An arrow from each suite to those below it that it needs; red where it points up."""
    between = structure.between_suites()
    shapes = []
    for user, direct in between.items():
        for used in sorted(direct):
            if any(used in between[other] for other in direct - {used}):
                continue
            is_down = edges_px[used][0] > edges_px[user][0]
            start_px, end_px = edges_px[user][is_down], edges_px[used][not is_down]
            points = f"{_SUITE_ARROW_PX},{start_px:.0f} {_SUITE_ARROW_PX},{end_px:.0f}"
            kind = "arrow" if is_down else "wrong"
            shapes.append(f'<polyline class="{kind}" points="{points}" marker-end="url(#tip)"/>')
    return shapes


def _head(width_px: int, height_px: int) -> str:
    return f"""\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width_px} {height_px}" width="{width_px}" \
height="{height_px}" font-family="sans-serif" font-size="13">
<title>The suites and rooms of SimNFND, and what imports what</title>
<style>
.page {{ fill: #ffffff; }} .band {{ fill: #eef2f7; }} .room {{ fill: #ffffff; stroke: #5c6f8a; }}
.suite {{ font-weight: bold; }} .folder {{ fill: #5c6f8a; font-size: 11px; }}
.arrow {{ fill: none; stroke: #5c6f8a; }} .wrong {{ fill: none; stroke: #d00000; stroke-width: 3; }}
</style>
<defs><marker id="tip" markerWidth="7" markerHeight="7" refX="6" refY="3.5" orient="auto">\
<path d="M0,0 L7,3.5 L0,7 Z" fill="#5c6f8a"/></marker></defs>
<rect class="page" width="{width_px}" height="{height_px}"/>"""


def tabulate(rooms: Iterable[Room]) -> str:
    """The table of rooms: each folder with the first sentence of its docstring, from the top."""
    lines = ["| room | what it does |", "|---|---|"]
    of_suite: dict[str, list[Room]] = {suite: [Room(suite, "")] for suite in SUITES}
    for room in rooms:
        if room.name:
            of_suite[room.suite].append(room)
    for suite_rooms in of_suite.values():
        for room in suite_rooms:
            name = f"`{room.folder}`" if room.name else f"**`{room.folder}`**"
            lines.append(f"| {name} | {_first_sentence(room)} |")
    return "\n".join(lines) + "\n"


def _first_sentence(room: Room) -> str:
    """Raises ValueError for a room without a docstring."""
    text = ast.get_docstring(
        ast.parse((ROOT / room.folder / "__init__.py").read_text(encoding="utf-8"))
    )
    if not text:
        raise ValueError(f"{room.folder}/__init__.py has no docstring")
    paragraph = " ".join(text.split("\n\n")[0].split())
    return re.split(r"(?<=[.!?])\s+(?=[A-Z])", paragraph)[0]


def with_table(page: str, table: str) -> str:
    """A page with this table between its marks."""
    first, last = MARKS
    pattern = re.compile(f"{re.escape(first)}\n.*?{re.escape(last)}", re.DOTALL)
    return pattern.sub(lambda _: f"{first}\n{table}{last}", page)


def main() -> None:
    """Write the drawing and the table; name what points up or round."""
    structure = read_structure()
    IMAGE.write_text(draw(structure), encoding="utf-8")
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(with_table(page, tabulate(structure.imports)), encoding="utf-8")
    for room, used in structure.upward():
        print(f"upward: {room.folder} imports {used.folder}")
    for circle in structure.circles():
        print("circle: " + " -> ".join(circle))


if __name__ == "__main__":
    main()
