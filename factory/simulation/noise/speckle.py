"""Fully developed speckle of the complex field."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.distribution import CellSize, Looks
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.ghosts import GhostScatterers
from ..imaging.scatterers import shares
from ..imaging.signal import Ping, PointEchoes, Signal, beamform, scattered

# Edge of a world cell as a fraction of the device's resolution; power is then within 0.15 dB.
_CELL_OF_RESOLUTION = 0.3


@dataclass(frozen=True, config=STRICT)
class SpeckleSettings(EffectSettings):
    """Keys of `noise.speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    scatterer_m: edge of a world cell, metres; 0 takes 0.3 of a range bin or of the resolution
        c / 2B, whichever is shorter.  A cell that reaches over several of them loses power and
        makes neighbouring bins alike.  Cells smaller than the camera's pixels lose their hold on
        the scene when the camera moves.
    """

    looks: Looks = parameter(1, "1")
    scatterer_m: CellSize = parameter(0, "m")


def speckle(signal: Signal, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float) -> Signal:
    """The scatterers' complex field instead of the mean power of the echoes.

    Every scatterer has a complex circular Gaussian coefficient that depends on its cell of the
    world alone, and the device's point-spread gives the field its grain: fully developed, amplitude
    Rayleigh, intensity exponential (Goodman, Speckle Phenomena in Optics, ch. 3); the average of L
    looks is gamma-distributed, L its shape.  Without poses every frame has a field of its own.
    """
    return _scatter_cells(ping, rng, looks, scatterer_m)


def _scatter_cells(ping: Ping, rng: Rng, looks: float, scatterer_m: float) -> Signal:
    """Return the field of all scatterers, those of one cell with the cell's coefficient."""
    scene = ping.scatterers
    # A cell that reaches over several bins or resolution lengths would lose power.
    finest_m = min(ping.bin_m, ping.resolution_m)
    cell_m = scatterer_m or _CELL_OF_RESOLUTION * finest_m
    cells, amplitude_factors = scene.world_cells(cell_m)
    no_phases = np.empty(0, np.uint16)
    echoes = PointEchoes(scene.bins, np.sqrt(scene.powers), cells, amplitude_factors, no_phases)
    if scene.ghosts is not None:
        echoes = _with_ghosts(echoes, scene.ghosts, cell_m)
    return scattered(ping, rng, looks, echoes)


def _with_ghosts(echoes: PointEchoes, ghosts: GhostScatterers, cell_m: float) -> PointEchoes:
    """Return the echoes, then those of the ghosts."""
    from ..imaging import kernels  # loads numba

    names = ghosts.names(cell_m)
    return PointEchoes(
        np.concatenate([echoes.bins, ghosts.bins]),
        np.concatenate([echoes.amplitudes, np.sqrt(ghosts.powers)]),
        np.concatenate([echoes.cells, names]),
        np.concatenate([echoes.shares, shares(names, kernels.scrambled(names))]),
        echoes.phases,
    )


def expect_speckle(
    state: Expected, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float
) -> None:
    """Split the expected power into speckle that averages out over pings and speckle that stays.

    The field of a ping is sqrt(p) F + sqrt(1 - p) G, with p = `standing`.  F is the same in every
    ping and G is drawn anew, so a mean of pings keeps the speckle of F and only the mean power of
    G: the part 1 - p of the power moves from `steady` to `echo`, and `steady` becomes the intensity
    of sqrt(p) F.

    The noisy image of this pair shows one such sum, S, and F is to be what lies in it.  S and F are
    Gaussian with the same variance and the correlation sqrt(p).  F given S is therefore
    sqrt(p) S + sqrt(1 - p) H, with H independent of S.
    """
    static_part = state.standing
    state.echo += (1 - static_part) * state.steady
    state.steady[:] = 0
    state.looks = max(round(looks), 1)
    if static_part == 0:
        return

    # The effect's random stream gives the noisy image its field first, so S is the first draw.
    noisy_field = _scatter_cells(ping, rng, looks, scatterer_m).field
    independent_field = _scatter_cells(ping, rng, looks, scatterer_m).field
    static_field = np.float32(np.sqrt(static_part)) * noisy_field
    static_field += np.float32(np.sqrt(1 - static_part)) * independent_field
    intensity = (beamform(static_field, ping) ** 2).sum(axis=1).mean(axis=0)
    state.steady[:] = static_part * intensity


SPECKLE = Effect(
    SpeckleSettings,
    speckle,
    stage="echo",
    artefact="speckle",
    scope="world",
    expected=expect_speckle,
)
