"""How much of the sonar's sector is insonified: the part of its bearings that hold an echo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ...common.array_types import Bools
from ...common.errors import FrameError
from ...dataset.frame_ref import FrameRef
from ..sonar import polar
from ..sonar.fan import fan_table
from ..sonar.settings import SonarSettings
from ..sonar.window import Window

THIN_SHARE = 0.2
"""Pairs that show less of the sector are counted."""


def insonified_share(filled: Bools, window: Window, sonar: SonarSettings) -> float:
    """Share of the beams that the camera saw and that meet insonified surface, 0 to 1.

    filled: (range_bins, beams) bool, bins in which insonified surface lies.
    """
    return float((filled.any(axis=0) & polar.seen_beams(window, sonar)).mean())


def check_share(ref: FrameRef, share: float, least: float | None) -> None:
    """Raise FrameError when a frame shows less of the sector than `frames.min_insonified`."""
    if least is not None and share < least:
        raise FrameError(
            f"{ref.name}: {100 * share:.0f} % of the sector is insonified and "
            f"frames.min_insonified={least:g} asks for more; see sonar.tilt_deg, sonar.altitude_m "
            "and sonar.range"
        )


def thin_pairs(directory: Path, sonar: SonarSettings) -> tuple[int, int]:
    """How many pairs of a dataset show less than THIN_SHARE of the sector, and how many there are.

    sonar: of all of them.  Variants of a frame share its shadows.
    """
    thin = total = 0
    share = 0.0
    frame = None
    for path in sorted(directory.glob("*/shard-*.h5")):
        with h5py.File(path) as shard:
            for number, row in enumerate(shard["meta"][()]):
                name = (row["location"], row["scene"], row["frame"])
                if name != frame:
                    share = _share_of_image(shard["shadow"][number], row, sonar)
                    frame = name
                thin += share < THIN_SHARE
                total += 1
    return thin, total


def _share_of_image(shadow: Bools, row: Any, sonar: SonarSettings) -> float:
    """The insonified share by the shadow mask of a sample: what is no shadow in the sector seen."""
    window = Window(
        sonar.projection,
        float(row["range_min_m"]),
        float(row["range_max_m"]),
        float(np.deg2rad(row["azimuth_min_deg"])),
        float(np.deg2rad(row["azimuth_max_deg"])),
    )
    seen_beams = polar.seen_beams(window, sonar)
    if sonar.image.layout == "polar":
        return float((~shadow.all(axis=0) & seen_beams).mean())
    table = fan_table(sonar, window.near_fraction)
    # The beam of each pixel in the sector; a small fan does not show all beams.
    beam = table.corner % sonar.beams
    is_shown = np.zeros(sonar.beams, np.bool_)
    is_shown[beam] = True
    is_insonified = np.zeros(sonar.beams, np.bool_)
    is_insonified[beam[~shadow.reshape(-1)[table.pixel]]] = True
    return float((is_insonified & seen_beams)[is_shown].mean())
