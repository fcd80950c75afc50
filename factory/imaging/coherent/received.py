"""What the receiver gives of one ping: the order in which signal, beams, gain and effects act."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..contract import DrawnEffect, Floats
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
