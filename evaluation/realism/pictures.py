"""A picture as it is measured, wherever it came from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...factory.sonar.geometry import FanGeometry
from .polar import Gray, Grid, to_polar


@dataclass(frozen=True)
class Source:
    """A picture that can be read when its turn comes.

    name: for messages.  read: gives (H, W) float32 grey values in 0..1; raises FactoryError.
    """

    name: str
    geometry: FanGeometry
    read: Callable[[], Gray]

    def polar(self, grid: Grid) -> Gray:
        """(range_bins, beams) float32 in 0..1."""
        return to_polar(self.read(), self.geometry, grid)


@dataclass(frozen=True)
class Collection:
    """Pictures that belong together.  name: what tables call them.  notes: for the report."""

    name: str
    sources: tuple[Source, ...]
    notes: tuple[str, ...] = ()

    def at_most(self, limit: int | None) -> Collection:
        """Evenly spread ones, when there are more than `limit`."""
        if limit is None or len(self.sources) <= limit:
            return self
        chosen = tuple(self.sources[number * len(self.sources) // limit] for number in range(limit))
        return Collection(self.name, chosen, self.notes)


def label_of(folder: Path) -> str:
    """The last part of a path, without what paths cannot do without."""
    return folder.resolve().name
