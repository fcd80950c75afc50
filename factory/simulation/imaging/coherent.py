"""The physical image formation: a frame by the sonar equation.

    scatterers -> speckle, haze, multipath -> pulse and beams -> leaks, receiver noise
      -> time-varying gain -> channels, interference, saturation -> transfer curve -> image

The clean image comes through the same device, gain and transfer curve without the noise; see
`acoustics.target`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...common.array_types import Array, Bools, Float32s
from ...common.errors import FrameError
from ..sonar import polar, transfer
from .contract import EffectCloud, SceneSample, effect_clouds
from .effect import DrawnEffect
from .expected import Expected, display, expected
from .signal import Ping, Signal, averaged, beamform, beamform_power, is_audible


@dataclass(frozen=True, eq=False)
class CoherentScene(Ping):
    """A frame as the device receives it: what all its samples share; no randomness.

    static: the same of the scene without moving objects, which decides the scale of the image;
        None where nothing moves.
    """

    static: CoherentScene | None = None

    @cached_property
    def strongest(self) -> float:
        """See `Ping`."""
        return super().strongest if self.static is None else self.static.strongest

    @cached_property
    def full_scale(self) -> float:
        """See `Ping`."""
        return super().full_scale if self.static is None else self.static.full_scale

    @property
    def filled(self) -> Bools:
        """(range_bins, beams) bool: bins in which insonified surface lies."""
        rows, beams = self.shape
        samples = self.surface.sonar.samples_per_bin
        by_bin = self.scatterers.in_beam.reshape(rows // samples, samples, beams)
        return np.asarray(by_bin.any(axis=1))

    def sample(self, variant: int, effects: Sequence[DrawnEffect]) -> CoherentSample:
        """One sample; equal calls, equal bytes."""
        on_points = [effect for effect in effects if effect.stage == "points"]
        clouds: tuple[EffectCloud, ...] = ()
        if on_points:
            clouds = effect_clouds(on_points, self.surface.insonified.echoes, self.window)
        return CoherentSample(effects, clouds, 1.0, self.scatterers.count, self.full_scale, self)


@dataclass(frozen=True, eq=False)
class CoherentSample(SceneSample):
    """A scene with the effects of one sample, all of its scatterers kept."""

    scene: CoherentScene

    @property
    def clean(self) -> Float32s:
        """See `SceneSample`."""
        acoustics = self.scene.acoustics
        if acoustics.target == "noise_free":
            return self._displayed(expected(self.scene, ()), ())
        if acoustics.target == "mean_log":
            return self.mean
        random_effects = [drawn for drawn in self.effects if drawn.effect.systematic is None]
        state = expected(self.scene, random_effects, standing=acoustics.standing)
        return self._displayed(state, ())

    @property
    def mean(self) -> Float32s:
        """(range_bins, beams) what the mean of noisy images with other random draws shows."""
        state = expected(self.scene, self.effects, standing=self.scene.acoustics.standing)
        return self._displayed(state, ())

    def noisy(self, effects: Collection[str]) -> Float32s:
        """See `SceneSample`."""
        ping = self.scene
        level = received(ping, [effect for effect in self.effects if effect.name in effects])
        level = ping.averaged(level)
        # The strengths of the points are fractions of full scale.
        full_scale = np.sqrt(ping.full_scale)
        for extra in self._added(effects):
            level = np.sqrt(level**2 + (np.float32(full_scale) * extra) ** 2)
        grey = transfer.grey(level, float(full_scale), ping.sonar.transfer)
        return polar.where_seen(grey, ping.window, ping.sonar)

    def measured(self, effects: Collection[str], layers: Collection[str]) -> Mapping[str, Array]:
        """Layers intensity_db, float32 dB re 1 uPa, and field, complex64 uPa; (range_bins, beams).

        What saturates and what the device adds is in them as it is in the image.
        Raises FrameError for the field of several looks.
        """
        images: dict[str, Array] = {}
        if not {"intensity_db", "field"}.intersection(layers):
            return images
        ping = self.scene
        field = received_field(ping, [drawn for drawn in self.effects if drawn.name in effects])
        source = 10 ** (ping.sonar.array.source_level_db / 20)
        field *= np.float32(source) / np.sqrt(ping.gain)[:, None]
        is_seen = polar.seen_beams(ping.window, ping.sonar)
        if "intensity_db" in layers:
            intensity = (field**2).sum(axis=1).mean(axis=0)
            intensity = averaged(intensity, ping.surface.sonar.samples_per_bin)
            with np.errstate(divide="ignore"):
                level_db = 10 * np.log10(intensity)
            known = is_seen & (intensity > 0)
            images["intensity_db"] = np.where(known, level_db, np.nan).astype(np.float32)
        if "field" in layers:
            if len(field) > 1:
                raise FrameError("layer field is of one look; set the looks of speckle to 1")
            complex_field = (field[0, 0] + 1j * field[0, 1]).astype(np.complex64)
            images["field"] = np.where(is_seen, complex_field, np.complex64(0))
        return images

    def without(self, artefacts: Collection[str]) -> Float32s:
        """See `SceneSample`."""
        if "speckle" not in artefacts:
            return super().without(artefacts)
        shown_names = self.free_of(artefacts)
        # Speckle is not switched off but averaged: its mean lifts and lowers a display of levels.
        acting = [
            drawn
            for drawn in self.effects
            if drawn.name in shown_names or drawn.effect.artefact == "speckle"
        ]
        ping = self.scene
        state = expected(ping, acting, realised=True, standing=ping.acoustics.standing)
        return self._displayed(state, shown_names)

    def _displayed(self, state: Expected, effects: Collection[str]) -> Float32s:
        """The expected image of intensities at the raw samples, and the clouds' echoes."""
        ping = self.scene
        state = state.averaged(ping.kernel, ping.surface.sonar.samples_per_bin)
        for extra in self._added(effects):
            state.steady += np.float32(ping.full_scale) * extra**2
        grey = display(state, ping.full_scale, ping.sonar.transfer)
        return polar.where_seen(grey, ping.window, ping.sonar)

    def _added(self, effects: Collection[str]) -> list[Float32s]:
        """(range_bins, beams) echo level of the cloud of each of the named effects."""
        surface = self.scene.surface
        return [
            polar.accumulate(cloud.echoes, surface.window, surface.sonar)
            for cloud in self.clouds
            if cloud.name in effects
        ]


def received(ping: Ping, effects: Sequence[DrawnEffect]) -> Float32s:
    """(range_bins, beams) float32 amplitude after time-varying gain, with the drawn effects."""
    field = received_field(ping, effects)
    intensity = (field**2).sum(axis=1).sum(axis=0)
    return np.asarray(np.sqrt(intensity / np.float32(len(field))))


def received_field(ping: Ping, effects: Sequence[DrawnEffect]) -> Float32s:
    """(looks, 2, range_bins, beams) float32 field after time-varying gain, over the source level.

    Effects of a stage act in the order in which they are given; those of stage points do not act.
    """
    signal = Signal(ping.scatterers.power, np.zeros((1, 2, *ping.shape), np.float32))
    for effect in effects:
        if effect.stage == "echo":
            signal = effect.apply(signal, ping)
    field = beamform(signal.field, ping) if is_audible(signal.field) else signal.field
    if is_audible(signal.power):
        # What has no speckle arrives at its expected strength, in phase.
        field[:, 0] += np.sqrt(beamform_power(signal.power, ping))
    for effect in effects:
        if effect.stage == "beam":
            field = effect.apply(field, ping)
    field *= np.sqrt(ping.gain)[:, None]
    for effect in effects:
        if effect.stage == "image":
            field = effect.apply(field, ping)
    return field
