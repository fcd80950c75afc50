"""One frame -> its pairs: the whole method (Yang et al. 2024, section 3).

    frame -> render (light at the sonar) -> observed scene -+-> clean image T
                                                   + noise -+-> noisy image X

Clean and noisy images come from the same scene, through the same image formation (`acoustics`:
pointwise as in the paper, or coherent) and the same transfer curve.  Only the noise differs.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from ...common.array_types import Array, Bools, Float32s
from ...common.errors import FrameError
from ...dataset.fan_geometry import FanGeometry
from ...dataset.frame_ref import FrameRef
from ...dataset.meaning import class_names
from ...dataset.schema import Axis, Column, Pair
from ..config.selection import choose_frames
from ..devices import draw as devices
from ..frames.frame import Frame
from ..imaging import layers as truth
from ..imaging.coherent import CoherentSample, CoherentScene
from ..imaging.pointwise import PointwiseScene
from ..imaging.settings import CoherentSettings, is_coherent, with_materials
from ..labels.camera_layers import Camera, CameraLayers
from ..labels.image_axes import image_axes
from ..labels.insonified import check_share, insonified_share
from ..labels.visibility import visibility_row
from ..moving.compose import Echo, compose
from ..moving.recordings import Moment, MovingRecordings
from ..noise.draws import StreamNames, draw
from ..sonar import polar, surface, transfer
from ..sonar.fan import lay_out, lay_out_nearest, rasterised
from ..sonar.window import Window, conical, fit_window, set_window, whole_sector
from .compilation import compile_needed
from .requested_columns import requested, requested_row
from .sample_table import columns, record
from .views import CachedViews, Views, open_views

if TYPE_CHECKING:
    from ..config.root import FactoryConfig
    from ..noise.registry import NoiseSettings
    from ..render.base import Rendered

Scene = PointwiseScene | CoherentScene
ImageType = TypeVar("ImageType", bound=np.generic)

_DRAWS = 40
"""Maximum attempts to draw a device that sees part of the frame."""
_MOST_KEPT_FRAMES = 24
"""Observed frames that may stay in memory: each takes 30 bytes per pixel of its camera image."""


@dataclass(frozen=True, eq=False)
class ObservedFrame:
    """What all pairs of a frame share; nothing in it is random.

    lit: the surface that the sonar sees.  window: range and azimuth limits of the image.
    config: of the device and of what is requested beside the images.
    continuous: whether the frames of its recording share the parameters of the noise.
    later_groups: what the second and further groups of beams observe; see `ArraySettings`.
    """

    lit: surface.LitSurface
    window: Window
    scene: PointwiseScene | CoherentScene
    config: FactoryConfig
    continuous: bool = False
    later_groups: tuple[Scene, ...] = ()

    @property
    def ref(self) -> FrameRef:
        """The name of the frame."""
        return self.lit.frame.ref

    @property
    def has_pose(self) -> bool:
        """Whether the frame has a pose."""
        return self.lit.frame.world_from_camera is not None

    @cached_property
    def shadow(self) -> Bools:
        """(H, W) bool image of the shadows."""
        sonar = self.config.sonar
        # What echoes beyond vfov_deg is no shadow: the beam fades, and is not cut.
        is_lit = self.scene.filled | self.lit.shown.hit
        shadow = ~polar.covered(is_lit) & polar.seen_beams(self.window, sonar)
        return lay_out_nearest(shadow, self.window, sonar)

    @cached_property
    def layers(self) -> Mapping[str, Array]:
        """(H, W) images of the surface behind each pixel, by the names of `dataset.layers`."""
        return self.surface_layers(self.config.dataset.layers)

    def surface_layers(self, names: Sequence[str]) -> dict[str, Array]:
        """(H, W) images of the surface behind each pixel; see `layer_images`."""
        return {
            name: lay_out_nearest(image, self.window, self.config.sonar)
            for name, image in truth.layer_images(names, self.lit).items()
        }

    @cached_property
    def columns(self) -> Mapping[str, float | str]:
        """The columns that `dataset.columns` requests."""
        return requested_row(self.lit, self.config)


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
        """camera: source of the layers rgb and depth; None: the recordings.

        kept_frames: number of observed frames that stay in memory, for frames that are requested
        repeatedly.
        """
        self.config = config
        self.views = views
        self._kept_frames = kept_frames
        self._observed: OrderedDict[FrameRef, ObservedFrame] = OrderedDict()
        self._recordings = MovingRecordings(config.scenes, config.seed)
        self._camera = camera or Camera(config, choose_frames)

    def axes(self) -> tuple[Axis, Axis]:
        """Row and column axes of the images."""
        return image_axes(self.config.sonar)

    def columns(self) -> tuple[Column, ...]:
        """Columns of the sample table."""
        config = self.config
        more = requested(config.dataset.columns)
        if config.devices is not None:
            return columns(config.noise, "coherent") + devices.columns(config.devices) + more
        return columns(config.noise, config.acoustics.formation) + more

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
            pairs = [make_pair(observed, variant, config) for variant in variants]
        else:
            moment = self._moment(ref)
            pairs = [pair_by_drawn_device(moment, variant, config) for variant in variants]
        camera_layers = self._camera.layers(ref)
        if not camera_layers:
            return pairs
        return [replace(pair, layers={**pair.layers, **camera_layers}) for pair in pairs]

    def _moment(self, ref: FrameRef) -> Moment:
        view = self.views.view(ref)
        return self._recordings.moment(view.frame(ref), view.rendered())

    def _observed_frame(self, ref: FrameRef) -> ObservedFrame:
        """The frame as the configured device observes it, which does not depend on the noise."""
        if ref in self._observed:
            self._observed.move_to_end(ref)
            return self._observed[ref]
        observed = observe_moment(self._moment(ref), self.config)
        if self._kept_frames:
            self._observed[ref] = observed
            if len(self._observed) > self._kept_frames:
                self._observed.popitem(last=False)
        return observed

    def set_cache_keys(self, keys: Mapping[str, str]) -> None:
        """Take the cache keys of finished renders; see `dataset.schema.PairSource`."""
        if isinstance(self.views, CachedViews):
            self.views.set_cache_keys(keys)


def frames_worth_keeping(frames: int) -> int:
    """Return `kept_frames` for frames in random order: all of a few, none of many."""
    return frames if frames <= _MOST_KEPT_FRAMES else 0


def pair_maker(config: FactoryConfig, *, kept_frames: int = 0) -> PairMaker:
    """Open the pair maker of a configuration with the renders it refers to.  See `PairMaker`."""
    moves = "seabed" if config.scenes.is_continuous else ""
    compile_needed(scenes=moves, field=is_coherent(config.acoustics))
    return PairMaker(config, open_views(config), kept_frames=kept_frames)


def observe(
    frame: Frame, rendered: Rendered, config: FactoryConfig, window: Window | None = None
) -> ObservedFrame:
    """A rendered frame as the sonar observes it; `observe_moment` of a scene where nothing moves.

    window: the result of `fitted_window` if the caller has it; None: fitted here.
    Raises FrameError when the sonar's sector holds no insonified surface.
    """
    return observe_moment(Moment(frame, rendered), config, window)


def observe_moment(
    moment: Moment, config: FactoryConfig, window: Window | None = None
) -> ObservedFrame:
    """A frame with its moving objects as the sonar observes it.

    The static scene alone determines the range window and the grey scale of the images, so that
    both remain constant while objects come and go.
    """
    sonar = config.sonar
    if window is None:
        window = fitted_window(moment.frame, moment.rendered, config)
    if is_coherent(config.acoustics):
        window = conical(window, sonar)
    lit, scene, later_groups = _observe_scene(moment, window, config)
    share = insonified_share(scene.filled, window, sonar)
    check_share(moment.frame.ref, share, config.frames.min_insonified)
    return ObservedFrame(lit, window, scene, config, moment.is_continuous, later_groups)


class _ObservedScene(NamedTuple):
    """What the sonar observes of a moment: the surface, its echoes, and those of later groups."""

    lit: surface.LitSurface
    scene: Scene
    later_groups: tuple[Scene, ...]


def _observe_scene(moment: Moment, window: Window, config: FactoryConfig) -> _ObservedScene:
    lit = _lit_surface(moment.frame, moment.rendered, window, config)
    scene = _scene_of(lit, config)
    # A recording with moving objects, even where none is in this frame.
    if not (moment.bodies or moment.cast):
        return _ObservedScene(lit, scene, ())
    static = _held_static_scene(moment, scene, window, config)
    later_groups = _observe_later_groups(moment, static, window, config)
    if not moment.bodies:
        return _ObservedScene(lit, static, later_groups)
    lit = _with_bodies(moment, window, config)
    return _ObservedScene(lit, _scene_of(lit, config, static), later_groups)


def _observe_later_groups(
    moment: Moment, static: Scene, window: Window, config: FactoryConfig
) -> tuple[Scene, ...]:
    """The scene of each group of beams after the first; none where all beams ping at once."""
    groups = config.sonar.array.beam_groups
    if groups == 1 or not is_coherent(config.acoustics):
        return ()
    wait_s = 2 * window.range_max_m / config.water.sound_speed_m_s()
    scenes: list[Scene] = []
    for number in range(1, groups):
        later = moment.later(number * wait_s)
        if later.bodies:
            scenes.append(_scene_of(_with_bodies(later, window, config), config, static))
        else:
            scenes.append(static)
    return tuple(scenes)


def _by_beam_group(images: Sequence[npt.NDArray[ImageType]]) -> npt.NDArray[ImageType]:
    """(range_bins, beams) the beams of each group, taken from its own image."""
    if len(images) == 1:
        return images[0]
    merged = images[0].copy()
    for number, image in enumerate(images):
        merged[:, number :: len(images)] = image[:, number :: len(images)]
    return merged


def _lit_surface(
    frame: Frame, rendered: Rendered, window: Window, config: FactoryConfig
) -> surface.LitSurface:
    acoustics = config.acoustics
    class_echoes: tuple[float, ...] = ()
    if is_coherent(acoustics):
        class_echoes = tuple(coefficient for coefficient, _ in acoustics.of_classes())
    conical = is_coherent(config.acoustics)
    return surface.LitSurface(frame, rendered, window, config.sonar, conical, class_echoes)


def _held_static_scene(
    moment: Moment, scene: Scene, window: Window, config: FactoryConfig
) -> Scene:
    """Return the recording's cached static scene if its settings match, otherwise `scene`."""
    if moment.static is None:
        return scene
    settings = (window, config.sonar, config.water, config.acoustics, config.resample)
    return moment.static.held_scene(scene, settings)


def _with_bodies(moment: Moment, window: Window, config: FactoryConfig) -> surface.LitSurface:
    """Return the surface of a frame with its moving objects placed into it."""
    composed = compose(
        moment.frame,
        moment.rendered,
        moment.bodies,
        config.sonar.mount,
        _class_echoes(config),
        config.sonar.frequency_khz,
    )
    return _lit_surface(composed.frame, composed.rendered, window, config)


def _class_echoes(config: FactoryConfig) -> list[Echo]:
    """Return how surfaces of each class echo.

    Pointwise images know no materials but the user's own.
    """
    if is_coherent(config.acoustics):
        acoustics = config.acoustics
    else:
        classes = class_names(config.scenes.own_classes())
        acoustics = with_materials(CoherentSettings(), classes, config.scenes.own())
    return [Echo(coefficient, exponent) for coefficient, exponent in acoustics.of_classes()]


def _scene_of(lit: surface.LitSurface, config: FactoryConfig, static: Scene | None = None) -> Scene:
    """The echoes of a surface.  static: the same scene without moving objects; None: none move."""
    acoustics = config.acoustics
    if is_coherent(acoustics):
        assert static is None or isinstance(static, CoherentScene)
        return CoherentScene(lit, config.water, acoustics, static)
    assert static is None or isinstance(static, PointwiseScene)
    return PointwiseScene(lit, config.seed, config.resample, static)


def fitted_window(frame: Frame, rendered: Rendered, config: FactoryConfig) -> Window:
    """Fit the range window of the frame's images.  Raises FrameError as `observe` does."""
    sonar = set_window(config.sonar, config.seed, frame.ref)
    try:
        window = fit_window(surface.extent(frame, rendered, sonar), sonar)
    except FrameError as error:
        raise FrameError(f"{frame.ref.name}: {error}") from error
    return window if sonar.sector == "seen" else whole_sector(window, sonar)


def observe_by(
    device: devices.DrawnDevice,
    moment: Moment,
    config: FactoryConfig,
    *,
    any_size: bool = False,
) -> tuple[ObservedFrame, FactoryConfig]:
    """A frame as a drawn device observes it, and the configuration of its images.

    any_size: whether the device also draws the size of its images.
    Raises FrameError as `observe` does.
    """
    config = devices.configured(config, device, any_size=any_size)
    window = fitted_window(moment.frame, moment.rendered, config)
    config = devices.resolved(config, device, window, any_size=any_size)
    observed = observe_moment(moment, config, window)
    return observed, devices.fitted(config, device, observed.scene.static or observed.scene)


def pair_by_drawn_device(moment: Moment, variant: int, config: FactoryConfig) -> Pair:
    """A variant of a frame, observed by the device that `config.devices` draws for it.

    Draws again, up to `_DRAWS` times, while the window of the device shows nothing of the frame.
    Raises FrameError as `observe` does when no drawn device sees the frame.
    """
    assert config.devices is not None
    ref = moment.frame.ref
    stream_names: tuple[str | int, ...] = (ref.location, ref.scene, ref.frame, variant)
    if moment.is_continuous or config.devices.per == "place":
        stream_names = ref.location, ref.scene, variant
    for attempt in range(_DRAWS):
        retry_name = (attempt,) if attempt else ()
        device = devices.draw(config.devices, config.seed, *stream_names, *retry_name)
        try:
            observed, device_config = observe_by(device, moment, config)
        except FrameError as error:
            last_error = error
        else:
            return make_pair(observed, variant, device_config, device)
    raise last_error


def make_pair(
    observed: ObservedFrame,
    variant: int,
    config: FactoryConfig,
    device: devices.DrawnDevice | None = None,
) -> Pair:
    """One (noisy, clean) pair; the same frame, variant and configuration give the same bytes.

    device: the drawn device that observed the frame; None: the configured one.
    """
    sample = ObservedSample(observed, variant, config, device)
    return Pair(
        noisy=sample.noisy,
        clean=sample.clean,
        shadow=observed.shadow,
        record=sample.record(),
        layers=sample.layers,
        formation=config.acoustics.formation if device is None else "",
        geometry=sample.geometry(),
    )


class ObservedSample:
    """One variant of an observed frame; each of its images is made when it is first used."""

    def __init__(
        self,
        observed: ObservedFrame,
        variant: int,
        config: FactoryConfig,
        device: devices.DrawnDevice | None = None,
    ) -> None:
        """See `make_pair`."""
        self.observed = observed
        self._variant = variant
        self._config = config
        self._device = device
        names = StreamNames.of(observed.ref, variant, observed.has_pose)
        self._draws = draw(config.noise, config.seed, names, continuous=observed.continuous)
        # One sample for each group of beams.
        scenes = observed.scene, *observed.later_groups
        self._samples = [scene.sample(variant, self._draws.effects) for scene in scenes]
        self._layout = _Layout(observed.window, config, is_drawn=device is not None)

    @cached_property
    def noisy_grey(self) -> Float32s:
        """(range_bins, beams) grey values of the noisy image."""
        return _by_beam_group([sample.noisy(self._draws.names) for sample in self._samples])

    @cached_property
    def noisy(self) -> Array:
        """(H, W) the noisy image, as datasets store it."""
        return self._layout.image(self.noisy_grey, is_noisy=True)

    @cached_property
    def clean(self) -> Array:
        """(H, W) the clean image, as datasets store it."""
        grey = _by_beam_group([sample.clean for sample in self._samples])
        return self._layout.image(grey, is_noisy=False)

    def image_as(self, layout: Literal["polar", "fan"]) -> Array:
        """The noisy image in another layout than the device's."""
        config = self._config
        if config.sonar.image.layout == layout:
            return self.noisy
        image = replace(config.sonar.image, layout=layout)
        config = replace(config, sonar=replace(config.sonar, image=image))
        layout_of_image = _Layout(self.observed.window, config, is_drawn=False)
        return layout_of_image.image(self.noisy_grey, is_noisy=True)

    def geometry(self) -> FanGeometry:
        """Where range and bearing are in the images."""
        window = self.observed.window
        return FanGeometry.from_sonar(
            self._config.sonar,
            window.range_min_m,
            window.range_max_m,
            window.azimuth_min_rad,
            window.azimuth_max_rad,
        )

    def record(self) -> dict[str, float | int | str]:
        """All values of the sample table."""
        config = self._config
        device = self._device
        # Images of drawn devices have the columns of the coherent ones, whatever formed them.
        formation = config.acoustics.formation if device is None else "coherent"
        observed = self.observed
        row = record(
            observed.ref, self._variant, observed.window, config.sonar, self._samples[0],
            self._draws, formation,
        )  # fmt: skip
        if device is not None:
            row |= device.row()
        row |= observed.columns
        if "visibility" in config.dataset.columns:
            row |= self._visibility()
        return row

    @cached_property
    def layers(self) -> dict[str, Array]:
        """(H, W) images of all requested layers, by name."""
        config = self._config
        requested_layers = config.dataset.layers
        layers = dict(self.observed.layers)
        for name, values in self.measured(requested_layers).items():
            layers[name] = lay_out_nearest(values, self.observed.window, config.sonar)
        if "effects" in requested_layers:
            for name in self._draws.names:
                grey = _by_beam_group([sample.noisy({name}) for sample in self._samples])
                layers[f"layers/{name}"] = self._layout.image(grey, is_noisy=True)
        if "static" in requested_layers:
            static_scene = self.observed.scene.static or self.observed.scene
            static_clean = static_scene.sample(self._variant, self._draws.effects).clean
            layers["static"] = self._layout.image(static_clean, is_noisy=False)
        if "mean" in requested_layers:
            layers["mean"] = self._layout.image(self._expected_grey(), is_noisy=False)
        return layers

    def measured(self, names: Collection[str]) -> dict[str, Array]:
        """(range_bins, beams) of the named measured layers; each beam from its group's sample."""
        measured = [sample.measured(self._draws.names, names) for sample in self._samples]
        return {name: _by_beam_group([values[name] for values in measured]) for name in measured[0]}

    def _expected_grey(self) -> Float32s:
        """The mean of noisy images; images of points have none, and their clean image counts."""
        return _by_beam_group(
            [
                sample.mean if isinstance(sample, CoherentSample) else sample.clean
                for sample in self._samples
            ]
        )

    def _visibility(self) -> dict[str, float | str]:
        """The column `visibility`: in the mean of noisy images, whose noise hides what is faint."""
        return visibility_row(
            self._layout.image(self._expected_grey(), is_noisy=False),
            np.asarray(self.layers["instance"], np.uint16),
            self._layout.inside(),
            self._config.sonar.transfer,
            "amplitude" if is_coherent(self._config.acoustics) else "intensity",
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

    def inside(self) -> Bools:
        """(H, W) bool: the pixels of the sector that hold data."""
        is_seen = polar.seen_beams(self._window, self._sonar)
        bins = np.repeat(is_seen[None], self._sonar.range_bins, axis=0)
        return lay_out_nearest(bins, self._window, self._sonar)

    def image(self, grey: Float32s, *, is_noisy: bool) -> Array:
        """(range_bins, beams) grey values -> (H, W) uint8 or float32."""
        if self._is_plain:
            laid_out = lay_out(grey, self._window, self._sonar)
        else:
            laid_out = rasterised(grey, self._window, self._sonar, noisy=is_noisy)
        return transfer.quantise(laid_out, self._dtype)
