"""What was received, in units: sound pressure at the receiver, before time-varying gain."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ...errors import FrameError
from ...sonar import polar
from ..contract import DrawnEffect, Layers
from . import decimation
from .received import received_field
from .signal import Ping


def calibrated(
    ping: Ping, effects: Sequence[DrawnEffect], layers: Collection[str], samples: int
) -> Mapping[str, Layers]:
    """Of layers intensity_db, field: (range_bins, beams) float32 dB re 1 uPa, complex64 uPa.

    What saturates and what the device adds is in them as it is in the picture.
    samples: raw samples whose intensities a range bin averages.
    Raises FrameError for the field of several looks.
    """
    field = received_field(ping, effects)
    source = 10 ** (ping.sonar.array.source_level_db / 20)
    field *= np.float32(source) / np.sqrt(ping.gain)[:, None]
    seen = polar.seen_beams(ping.window, ping.sonar)
    made: dict[str, Layers] = {}
    if "intensity_db" in layers:
        intensity = (field**2).sum(axis=1).mean(axis=0)
        intensity = decimation.averaged(intensity, samples)
        with np.errstate(divide="ignore"):
            level_db = 10 * np.log10(intensity)
        known = seen & (intensity > 0)
        made["intensity_db"] = np.where(known, level_db, np.nan).astype(np.float32)
    if "field" in layers:
        if len(field) > 1:
            raise FrameError("layer field is of one look; set the looks of speckle to 1")
        complex_field = (field[0, 0] + 1j * field[0, 1]).astype(np.complex64)
        made["field"] = np.where(seen, complex_field, np.complex64(0))
    return made
