"""The name of a frame, small enough to send to another process."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FrameRef:
    """Where a frame is, small enough to send to another process.

    `scene` is the unit that train and test are split by: one recording (FLSea) or one procedural
    seed (seabed).  `location` is the area it belongs to.  `paths` are the reader's own business.
    """

    location: str
    scene: str
    frame: str
    paths: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """`location/scene/frame`, unique in a dataset (without the location when it is empty)."""
        return "/".join(part for part in (self.location, self.scene, self.frame) if part)
