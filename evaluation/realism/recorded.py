"""Frames of recordings as real pictures, with the fan that the file or the picture tells."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings import open_recording
from ...models.recordings.fan.finder import find_geometry
from ...models.recordings.fan.pings import frame_picture
from .pictures import Source
from .polar import Gray


def recorded(path: Path) -> tuple[Source, ...]:
    """All frames of a recording; the fan of a video is found in its first frame.

    Raises FactoryError when it cannot be read, or nothing tells where range and bearing are.
    """
    sources: list[Source] = []
    found: FanGeometry | None = None
    with open_recording(path) as recording:
        count = len(recording)
    for number in range(count):
        picture, geometry = frame_picture(path, number)
        if geometry is None and found is None:
            found = find_geometry(picture)
        geometry = geometry or found
        if geometry is None:
            raise FactoryError(
                f"real={path}: no fan is seen in its pictures; save its frames as pictures beside "
                "a geometry.csv (docs/realism.md says how)"
            )
        sources.append(Source(f"{path.name}#{number}", geometry, partial(_picture, path, number)))
    return tuple(sources)


def _picture(path: Path, number: int) -> Gray:
    return frame_picture(path, number)[0]
