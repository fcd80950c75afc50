"""The plan of the house: which room may use which, how full a room may be, and the map of all."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.project.allowed_rooms import ALLOWED
from tests.project.rooms import Arrow, arrows, arrows_in, circles, import_name, room_of, table
from tests.project_files import PACKAGES, ROOT, files, imports, modules

MAX_MODULES = 16
FLOORS = ("factory", "models", "evaluation")

FOUND = tuple(arrows())


def floor(room: str) -> int:
    """0 for the rooms of factory, 1 for those of models, 2 for those of evaluation."""
    return FLOORS.index(re.split("[/:]", room)[0])


def test_rooms_use_only_what_they_may() -> None:
    wrong = [
        f"{arrow.source}:{arrow.line}: {room_of(arrow.source)} uses {arrow.target}"
        for arrow in FOUND
        if (source := room_of(arrow.source)) != (target := room_of(arrow.target))
        and source != "simnfnd"
        and target not in ALLOWED.get(source, set())
    ]
    assert wrong == []


def test_the_table_allows_nothing_that_is_not_used() -> None:
    used = table(FOUND)
    assert {room: more for room in ALLOWED if (more := ALLOWED[room] - used.get(room, set()))} == {}


def test_floors_use_lower_floors_only() -> None:
    """The campaign runs programs by name, so it may use the command."""
    for room, targets in ALLOWED.items():
        for target in targets - {"conf"}:
            if target == "simnfnd":
                assert room == "evaluation/campaign"
            else:
                assert floor(target) <= floor(room), f"{room} uses {target}"


def test_no_circle_of_rooms() -> None:
    # The table of verbs names what is run, for everybody.
    assert circles(table(a for a in FOUND if a.source != "simnfnd.verbs")) == set()


def test_no_circle_of_modules() -> None:
    graph: dict[str, set[str]] = {}
    for arrow in FOUND:
        if arrow.top:
            graph.setdefault(arrow.source, set()).add(arrow.target)
    assert circles(graph) == set()


def test_rooms_are_not_too_full() -> None:
    counts: dict[str, int] = {}
    for path in modules(*PACKAGES, "benchmarks", "tools"):
        if not path.stem.startswith("__"):
            room = path.parent.as_posix()
            counts[room] = counts.get(room, 0) + 1
    assert {room: count for room, count in counts.items() if count > MAX_MODULES} == {}


def test_everything_has_one_name() -> None:
    """`simnfnd.factory`, never `factory`, wherever a program is started."""
    found = [
        f"{path}:{line}: imports {top}"
        for path in files()
        if path.suffix == ".py"
        for line, top in imports((ROOT / path).read_text(encoding="utf-8"))
        if top in PACKAGES
    ]
    assert found == []


def test_configurations_name_modules_that_exist() -> None:
    known = {import_name(path) for path in modules(*PACKAGES)}
    for path in files():
        if path.parts[0] == "conf" and path.suffix == ".yaml":
            text = (ROOT / path).read_text(encoding="utf-8")
            for target in re.findall(r"_target_: *(\S+)", text):
                assert target.rpartition(".")[0] in known, f"{path}: {target}"


def map_rooms() -> set[str]:
    """First column of the table in CONTRIBUTING.md."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    part = text.split("| room | what it does |")[1].split("\n\n")[0]
    cells = [line.split("|")[1] for line in part.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_the_map_shows_every_room_and_no_other() -> None:
    rooms = {room_of(import_name(path)) for path in modules(*FLOORS)}
    folders = {room for room in rooms if "/" in room} | {"simnfnd", "conf", "benchmarks", "tools"}
    shown = map_rooms()
    assert [name for name in shown if not (ROOT / Path(name)).exists()] == []
    assert folders - shown == set(), "rooms that CONTRIBUTING.md does not show"


# The machinery, on sources of our own.


@pytest.mark.parametrize(
    ("source", "target", "top"),
    [
        ("import simnfnd.factory.seeds", "simnfnd.factory.seeds", True),
        ("from simnfnd.factory import seeds", "simnfnd.factory.seeds", True),
        ("def f():\n    from simnfnd.factory.seeds import stream", "simnfnd.factory.seeds", False),
        ("run([exe, '-m', 'simnfnd', 'make'])", "simnfnd", False),
        ("run([exe, '-m', 'simnfnd.evaluation'])", "simnfnd.evaluation", False),
        ("run([exe, '-m', f'simnfnd.{name}'])", "simnfnd", False),
        ("run([exe, '-c', 'from simnfnd.factory.seeds import x'])", "simnfnd.factory.seeds", False),
        ("T = {'a': 'simnfnd.factory.seeds:stream'}", "simnfnd.factory.seeds", False),
        ("T = ('simnfnd.factory.seeds', 'stream')", "simnfnd.factory.seeds", False),
    ],
)
def test_every_way_to_use_a_module_is_seen(source: str, target: str, top: bool) -> None:
    assert [(a.target, a.top) for a in arrows_in("simnfnd.models.cost", source)] == [(target, top)]


def test_types_and_docstrings_are_no_use() -> None:
    source = (
        "'simnfnd.factory.seeds'\nif TYPE_CHECKING:\n    import simnfnd.factory.seeds\n"
        "print('`simnfnd make` makes one')\n"
    )
    assert list(arrows_in("simnfnd.models.cost", source)) == []


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == {frozenset({"b", "c"})}
    assert table([Arrow("simnfnd.models.cost", 1, "simnfnd.factory.seeds", True)]) == {
        "models: ground": {"factory: ground"}
    }
