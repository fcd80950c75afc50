"""One frame -> its pairs by the sonar equation: the order of the stages.

    scatterers -> speckle, haze, multipath -> pulse and beams -> leaks, receiver noise
      -> time-varying gain -> channels, interference, saturation -> transfer curve -> picture

The clean picture comes through the same device, gain and transfer curve without the noise; see
`acoustics.target`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from simnfnd.factory import noise
from simnfnd.factory.dataset.format.sample import Pair
from simnfnd.factory.errors import FrameError
from simnfnd.factory.formation import layers as truth
from simnfnd.factory.formation.field.scatterers import scatterers
from simnfnd.factory.formation.field.signal import (
    Floats,
    Ping,
    Signal,
    beamform,
    beamform_power,
    bin_centres_m,
)
from simnfnd.factory.formation.record import record
from simnfnd.factory.noise import physical as effects_of
from simnfnd.factory.sonar import polar, transfer
from simnfnd.factory.sonar.echoes import Echoes
from simnfnd.factory.sonar.fan import lay_out, lay_out_nearest
from simnfnd.factory.sonar.surface import extent, insonified
from simnfnd.factory.sonar.window import Window
from simnfnd.factory.sonar.window_fit import fit_window

if TYPE_CHECKING:
    from simnfnd.factory.config import FactoryConfig
    from simnfnd.factory.frame import Frame, FrameRef
    from simnfnd.factory.noise.physical import Drawn
    from simnfnd.factory.render.base import Rendered


@dataclass(frozen=True, eq=False)
class FieldScene:
    """What all pairs of a frame share; no randomness.

    clean: (range_bins, beams) float32 grey values of the clean picture.
    shadow: (H, W) bool picture.  layers: (H, W) pictures of what is behind each pixel.
    echoes: the points of the paper's method, where something needs them, else none.
    """

    ref: FrameRef
    window: Window
    ping: Ping
    clean: Floats
    shadow: npt.NDArray[np.bool_]
    layers: Mapping[str, npt.NDArray[np.generic]]
    echoes: Echoes


def field_scene(frame: Frame, rendered: Rendered, config: FactoryConfig) -> FieldScene:
    """The frame as the device hears it.

    Raises FrameError when the sonar's sector holds no insonified surface.
    """
    from simnfnd.factory.formation.field import kernels  # loads numba

    sonar, water, acoustics = config.sonar, config.water, config.acoustics
    try:
        window = fit_window(extent(frame, rendered, sonar), sonar)
    except FrameError as error:
        raise FrameError(f"{frame.ref.name}: {error}") from error
    heard = scatterers(frame, rendered, window, sonar, water, acoustics)
    echoes, layers = _points(frame, rendered, window, config)

    range_m = np.maximum(bin_centres_m(window, sonar).astype(np.float64), 1e-3)
    gain_db = acoustics.tvg_log * np.log10(range_m)
    if acoustics.tvg_absorption:
        gain_db += 2 * water.absorption_db_per_m(sonar.frequency_khz) * range_m
    gain = (10 ** (gain_db / 10)).astype(np.float32)

    ping = Ping(heard, window, sonar, water, gain, 1.0, 1.0)
    expected = beamform_power(heard.power, ping)
    seen = polar.seen_beams(window, sonar)
    amplitude, echoing = np.empty_like(expected), np.empty_like(expected)
    strongest = kernels.expectation(expected, gain, heard.power, seen, amplitude, echoing)
    full_scale = transfer.full_scale(echoing, sonar.transfer)
    ping = replace(ping, full_scale=full_scale**2, strongest=float(strongest))

    if acoustics.target == "mean_field":
        level, scale = amplitude, full_scale
    elif acoustics.target == "geometry":
        level = polar.spread_points(polar.accumulate(echoes, window, sonar), sonar)
        scale = transfer.full_scale(level, sonar.transfer)
    else:
        level = np.sqrt(backscatter(frame, rendered, window, config))
        scale = transfer.full_scale(level, sonar.transfer)
    clean = _where_seen(transfer.grey(level, scale, sonar.transfer), seen)
    shadow = ~polar.covered(heard.in_beam) & seen
    return FieldScene(
        frame.ref,
        window,
        ping,
        clean,
        lay_out_nearest(shadow, window, sonar),
        {name: lay_out_nearest(picture, window, sonar) for name, picture in layers.items()},
        echoes,
    )


def _points(
    frame: Frame, rendered: Rendered, window: Window, config: FactoryConfig
) -> tuple[Echoes, Mapping[str, npt.NDArray[np.generic]]]:
    """The paper's points and the asked layers behind each bin; neither when nothing needs them."""
    asked = set(config.dataset.layers) - {"effects"}
    on = any(getattr(config.noise, name).enabled for name in noise.EFFECTS)
    if not (asked or on or config.acoustics.target == "geometry"):
        none = np.empty(0, np.float32)
        return Echoes(none, none, none, none), {}
    echoes, pixel, _ = insonified(frame, rendered, window, config.sonar)
    return echoes, truth.pictures(config.dataset.layers, frame, echoes, pixel, window, config.sonar)


def _where_seen(grey: Floats, seen: npt.NDArray[np.bool_]) -> Floats:
    return grey if seen.all() else np.where(seen, grey, np.float32(0))


def make_field_pair(made: FieldScene, variant: int, config: FactoryConfig) -> Pair:
    """One (noisy, clean) pair; the same scene, variant and configuration give the same bytes."""
    ref, window, ping, sonar = made.ref, made.window, made.ping, config.sonar
    posed = ping.scatterers.posed
    names = (ref.location, ref.scene, ref.frame, variant)
    drawn = effects_of.draw(config.noise, config.seed, ref, variant, posed)
    drawn_points = noise.draw(config.noise, config.seed, *names)
    points = noise.layers(made.echoes, made.echoes, window, drawn_points, config.seed, *names)

    def picture(grey: Floats) -> npt.NDArray[np.generic]:
        return transfer.quantise(lay_out(grey, window, sonar), config.dataset.dtype)

    def noisy(chosen: Collection[str]) -> npt.NDArray[np.generic]:
        rngs = {name: effects_of.stream(name, config.seed, ref, variant, posed) for name in drawn}
        parameters = {name: drawn[name] for name in drawn if name in chosen}
        level = received(ping, parameters, rngs)
        added = [echoes for name, echoes in points.items() if name in chosen]
        level = _with_points(level, added, ping)
        grey = transfer.grey(level, float(np.sqrt(ping.full_scale)), sonar.transfer)
        return picture(_where_seen(grey, polar.seen_beams(window, sonar)))

    layers = dict(made.layers)
    if "effects" in config.dataset.layers:
        layers |= {f"layers/{name}": noisy({name}) for name in (*points, *drawn)}
    return Pair(
        noisy=noisy({*drawn, *points}),
        clean=picture(made.clean),
        shadow=made.shadow,
        record=record(
            ref,
            variant,
            config,
            window,
            1.0,
            {**drawn_points, **drawn},
            ping.scatterers.bins,
            points,
            ping.full_scale,
        ),
        layers=layers,
    )


def received(ping: Ping, drawn: dict[str, Drawn], rngs: dict[str, np.random.Generator]) -> Floats:
    """(range_bins, beams) float32 amplitude after time-varying gain, with the drawn effects."""
    from simnfnd.factory.formation.field import kernels  # loads numba

    known = effects_of.FIELD_EFFECTS
    staged = {
        stage: [name for name in known if name in drawn and known[name].stage == stage]
        for stage in ("echo", "beam", "picture")
    }
    signal = Signal(ping.scatterers.power, np.zeros((1, 2, *ping.shape), np.float32))
    for name in staged["echo"]:
        signal = known[name].apply(signal, ping, rngs[name], **drawn[name])
    field = beamform(signal.field, ping) if signal.field.any() else signal.field
    if signal.power.any():
        # What has no speckle arrives at its expected strength, in phase.
        field[:, 0] += np.sqrt(beamform_power(signal.power, ping))
    for name in staged["beam"]:
        field = known[name].apply(field, ping, rngs[name], **drawn[name])
    field *= np.sqrt(ping.gain)[:, None]
    for name in staged["picture"]:
        field = known[name].apply(field, ping, rngs[name], **drawn[name])
    level = np.empty(ping.shape, np.float32)
    kernels.amplitude(field, level)
    return level


def _with_points(level: Floats, added: list[Echoes], ping: Ping) -> Floats:
    """The amplitude with the paper's noise points, whose strengths are fractions of full scale."""
    full_scale = np.float32(np.sqrt(ping.full_scale))
    for echoes in added:
        extra = full_scale * polar.accumulate(echoes, ping.window, ping.sonar)
        level = np.sqrt(level**2 + extra**2)
    return level


def backscatter(frame: Frame, rendered: Rendered, window: Window, config: FactoryConfig) -> Floats:
    """(range_bins, beams) float32 backscatter cross-section per plan area of each bin, 1.

    No spreading, no absorption, no beam pattern, no point-spread: what is left of the sonar
    equation when all that a gain could undo is undone.
    """
    sonar = config.sonar
    heard = scatterers(
        frame, rendered, window, sonar, config.water, config.acoustics, patterned=False
    )
    range_m = bin_centres_m(window, sonar)
    bin_m = window.range_span_m / sonar.range_bins
    width_rad = np.gradient(sonar.beam_centres_rad())
    area_m2 = range_m[:, None] * bin_m * width_rad
    section_m2 = heard.power / heard.loss[:, None] * range_m[:, None] ** 4
    return np.asarray(section_m2 / area_m2, np.float32)
