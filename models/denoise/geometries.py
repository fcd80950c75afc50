"""Where range and bearing lie in the pictures that `simnfnd denoise` is given."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy.typing as npt

from ...factory.sonar.geometry import FanGeometry
from ..data.fans import read_fans
from ..recordings.fan_finder import find_geometry
from .inputs import Item

FIND, POLAR, NONE = "find", "polar", "none"


class Geometries:
    """Geometry of pictures, as `--geometry` says.

    chosen: `find` it in each picture (for a video or bag in its first frame); `polar`: rows are
    ranges, near range first, and the columns span 30 degrees; `none`; or the path of a table of
    fans.
    """

    def __init__(self, chosen: str) -> None:
        """Raises FactoryError for a table that cannot be read."""
        self.chosen = chosen
        self._table = {} if chosen in (FIND, POLAR, NONE) else read_fans(chosen)
        # By the size of the pictures, too: a bag may have several topics.
        self._videos: dict[tuple[Path, tuple[int, ...]], FanGeometry | None] = {}
        # Folder, video or bag -> pictures with a fan, and all that were looked at.
        self._counts: dict[Path, tuple[int, int]] = {}

    def of(self, item: Item, picture: npt.NDArray[Any]) -> FanGeometry | None:
        """The geometry of a picture of `item`; None where it is not known."""
        if self.chosen == POLAR:
            return FanGeometry.polar().with_size(*picture.shape[:2])
        if self.chosen != FIND:
            return self._table.get(item.source.name)
        key = item.source, picture.shape
        if key in self._videos:
            return self._videos[key]
        geometry = find_geometry(picture)
        video = item.kind in ("video", "bag")
        if video:
            self._videos[key] = geometry
        place = item.source if video else item.source.parent
        with_fan, looked_at = self._counts.get(place, (0, 0))
        self._counts[place] = with_fan + (geometry is not None), looked_at + 1
        return geometry

    def summary(self) -> Iterator[str]:
        """One line a folder, video or bag whose pictures were looked at."""
        for place, (with_fan, looked_at) in self._counts.items():
            yield f"geometry: fan found in {with_fan} of {looked_at} pictures searched ({place})"
