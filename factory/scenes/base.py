"""What every reader of RGBD recordings offers, and the settings they share."""

from __future__ import annotations

import sys
from dataclasses import dataclass as plain_dataclass
from dataclasses import field
from typing import Literal, Protocol

from pydantic.dataclasses import dataclass

from ..frame import Frame, FrameRef
from ..settings import STRICT

INTEGERS_PER_M = {"csv_list": 1000.0, "redwood": 1000.0, "tum": 5000.0}
"""scenes.kind -> what integer depth is divided by where `depth_scale` is null."""


@dataclass(frozen=True, config=STRICT)
class SceneSettings:
    """Keys that all `scenes` kinds have.

    depth_kind: whether the depth files hold z (along the optical axis) or slant range.
    bad_depth: what NaN, infinite and negative depths mean: a bad frame, or an unmeasured pixel.
    """

    depth_kind: Literal["z", "range"] = "z"
    bad_depth: Literal["reject", "mask"] = "reject"


@plain_dataclass(frozen=True)
class Discovery:
    """What a reader found.

    frames: every usable frame, sorted by (location, scene, frame).
    skipped: reason -> how many images were left out for it (for example no depth map).
    notes: one-line remarks for the user (which scenes are absent, which calibration was used).
    warnings: one line each, about what could not be read and is left out.
    """

    frames: tuple[FrameRef, ...]
    skipped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class Reader(Protocol):
    """Finds frames and loads them.  Built from settings alone, so a worker can build its own."""

    def discover(self) -> Discovery:
        """List the frames; recordings that cannot be read are left out and told.

        Raises FactoryError when the root is missing, or nothing in it is of use.
        """

    def load(self, ref: FrameRef) -> Frame:
        """Read one frame, checked (`frame.checked`).  Raises FrameError when it is bad."""


def frames_of(reader: Reader) -> tuple[FrameRef, ...]:
    """The frames that `reader` finds; warnings go to stderr.  Raises FactoryError as it does."""
    discovery = reader.discover()
    for line in discovery.warnings:
        print(f"warning: {line}", file=sys.stderr)
    return discovery.frames
