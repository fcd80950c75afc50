"""The physical image formation: a frame by the sonar equation.

    scatterers -> speckle, haze, multipath -> pulse and beams -> leaks, receiver noise
      -> time-varying gain -> channels, interference, saturation -> transfer curve -> picture

The clean picture comes through the same device, gain and transfer curve without the noise; see
`acoustics.target`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ...sonar import polar, transfer
from ...sonar.settings import SonarSettings
from ...sonar.surface import LitSurface
from ..clouds import EffectCloud, effect_clouds
from ..contract import DrawnEffect, Floats, Layers
from . import decimation
from .expected import Expected, display, expected
from .received import calibrated, received
from .scatterers import scatterers
from .settings import AcousticsSettings
from .signal import Ping, Receiver, beamform_power
from .targets import Target, target

if TYPE_CHECKING:
    from ..contract import ImagingSettings


@dataclass(frozen=True, eq=False)
class FieldScene:
    """A frame as the device receives it; a `contract.Scene`.

    ping: at the raw samples.  target: what its clean pictures are, where noise has no part in it.
    sonar: the device with the range bins of the picture, `samples` raw samples each.
    """

    surface: LitSurface
    ping: Ping
    target: Target | None
    sonar: SonarSettings

    @property
    def samples(self) -> int:
        """Raw samples whose intensities a range bin averages."""
        return self.sonar.samples_per_bin

    @property
    def filled(self) -> npt.NDArray[np.bool_]:
        """See `contract.Scene`."""
        return decimation.any_of(self.ping.scatterers.in_beam, self.samples)

    def sample(
        self, variant: int, effects: Sequence[DrawnEffect], config: ImagingSettings
    ) -> FieldSample:
        """See `contract.Scene`."""
        acoustics = config.acoustics
        return FieldSample(self, effects, acoustics.target, acoustics.standing)


@dataclass(frozen=True, eq=False)
class FieldSample:
    """A scene with the effects of one sample; a `contract.Sample`."""

    scene: FieldScene
    effects: Sequence[DrawnEffect]
    target: str
    standing: float = 0.0

    @property
    def rate(self) -> float:
        """See `contract.Sample`; all scatterers are kept."""
        return 1.0

    @property
    def points(self) -> int:
        """See `contract.Sample`."""
        return len(self.scene.ping.scatterers.bins)

    @property
    def full_scale(self) -> float:
        """See `contract.Sample`."""
        return self.scene.ping.full_scale

    @property
    def clean_full_scale(self) -> float:
        """See `contract.Sample`."""
        return self.full_scale if self.scene.target is None else self.scene.target.full_scale

    @property
    def clean(self) -> Floats:
        """See `contract.Sample`."""
        ping = self.scene.ping
        if self.scene.target is not None:
            return self.scene.target.grey
        systematic = self.target == "mean_log"
        state = expected(ping, self.effects, systematic=systematic, standing=self.standing)
        state = self._averaged(state)
        grey = display(state, ping.full_scale, ping.sonar.transfer)
        return polar.where_seen(grey, ping.window, ping.sonar)

    def _averaged(self, state: Expected) -> Expected:
        return decimation.averaged_expected(state, self.scene.ping.kernel, self.scene.samples)

    @cached_property
    def clouds(self) -> tuple[EffectCloud, ...]:
        """What the effects of stage points add."""
        effects = [effect for effect in self.effects if effect.stage == "points"]
        if not effects:
            return ()
        echoes = self.scene.surface.insonified.echoes
        return effect_clouds(effects, echoes, echoes, self.scene.ping.window)

    @cached_property
    def added(self) -> Mapping[str, int]:
        """See `contract.Sample`."""
        return {cloud.name: len(cloud.echoes) for cloud in self.clouds}

    def noisy(self, effects: Collection[str]) -> Floats:
        """See `contract.Sample`."""
        ping = self.scene.ping
        level = received(ping, [effect for effect in self.effects if effect.name in effects])
        level = decimation.averaged_amplitude(level, self.scene.samples)
        # The strengths of the points are fractions of full scale.
        full_scale = np.sqrt(ping.full_scale)
        for cloud in self.clouds:
            if cloud.name in effects:
                extra = np.float32(full_scale) * polar.accumulate(
                    cloud.echoes, ping.window, self.scene.sonar
                )
                level = np.sqrt(level**2 + extra**2)
        grey = transfer.grey(level, float(full_scale), ping.sonar.transfer)
        return polar.where_seen(grey, ping.window, ping.sonar)

    def measured(self, effects: Collection[str], layers: Collection[str]) -> Mapping[str, Layers]:
        """See `contract.Sample`."""
        if not {"intensity_db", "field"}.intersection(layers):
            return {}
        acting = [effect for effect in self.effects if effect.name in effects]
        return calibrated(self.scene.ping, acting, layers, self.scene.samples)

    def without(self, artefacts: Collection[str]) -> Floats:
        """See `contract.Sample`."""
        ping = self.scene.ping
        kept = {e.name for e in self.effects if e.artefact not in artefacts}
        if "speckle" not in artefacts:
            return self.noisy(kept)
        # Speckle is not switched off but averaged: its mean lifts and lowers a display of levels.
        averaged = [e for e in self.effects if e.name in kept or e.artefact == "speckle"]
        state = expected(ping, averaged, realised=True, standing=self.standing)
        state = self._averaged(state)
        for cloud in self.clouds:
            if cloud.name in kept:
                extra = polar.accumulate(cloud.echoes, ping.window, self.scene.sonar)
                state.steady += np.float32(ping.full_scale) * extra**2
        grey = display(state, ping.full_scale, ping.sonar.transfer)
        return polar.where_seen(grey, ping.window, ping.sonar)


def observe(surface: LitSurface, config: ImagingSettings) -> FieldScene:
    """See `contract.Formation`."""
    from . import kernels  # loads numba

    sonar, water, acoustics = decimation.raw(config.sonar), config.water, config.acoustics
    samples = config.sonar.samples_per_bin
    frame, rendered, window = surface.frame, surface.rendered, surface.window
    found = scatterers(frame, rendered, window, sonar, water, acoustics)
    receiver = Receiver(window, sonar, water)
    gain = time_varying_gain(receiver, acoustics)
    power = beamform_power(found.power, receiver)
    amplitude, echoing = np.empty_like(power), np.empty_like(power)
    strongest = kernels.expectation(
        power, gain, found.power, polar.seen_beams(window, sonar), amplitude, echoing
    )
    amplitude = decimation.averaged_amplitude(amplitude, samples)
    echoing = decimation.averaged_amplitude(echoing, samples)
    fixed_db = sonar.transfer.full_scale_db
    if fixed_db is None:
        full_scale = transfer.full_scale(echoing, sonar.transfer)
    else:
        full_scale = 10 ** (fixed_db / 20)
    ping = Ping(window, sonar, water, found, gain, full_scale**2, float(strongest), power)
    clean = target(surface, config, amplitude, full_scale)
    return FieldScene(surface, ping, clean, config.sonar)


def time_varying_gain(receiver: Receiver, acoustics: AcousticsSettings) -> Floats:
    """(range_bins,) float32 gain on intensity, k log10 r + 2 a r in dB; see `AcousticsSettings`."""
    range_m = np.maximum(receiver.range_m.astype(np.float64), 1e-3)
    gain_db = acoustics.tvg_log * np.log10(range_m)
    if acoustics.tvg_absorption:
        gain_db += 2 * receiver.absorption_db_per_m * range_m
    return np.asarray(10 ** (gain_db / 10), np.float32)
