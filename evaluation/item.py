"""One pair of a report: where it is, and what it shows.

A module of its own, for datasets (`pairs`) and folders of pictures (`image_files`) both need it.
"""

from __future__ import annotations

from dataclasses import dataclass

ROW = -1
"""Stands in a `Place` for: an image file, no shard."""

Place = tuple[str, int]
"""Shard file and row, or a noisy image file and ROW."""


@dataclass(frozen=True)
class Item:
    """One pair: where it is and what it shows.

    split, number: as `simnfnd export --to png` names it; of image files '' and their order.
    key: changes with the content of the pair.
    looks: the noise variants of the same frame in the same split, this one last; methods of
    several looks see all of them.
    """

    shard: str
    place: Place
    split: str
    number: int
    key: str
    location: str
    scene: str
    frame: str
    variant: int
    looks: tuple[Place, ...]

    @property
    def group(self) -> str:
        """What shares one clean image: the unit of the bootstrap."""
        return f"{self.location}/{self.scene}/{self.frame}"
