"""One frame -> its pairs: the whole method (Yang et al. 2024, section 3).

    frame -> render (light at the sonar) -> observed scene -+-> clean picture T
                                                   + noise -+-> noisy picture X

Clean and noisy come from the same scene, through the same image formation (`acoustics`: pointwise
as in the paper, or coherent) and the same transfer curve.  Only the noise differs.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from .compiled import compile_needed
from .dataset.schema import Axis, Column, Pair
from .errors import FrameError
from .frame import Frame, FrameRef
from .imaging import layers as truth
from .imaging.coherent import CoherentScene
from .imaging.contract import Floats
from .imaging.pointwise import PointwiseScene
from .imaging.settings import CoherentSettings, with_materials
from .insonified import check_share, insonified_share
from .labels import class_names
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

Scene = PointwiseScene | CoherentScene

_DRAWS = 40
"""Maximum attempts to draw a device that sees part of the frame."""
_MOST_KEPT_FRAMES = 24
"""Observed frames that may stay in memory: each takes 30 bytes a pixel of its camera image."""


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
    scene: PointwiseScene | CoherentScene
    shadow: npt.NDArray[np.bool_]
    layers: Mapping[str, npt.NDArray[np.generic]]
    columns: Mapping[str, float | str]
    continuous: bool = False


class PairMaker:
    """Makes pairs of renders; a `dataset.schema.PairSource`.  Needs no renderer."""

    def __init__(
        self,
        config: FactoryConfig,
        views: Views,
        camera: CameraLayers | None = None,
        *,
        kept_frames: int = 0,
    ) -> None:
        """camera: gives the layers rgb and depth; by default the recordings do.

        kept_frames: how many observed frames stay in memory, where frames come again and again.
        """
        self.config = config
        self.views = views
        self._kept_frames = kept_frames
        self._observed: OrderedDict[FrameRef, ObservedFrame] = OrderedDict()
        self._recordings = Recordings(config.scenes, config.seed)
        self._camera = camera or Camera(config, choose_frames)

    def axes(self) -> tuple[Axis, Axis]:
        """Row and column axes of the pictures."""
        return image_axes(self.config.sonar)

    def columns(self) -> tuple[Column, ...]:
        """Columns of the sample table."""
        config = self.config
        if config.devices is not None:
            return columns(config.noise, "coherent") + devices.columns(config.devices)
        return columns(config.noise, config.acoustics.formation) + requested(config.dataset.columns)

    def pairs(
        self, ref: FrameRef, variants: tuple[int, ...], noise: NoiseSettings | None = None
    ) -> list[Pair]:
        """The requested variants of one frame.

        noise: used instead of the configuration's; it must have the same effects.
        Raises FrameError when the frame is bad, NotRendered when its render is not at hand.
        """
        config = self.config if noise is None else replace(self.config, noise=noise)
        if config.devices is None:
            observed = self._observed_frame(ref)
            made = [make_pair(observed, variant, config) for variant in variants]
        else:
            moment = self._moment(ref)
            made = [pair_by_drawn_device(moment, one, config) for one in variants]
        seen = self._camera.layers(ref)
        return [replace(pair, layers={**pair.layers, **seen}) if seen else pair for pair in made]

    def _moment(self, ref: FrameRef) -> Moment:
        view = self.views.view(ref)
        return self._recordings.moment(view.frame(ref), view.rendered())

    def _observed_frame(self, ref: FrameRef) -> ObservedFrame:
        """The frame as the configured device observes it; the noise changes nothing of that."""
        if ref in self._observed:
            self._observed.move_to_end(ref)
            return self._observed[ref]
        observed = observe_moment(self._moment(ref), self.config)
        if self._kept_frames:
            self._observed[ref] = observed
            if len(self._observed) > self._kept_frames:
                self._observed.popitem(last=False)
        return observed

    def expect(self, keys: Mapping[str, str]) -> None:
        """Keys of renders that are in the cache; see `dataset.schema.PairSource`."""
        if isinstance(self.views, CachedViews):
            self.views.expect(keys)


def frames_worth_keeping(frames: int) -> int:
    """`kept_frames` where so many frames come in random order: all of few, none of many."""
    return frames if frames <= _MOST_KEPT_FRAMES else 0


def pair_maker(config: FactoryConfig, *, kept_frames: int = 0) -> PairMaker:
    """The pair maker of a configuration, with the renders that it means.  See `PairMaker`."""
    moves = "seabed" if config.scenes.is_continuous else ""
    compile_needed(scenes=moves, field=config.acoustics.formation == "coherent")
    return PairMaker(config, open_views(config), kept_frames=kept_frames)


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
    sonar = config.sonar
    cones = config.acoustics.formation == "coherent"
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
            _class_echoes(config),
            sonar.frequency_khz,
        )
        lit = surface.LitSurface(composed.frame, composed.rendered, window, sonar, cones)
        scene = _scene_of(lit, config, scene)
    share = insonified_share(scene.filled, window, sonar)
    check_share(moment.frame.ref, share, config.frames.min_insonified)
    shadow = ~polar.covered(scene.filled) & polar.seen_beams(window, sonar)
    layers = {
        name: lay_out_nearest(image, window, sonar)
        for name, image in truth.pictures(config.dataset.layers, lit).items()
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


def _class_echoes(config: FactoryConfig) -> list[Echo]:
    """How surfaces of each class echo; pointwise images know the user's own materials alone."""
    acoustics = config.acoustics
    if not isinstance(acoustics, CoherentSettings):
        classes = class_names(config.scenes.own_classes())
        acoustics = with_materials(CoherentSettings(), classes, config.scenes.own())
    return [Echo(coefficient, exponent) for coefficient, exponent in acoustics.of_classes()]


def _scene_of(lit: surface.LitSurface, config: FactoryConfig, static: Scene | None = None) -> Scene:
    """static: the same scene without moving objects; None where nothing moves."""
    acoustics = config.acoustics
    if isinstance(acoustics, CoherentSettings):
        assert static is None or isinstance(static, CoherentScene)
        return CoherentScene(lit, config.water, acoustics, static)
    assert static is None or isinstance(static, PointwiseScene)
    return PointwiseScene(lit, config.seed, config.resample, static)


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
    names = StreamNames.of(observed.ref, variant, observed.has_pose)
    draws = draw(config.noise, config.seed, names, continuous=observed.continuous)
    sample = observed.scene.sample(variant, draws.effects)
    lay = _Layout(observed.window, config, is_drawn=device is not None)

    layers = dict(observed.layers)
    measured = sample.measured(draws.names, config.dataset.layers)
    for name, values in measured.items():
        layers[name] = lay_out_nearest(values, observed.window, config.sonar)
    if "effects" in config.dataset.layers:
        for name in draws.names:
            layers[f"layers/{name}"] = lay.image(sample.noisy({name}), is_noisy=True)

    if "static" in config.dataset.layers:
        static = observed.scene.static or observed.scene
        clean = static.sample(variant, draws.effects).clean
        layers["static"] = lay.image(clean, is_noisy=False)

    # Images of drawn devices have the columns of the coherent ones, whatever formed them.
    formation = config.acoustics.formation if device is None else "coherent"
    row = record(observed.ref, variant, observed.window, config.sonar, sample, draws, formation)
    if device is not None:
        row |= device.row()
    row |= observed.columns
    return Pair(
        noisy=lay.image(sample.noisy(draws.names), is_noisy=True),
        clean=lay.image(sample.clean, is_noisy=False),
        shadow=observed.shadow,
        record=row,
        layers=layers,
        formation=config.acoustics.formation if device is None else "",
        geometry=FanGeometry.from_sonar(
            config.sonar,
            observed.window.range_min_m,
            observed.window.range_max_m,
            observed.window.azimuth_min_rad,
            observed.window.azimuth_max_rad,
        ),
    )


class _Layout:
    """Lays polar images out as a dataset stores them.

    is_drawn: whether the device was drawn; its programs then rasterise every image.
    """

    def __init__(self, window: Window, config: FactoryConfig, *, is_drawn: bool) -> None:
        self._window = window
        self._sonar = config.sonar
        self._dtype = config.dataset.dtype
        self._is_plain = config.sonar.image.plain and not is_drawn

    def image(self, grey: Floats, *, is_noisy: bool) -> npt.NDArray[np.generic]:
        """(range_bins, beams) grey values -> (H, W) uint8 or float32."""
        if self._is_plain:
            laid_out = lay_out(grey, self._window, self._sonar)
        else:
            laid_out = rasterised(grey, self._window, self._sonar, noisy=is_noisy)
        return transfer.quantise(laid_out, self._dtype)
