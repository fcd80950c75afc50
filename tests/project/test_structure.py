"""docs/architecture.md shows the code as it is: its drawing, its rooms, the files that it names."""

from __future__ import annotations

import re

from tests.project_files import ROOT
from tools.structure import (
    IMAGE,
    PAGE,
    SUITES,
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
