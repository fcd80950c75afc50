"""Where the rooms of the package are, and that each is imported under one name.

In a checkout `simnfnd/factory`, `models`, `evaluation` and `conf` are links to the folders beside
the package.  An archive may turn links into text files; the folders themselves are then searched.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType

ROOMS = ("factory", "models", "evaluation", "conf")


def search_path(package: Path) -> list[str]:
    """Folders in which the modules of the package are looked for.  package: its own."""
    root = package.parent
    has_rooms = all((package / room).is_dir() for room in ROOMS)
    beside = all((root / room / "__init__.py").is_file() for room in ROOMS)
    return [str(package), *([str(root)] if beside and not has_rooms else [])]


def refuse_modules_of(room: str) -> None:
    """Let nothing but `__main__` be imported from a room that was imported without its package.

    From the root of a checkout `import factory.errors` would make a second module beside
    `simnfnd.factory.common.errors`, with errors of its own that no `except` of the package catches.
    """
    sys.meta_path.insert(0, _Refusal(room))


class _Refusal:
    """Raises ImportError for the modules of one room."""

    def __init__(self, room: str) -> None:
        self._room = room

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Raise ImportError for a module of the room; returns None for others."""
        if not fullname.startswith(f"{self._room}.") or fullname == f"{self._room}.__main__":
            return None
        raise ImportError(f"{fullname}: import simnfnd.{fullname} instead", name=fullname)
