"""Which objects an export holds, and the numbers of their classes in it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ...common.errors import FactoryError

BOX_CONVENTIONS = {
    "echo": "the echoes of an object",
    "echo+shadow": "the echoes of an object and its acoustic shadow",
    "object": "the whole object, the part without echoes too",
}
"""What a box can be around; the first is the default."""


@dataclass(frozen=True)
class ObjectSelection:
    """What a user asks of the objects of an export.

    class_names: classes to export, in the order of their numbers; empty: those that occur.
    min_side_px: smallest width and height of a box, pixels; None: the default of the format.
    min_visibility_db: least visibility; None: no limit.
    box: what a box is around; see BOX_CONVENTIONS.
    Raises FactoryError for a class that is named twice, a size below 1, and another convention.
    """

    class_names: tuple[str, ...] = ()
    min_side_px: int | None = None
    min_visibility_db: float | None = None
    box: str = "echo"

    def __post_init__(self) -> None:
        for name in self.class_names:
            if self.class_names.count(name) > 1:
                raise FactoryError(f"--classes names {name} twice")
        if self.min_side_px is not None and self.min_side_px < 1:
            raise FactoryError(f"--min-size {self.min_side_px}: expected 1 pixel or more")
        limit_db = self.min_visibility_db
        if limit_db is not None and not math.isfinite(limit_db):
            raise FactoryError(f"--min-visibility {limit_db}: expected a number of decibels")
        if self.box not in BOX_CONVENTIONS:
            raise FactoryError(f"--box {self.box}: expected one of {', '.join(BOX_CONVENTIONS)}")

    def describe_boxes(self) -> str:
        """What a box is around, and which objects are too faint, as sentences for a README."""
        text = f"A box (convention `{self.box}`) is around {BOX_CONVENTIONS[self.box]}."
        if self.min_visibility_db is None:
            return text
        return f"{text} Objects of a visibility below {self.min_visibility_db:g} dB are left out."

    @property
    def is_default(self) -> bool:
        """Whether the user asks for nothing special."""
        return self == ObjectSelection()

    def list_classes(self, known: tuple[str, ...], occurring: Iterable[str]) -> ClassList:
        """The classes of an export.

        known: all classes of the dataset, the background first.
        occurring: the classes of the objects that are large enough.
        Without any object the list is that of the dataset, because readers refuse an empty one.
        Raises FactoryError for a class that the dataset does not know.
        """
        for name in self.class_names:
            if name not in known[1:]:
                raise FactoryError(
                    f"--classes {name}: the dataset has no such class; one of "
                    f"{', '.join(known[1:])}"
                )
        if self.class_names:
            return ClassList(self.class_names)
        occurring_names = set(occurring)
        listed = tuple(name for name in known[1:] if name in occurring_names)
        return ClassList(listed or known[1:])


@dataclass(frozen=True)
class ClassList:
    """The classes of an export, in the order of their numbers."""

    names: tuple[str, ...]

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def number(self, name: str) -> int:
        """The number of a class, from 1."""
        return self.names.index(name) + 1

    def describe(self, first_number: int = 1) -> str:
        """The classes and their numbers, for a README."""
        return ", ".join(f"{number} {name}" for number, name in enumerate(self.names, first_number))
