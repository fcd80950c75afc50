"""One frame -> its pairs: the whole method (Yang et al. 2024, section 3).

    frame -> render (light at the sonar) -> observed scene -+-> clean picture T
                                                   + noise -+-> noisy picture X

Clean and noisy come from the same scene, through the same image formation (`acoustics.formation`:
the paper's points, or the complex field) and the same transfer curve.  Only the noise differs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from .compiled import compile_needed
from .dataset.schema import Axis, Column, Pair
from .errors import FrameError
from .frame import Frame, FrameRef
from .imaging import layers as truth
from .imaging.coherent import FieldScene
from .imaging.contract import Floats
from .imaging.pointwise import PointScene
from .moving.compose import Echo, compose
from .moving.recordings import Moment, Recordings
from .noise.draws import StreamNames, draw
from .sample_table import (
    Camera,
    CameraLayers,
    columns,
    image_axes,
    record,
    requested,
    requested_row,
)
from .selection import choose_frames
from .sonar import polar, surface, transfer
from .sonar.fan import lay_out, lay_out_nearest, rasterised
from .sonar.geometry import FanGeometry
from .sonar.window import Window, conical, fit_window, set_window
from .sonar_randomization import draw as devices
from .views import CachedViews, Views, open_views

if TYPE_CHECKING:
    from .config import FactoryConfig
    from .noise.registry import NoiseSettings
    from .render.base import Rendered

Scene = PointScene | FieldScene

_FORMATIONS: dict[str, Literal["pointwise", "coherent"]] = {
    "points": "pointwise",
    "field": "coherent",
}
_DRAWS = 40
"""Devices that may be drawn for a picture until one sees some of the frame."""


@dataclass(frozen=True, eq=False)
class ObservedFrame:
    """What all pairs of a frame share; no randomness up to here.

    window: range and azimuth limits of the picture.  has_pose: whether the frame's is known.
    shadow: (H, W) bool picture.  layers: (H, W) pictures of what lies behind each pixel, by the
    names of `dataset.layers`.  columns: what `dataset.columns` asks for.
    continuous: whether the frames of its recording share the parameters of the noise.
    """

    ref: FrameRef
    has_pose: bool
    window: Window
    scene: PointScene | FieldScene
    shadow: npt.NDArray[np.bool_]
    layers: Mapping[str, npt.NDArray[np.generic]]
    columns: Mapping[str, float | str]
    continuous: bool = False


class PairMaker:
    """Makes pairs of renders; a `sample.PairSource`.  Needs no renderer."""

    def __init__(
        self, config: FactoryConfig, views: Views, camera: CameraLayers | None = None
    ) -> None:
        """camera: gives the layers rgb and depth; by default the recordings do."""
        self.config, self.views = config, views
        self._recordings = Recordings(config.scenes, config.seed)
        self._camera = camera or Camera(config, choose_frames)

    def axes(self) -> tuple[Axis, Axis]:
        """Row and column axes of the pictures."""
        return image_axes(self.config.sonar)

    def columns(self) -> tuple[Column, ...]:
        """Columns of the sample table."""
        config = self.config
        if config.devices is not None:
            return columns(config.noise, "field") + devices.columns(config.devices)
        return columns(config.noise, config.acoustics.formation) + requested(config.dataset.columns)

    def pairs(
        self, ref: FrameRef, variants: tuple[int, ...], noise: NoiseSettings | None = None
    ) -> list[Pair]:
        """The requested variants of one frame.

        noise: used instead of the configuration's; it must have the same effects.
        Raises FrameError when the frame is bad, NotRendered when its render is not at hand.
        """
        view = self.views.view(ref)
        config = self.config if noise is None else replace(self.config, noise=noise)
        frame, rendered = view.frame(ref), view.rendered()
        moment = self._recordings.moment(frame, rendered)
        if config.devices is None:
            observed = observe_moment(moment, config)
            made = [make_pair(observed, variant, config) for variant in variants]
        else:
            made = [pair_by_drawn_device(moment, one, config) for one in variants]
        seen = self._camera.layers(ref)
        return [replace(pair, layers={**pair.layers, **seen}) if seen else pair for pair in made]

    def expect(self, keys: Mapping[str, str]) -> None:
        """Keys of renders that are in the cache; see `sample.PairSource`."""
        if isinstance(self.views, CachedViews):
            self.views.expect(keys)


def pair_maker(config: FactoryConfig) -> PairMaker:
    """The pair maker of a configuration, with the renders that it means."""
    moves = "seabed" if config.scenes.is_continuous else ""
    field = config.acoustics.formation == "field" or config.devices is not None
    compile_needed(scenes=moves, field=field)
    return PairMaker(config, open_views(config))


def observe(
    frame: Frame, rendered: Rendered, config: FactoryConfig, window: Window | None = None
) -> ObservedFrame:
    """A rendered frame as the sonar observes it; `observe_moment` of a scene where nothing moves.

    window: that of `fitted_window`, where it is known already.
    Raises FrameError when the sonar's sector holds no insonified surface.
    """
    return observe_moment(Moment(frame, rendered), config, window)


def observe_moment(
    moment: Moment, config: FactoryConfig, window: Window | None = None
) -> ObservedFrame:
    """A frame with its moving objects as the sonar observes it.

    The static scene alone decides the range window and the scale of the pictures, so that they
    stay as they are while objects come and go.
    """
    sonar, cones = config.sonar, config.acoustics.formation == "field"
    window = window or fitted_window(moment.frame, moment.rendered, config)
    window = conical(window, sonar) if cones else window
    lit = surface.LitSurface(moment.frame, moment.rendered, window, sonar, cones)
    scene = _scene_of(lit, config)
    if moment.bodies:
        made_by = (window, sonar, config.water, config.acoustics, config.resample)
        scene = moment.static.equal(scene, made_by) if moment.static else scene
        composed = compose(
            moment.frame,
            moment.rendered,
            moment.bodies,
            sonar.mount,
            [Echo(*one) for one in config.acoustics.of_classes()],
            sonar.frequency_khz,
        )
        lit = surface.LitSurface(composed.frame, composed.rendered, window, sonar, cones)
        scene = _scene_of(lit, config, scene)
    shadow = ~polar.covered(scene.filled) & polar.seen_beams(window, sonar)
    layers = {
        name: lay_out_nearest(picture, window, sonar)
        for name, picture in truth.pictures(config.dataset.layers, lit).items()
    }
    return ObservedFrame(
        ref=moment.frame.ref,
        has_pose=moment.frame.world_from_camera is not None,
        window=window,
        scene=scene,
        shadow=lay_out_nearest(shadow, window, sonar),
        layers=layers,
        columns=requested_row(lit, config),
        continuous=moment.is_continuous,
    )


def _scene_of(lit: surface.LitSurface, config: FactoryConfig, static: Scene | None = None) -> Scene:
    """static: the same scene without moving objects; None where nothing moves."""
    if config.acoustics.formation == "field":
        assert static is None or isinstance(static, FieldScene)
        return FieldScene(lit, config.water, config.acoustics, static)
    assert static is None or isinstance(static, PointScene)
    return PointScene(lit, config.seed, config.resample, static)


def fitted_window(frame: Frame, rendered: Rendered, config: FactoryConfig) -> Window:
    """The window of the frame's pictures.  Raises FrameError as `observe` does."""
    sonar = set_window(config.sonar, config.seed, frame.ref)
    try:
        return fit_window(surface.extent(frame, rendered, sonar), sonar)
    except FrameError as error:
        raise FrameError(f"{frame.ref.name}: {error}") from error


def observe_by(
    device: devices.Device,
    moment: Moment,
    config: FactoryConfig,
    *,
    any_size: bool = False,
) -> tuple[ObservedFrame, FactoryConfig]:
    """A frame as a drawn device observes it, and the configuration of its pictures.

    any_size: whether the device draws the size of its pictures, too.
    Raises FrameError as `observe` does.
    """
    config = devices.configured(config, device, any_size=any_size)
    window = fitted_window(moment.frame, moment.rendered, config)
    config = devices.resolved(config, device, window, any_size=any_size)
    observed = observe_moment(moment, config, window)
    return observed, devices.fitted(config, device, observed.scene.static or observed.scene)


def pair_by_drawn_device(moment: Moment, variant: int, config: FactoryConfig) -> Pair:
    """A variant of a frame, by the device that `config.devices` draws for it.

    A device whose window shows nothing of the frame gives way to the next draw.
    Raises FrameError as `observe` does, where none of them sees any of it.
    """
    assert config.devices is not None
    ref = moment.frame.ref
    names: tuple[str | int, ...] = (ref.location, ref.scene, ref.frame, variant)
    if moment.is_continuous:
        names = ref.location, ref.scene, variant
    for attempt in range(_DRAWS):
        again = (attempt,) if attempt else ()
        device = devices.draw(config.devices, config.seed, *names, *again)
        try:
            observed, own = observe_by(device, moment, config)
        except FrameError as error:
            unseen = error
        else:
            return make_pair(observed, variant, own, device)
    raise unseen


def make_pair(
    observed: ObservedFrame,
    variant: int,
    config: FactoryConfig,
    device: devices.Device | None = None,
) -> Pair:
    """One (noisy, clean) pair; the same frame, variant and configuration give the same bytes.

    device: the drawn one that observed the frame, None for that of the configuration.
    """
    window, sonar, wanted = observed.window, config.sonar, config.dataset
    names = StreamNames.of(observed.ref, variant, observed.has_pose)
    draws = draw(config.noise, config.seed, names, continuous=observed.continuous)
    sample = observed.scene.sample(variant, draws.effects)

    def picture(grey: Floats, noisy: bool = True) -> npt.NDArray[np.generic]:
        if device is None and sonar.image.plain:
            laid_out = lay_out(grey, window, sonar)
        else:
            laid_out = rasterised(grey, window, sonar, noisy=noisy)
        return transfer.quantise(laid_out, wanted.dtype)

    layers = dict(observed.layers)
    for name, measured in sample.measured(draws.names, wanted.layers).items():
        layers[name] = lay_out_nearest(measured, window, sonar)
    if "effects" in wanted.layers:
        layers |= {f"layers/{name}": picture(sample.noisy({name})) for name in draws.names}
    if "static" in wanted.layers:
        still = observed.scene.static or observed.scene
        layers["static"] = picture(still.sample(variant, draws.effects).clean, noisy=False)
    formation = config.acoustics.formation if device is None else "field"
    row = record(observed.ref, variant, window, sonar, sample, draws, formation)
    row |= {} if device is None else device.row()
    row |= observed.columns
    return Pair(
        noisy=picture(sample.noisy(draws.names)),
        clean=picture(sample.clean, noisy=False),
        shadow=observed.shadow,
        record=row,
        layers=layers,
        formation="" if device else _FORMATIONS[config.acoustics.formation],
        geometry=FanGeometry.from_sonar(
            sonar,
            window.range_min_m,
            window.range_max_m,
            window.azimuth_min_rad,
            window.azimuth_max_rad,
        ),
    )
