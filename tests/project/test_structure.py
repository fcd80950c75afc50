"""docs/architecture.md shows the code as it is: its drawing, its rooms, the files that it names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.project_files import ROOT
from tools.structure import (
    IMAGE,
    PAGE,
    SUITES,
    CodeStructure,
    Room,
    draw,
    read_structure,
    tabulate,
    with_table,
)


def test_the_page_shows_the_code_as_it_is() -> None:
    structure = read_structure()
    assert IMAGE.read_text(encoding="utf-8") == draw(structure), "run python -m tools.structure"
    page = PAGE.read_text(encoding="utf-8")
    table = tabulate(structure.imports)
    assert table in page, "run python -m tools.structure"
    assert with_table(page, table) == page
    assert f"images/{IMAGE.name}" in page


def test_no_import_points_up_or_round() -> None:
    structure = read_structure()
    assert {room.suite for room in structure.imports} == set(SUITES)
    assert structure.upward() == []
    assert structure.circles() == []


def test_a_wrong_import_is_seen_and_drawn_red() -> None:
    low, high, other = Room("common", "low"), Room("common", "high"), Room("models", "other")
    imports = {room: frozenset[Room]() for room in (low, high, other)}
    right = CodeStructure({**imports, high: frozenset({low}), other: frozenset({high})}, {})
    assert (right.upward(), right.circles()) == ([], [])
    assert 'class="wrong"' not in draw(right)
    up = CodeStructure({**imports, low: frozenset({other})}, {})
    assert up.upward() == [(low, other)]
    assert 'class="wrong"' in draw(up)
    circle = CodeStructure({**imports, low: frozenset({high}), high: frozenset({low})}, {})
    assert set(circle.circles()[0]) == {"common/low", "common/high"}
    assert 'class="wrong"' in draw(circle)


def test_an_arrow_that_follows_from_others_is_left_out() -> None:
    low, middle, high = (Room("models", name) for name in ("low", "middle", "high"))
    imports = {low: frozenset[Room](), middle: frozenset({low}), high: frozenset({low, middle})}
    assert draw(CodeStructure(imports, {})).count('class="arrow"') == 2


def test_a_room_without_a_docstring_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tools.structure.ROOT", tmp_path)
    (tmp_path / "models/bare").mkdir(parents=True)
    (tmp_path / "models/__init__.py").write_text('"""Holds them.  Not shown."""\n')
    (tmp_path / "models/bare/__init__.py").touch()
    monkeypatch.setattr("tools.structure.SUITES", {"models": "models"})
    assert tabulate([]).splitlines()[-1] == "| **`models`** | Holds them. |"
    with pytest.raises(ValueError, match="models/bare"):
        tabulate([Room("models", "bare")])


def test_files_named_on_the_architecture_page_are_there() -> None:
    """Full paths, and file names alone that stand in the folder of a path of the same line."""
    text = PAGE.read_text(encoding="utf-8")
    full = re.compile(r"`((?:factory|models|evaluation|simnfnd|conf|docs)/[\w./]+)`")
    assert len(full.findall(text)) > 60
    for line in text.splitlines():
        paths = [ROOT / name for name in full.findall(line)]
        assert [path for path in paths if not path.exists()] == [], line
        folders = [path if path.is_dir() else path.parent for path in paths]
        for name in re.findall(r"`([a-z_/]+\.py)`", line):
            if "/" not in name or not full.fullmatch(f"`{name}`"):
                assert any((folder / name).exists() for folder in folders), f"{name} in {line}"


def test_classes_and_rooms_named_in_the_glossary_are_there() -> None:
    text = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
    names = re.findall(r"\| .*`((?:factory|models)\.[\w.]+)`", text)
    assert len(names) > 8
    for name in names:
        room, _, last = name.rpartition(".")
        if last[0].islower():
            path = ROOT / name.replace(".", "/")
            assert path.is_dir() or path.with_suffix(".py").is_file(), name
            continue
        module = ROOT / room.replace(".", "/")
        source = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        assert f"\nclass {last}" in source.read_text(encoding="utf-8"), name
