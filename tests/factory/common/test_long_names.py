"""Files whose names are as long as a file system takes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from simnfnd.factory.common.files import shortened, write_atomically

LONGEST = {"letters": "a" * 250 + ".png", "of two bytes": "ü" * 125 + ".png"}


@pytest.mark.parametrize("kind", LONGEST)
def test_a_file_of_the_longest_name_is_written(tmp_path: Path, kind: str) -> None:
    path = tmp_path / LONGEST[kind]
    write_atomically(path, b"content")
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == b"content"


def test_shortened_names_stay_different() -> None:
    names = ["ü" * 120 + ending for ending in ("a.png", "b.png")]
    first, second = (shortened(name, 100) for name in names)
    assert first != second
    assert max(len(name.encode()) for name in (first, second)) <= 100
    assert shortened("short.png") == "short.png"
