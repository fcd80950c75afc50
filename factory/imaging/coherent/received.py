"""What the receiver gives of one ping: the order in which signal, beams, gain and effects act."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from ...errors import FrameError
from ...sonar import polar
from ..contract import DrawnEffect, Floats, Layers
from . import decimation
from .signal import Ping, Signal, beamform, beamform_power


def received(ping: Ping, effects: Sequence[DrawnEffect]) -> Floats:
    """(range_bins, beams) float32 amplitude after time-varying gain, with the drawn effects."""
    from . import kernels  # loads numba

    level = np.empty(ping.shape, np.float32)
    kernels.amplitude(received_field(ping, effects), level)
    return level


def received_field(ping: Ping, effects: Sequence[DrawnEffect]) -> Floats:
    """(looks, 2, range_bins, beams) float32 field after time-varying gain, over the source level.

    Effects of a stage act in the order in which they are given; those of stage points do not act.
    """
    signal = Signal(ping.scatterers.power, np.zeros((1, 2, *ping.shape), np.float32))
    for effect in effects:
        if effect.stage == "echo":
            signal = effect.apply(signal, ping)
    field = beamform(signal.field, ping) if signal.field.any() else signal.field
    if signal.power.any():
        # What has no speckle arrives at its expected strength, in phase.
        field[:, 0] += np.sqrt(beamform_power(signal.power, ping))
    for effect in effects:
        if effect.stage == "beam":
            field = effect.apply(field, ping)
    field *= np.sqrt(ping.gain)[:, None]
    for effect in effects:
        if effect.stage == "picture":
            field = effect.apply(field, ping)
    return field


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
