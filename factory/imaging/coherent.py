"""The physical image formation: a frame by the sonar equation.

    scatterers -> speckle, haze, multipath -> pulse and beams -> leaks, receiver noise
      -> time-varying gain -> channels, interference, saturation -> transfer curve -> picture

The clean picture comes through the same device, gain and transfer curve without the noise; see
`acoustics.target`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..sonar import polar, transfer
from ..sonar.settings import SonarSettings
from ..sonar.surface import LitSurface
from .contract import Floats, Layers
from .effect import DrawnEffect
from .expected import Expected, averaged, display, expected
from .pointwise import EffectCloud, effect_clouds
from .scatterers import scatterers
from .settings import AcousticsSettings
from .signal import Ping, Receiver, Signal, beamform, beamform_power, sounds

if TYPE_CHECKING:
    from .contract import ImagingSettings


@dataclass(frozen=True, eq=False)
class FieldScene:
    """A frame as the device receives it; a `contract.Scene`.

    ping: at the raw samples.  geometry: grey values and full scale of the clean picture where
    `acoustics.target` is that.  sonar: the device with the range bins of the picture.
    """

    surface: LitSurface
    ping: Ping
    geometry: tuple[Floats, float] | None
    sonar: SonarSettings

    @property
    def samples(self) -> int:
        """Raw samples whose intensities a range bin averages."""
        return self.sonar.samples_per_bin

    @property
    def filled(self) -> npt.NDArray[np.bool_]:
        """See `contract.Scene`."""
        rows, beams = self.ping.shape
        by_bin = self.ping.scatterers.in_beam.reshape(rows // self.samples, self.samples, beams)
        return np.asarray(by_bin.any(axis=1))

    def sample(
        self, variant: int, effects: Sequence[DrawnEffect], config: ImagingSettings
    ) -> FieldSample:
        """See `contract.Scene`."""
        acoustics, full_scale = config.acoustics, self.ping.full_scale
        return FieldSample(
            self,
            effects,
            acoustics.target,
            acoustics.standing,
            len(self.ping.scatterers.bins),
            full_scale,
            full_scale if self.geometry is None else self.geometry[1],
        )


@dataclass(frozen=True, eq=False)
class FieldSample:
    """A scene with the effects of one sample, all of its scatterers kept; a `contract.Sample`."""

    scene: FieldScene
    effects: Sequence[DrawnEffect]
    target: str
    standing: float
    points: int
    full_scale: float
    clean_full_scale: float
    rate: float = 1.0

    @property
    def clean(self) -> Floats:
        """See `contract.Sample`."""
        if self.scene.geometry is not None:
            return self.scene.geometry[0]
        systematic = self.target == "mean_log"
        ping = self.scene.ping
        return self._displayed(
            expected(ping, self.effects, systematic=systematic, standing=self.standing)
        )

    def _displayed(self, state: Expected, clouds: Sequence[EffectCloud] = ()) -> Floats:
        """The expected picture of intensities at the raw samples, and the clouds' echoes."""
        ping = self.scene.ping
        state = state.averaged(ping.kernel, self.scene.samples)
        for cloud in clouds:
            extra = polar.accumulate(cloud.echoes, ping.window, self.scene.sonar)
            state.steady += np.float32(ping.full_scale) * extra**2
        grey = display(state, ping.full_scale, ping.sonar.transfer)
        return polar.where_seen(grey, ping.window, ping.sonar)

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
        level = _averaged_amplitude(level, self.scene.samples)
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
        acting = [e for e in self.effects if e.name in kept or e.artefact == "speckle"]
        state = expected(ping, acting, realised=True, standing=self.standing)
        return self._displayed(state, [cloud for cloud in self.clouds if cloud.name in kept])


def observe(surface: LitSurface, config: ImagingSettings) -> FieldScene:
    """See `contract.Formation`."""
    water, acoustics, samples = config.water, config.acoustics, config.sonar.samples_per_bin
    # The device with a range bin for each raw sample.
    bins = samples * config.sonar.range_bins
    sonar = replace(config.sonar, range_bins=bins, samples_per_bin=1)
    window = surface.window
    found = scatterers(surface.frame, surface.rendered, window, sonar, water, acoustics)
    receiver = Receiver(window, sonar, water)
    gain = time_varying_gain(receiver, acoustics)
    power = beamform_power(found.power, receiver)
    seen = polar.seen_beams(window, sonar)
    # That of the bins that hold an echo alone says how bright the picture is shown.
    echoing = np.where((found.power > 0) & seen, np.sqrt(power * gain[:, None]), np.float32(0))
    fixed_db = sonar.transfer.full_scale_db
    if fixed_db is None:
        echoing = _averaged_amplitude(echoing, samples)
        full_scale = transfer.full_scale(echoing, sonar.transfer)
    else:
        full_scale = 10 ** (fixed_db / 20)
    strongest = float((power * seen).max())
    ping = Ping(window, sonar, water, found, gain, full_scale**2, strongest, power)
    geometry = _geometry(surface, config.sonar) if acoustics.target == "geometry" else None
    return FieldScene(surface, ping, geometry, config.sonar)


def _geometry(surface: LitSurface, sonar: SonarSettings) -> tuple[Floats, float]:
    """The paper's T, of the points: (range_bins, beams) grey values, and the full scale."""
    points = polar.accumulate(surface.insonified.echoes, surface.window, sonar)
    level = polar.spread_points(points, sonar)
    intensity = transfer.full_scale(level, sonar.transfer, "intensity")
    grey = transfer.grey(level, intensity, sonar.transfer, "intensity")
    return polar.where_seen(grey, surface.window, sonar), intensity


def _averaged_amplitude(amplitude: Floats, samples: int) -> Floats:
    """The root of the mean intensity of each `samples` rows."""
    return amplitude if samples == 1 else np.sqrt(averaged(amplitude**2, samples))


def time_varying_gain(receiver: Receiver, acoustics: AcousticsSettings) -> Floats:
    """(range_bins,) float32 gain on intensity, k log10 r + 2 a r in dB; see `AcousticsSettings`."""
    range_m = np.maximum(receiver.range_m.astype(np.float64), 1e-3)
    gain_db = acoustics.tvg_log * np.log10(range_m)
    if acoustics.tvg_absorption:
        gain_db += 2 * receiver.absorption_db_per_m * range_m
    return np.asarray(10 ** (gain_db / 10), np.float32)


def received(ping: Ping, effects: Sequence[DrawnEffect]) -> Floats:
    """(range_bins, beams) float32 amplitude after time-varying gain, with the drawn effects."""
    field = received_field(ping, effects)
    intensity = np.zeros(ping.shape, np.float32)
    for real, imaginary in field:
        intensity += real * real + imaginary * imaginary
    return np.asarray(np.sqrt(intensity / np.float32(len(field))))


def received_field(ping: Ping, effects: Sequence[DrawnEffect]) -> Floats:
    """(looks, 2, range_bins, beams) float32 field after time-varying gain, over the source level.

    Effects of a stage act in the order in which they are given; those of stage points do not act.
    """
    signal = Signal(ping.scatterers.power, np.zeros((1, 2, *ping.shape), np.float32))
    for effect in effects:
        if effect.stage == "echo":
            signal = effect.apply(signal, ping)
    field = beamform(signal.field, ping) if sounds(signal.field) else signal.field
    if sounds(signal.power):
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
        intensity = averaged(intensity, samples)
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
