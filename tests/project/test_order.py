"""The order in which several processes take the files of the suite."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.conftest import pytest_collection_modifyitems


class Item:
    def __init__(self, file: str, name: str, marker: str = "") -> None:
        self.path, self.name, self.marker = Path(file), name, marker

    def get_closest_marker(self, name: str) -> str | None:
        return self.marker if self.marker == name else None


@pytest.mark.parametrize(
    ("config", "expected"),
    [(SimpleNamespace(workerinput={}), "cdefab"), (SimpleNamespace(), "abcdef")],
)
def test_files_with_a_slow_test_come_first(config: Any, expected: str) -> None:
    items: list[Any] = [
        Item("1.py", "a"),
        Item("1.py", "b", "skipif"),
        Item("2.py", "c"),
        Item("2.py", "d", "slow"),
        Item("3.py", "e", "slow"),
        Item("3.py", "f"),
    ]
    pytest_collection_modifyitems(config, items)
    assert "".join(item.name for item in items) == expected
