"""Fresh noise, or drawn devices, on clean renders at every visit.

The renders are those of a dataset, in the cache or in a pack; pairs are made of them by the same
code as the dataset's own, so a network never sees the same noise twice.
"""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.distribution import Distribution
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.seeds import stream
from ...factory.dataset.fan_geometry import FanGeometry
from ...factory.dataset.frame_ref import FrameRef
from ...factory.dataset.pair_dataset import in_unit_range
from ...factory.simulation.config.root import FactoryConfig
from ...factory.simulation.devices import draw as devices
from ...factory.simulation.moving.recordings import Moment
from ...factory.simulation.noise.draws import StreamNames, draw
from ...factory.simulation.noise.registry import BUILT_IN, NoiseSettings, blocks, with_blocks
from ...factory.simulation.pairs.pair_maker import PairMaker, frames_worth_keeping, observe_by
from ...factory.simulation.pairs.views import Views, open_views
from ...factory.simulation.sonar.fan import rasterised
from ...factory.simulation.sonar.settings import SonarSettings
from ..networks import DEFAULT
from ..settings import RenderedData
from .pairs import ImageSource, TrainingImage, weakened

_ATTEMPTS = 40
_LEAST_ECHOES = 0.02  # part of the bins that must hold surface: an image of nothing is no lesson
_BLACK = 0.02  # shadow counts as such where the target is darker; under haze there is none to see
# Parameters that are 0 where an effect is absent: these a weaker noise scales.
_AMOUNTS = ("alpha", "density", "strength")


class ImageScale(NamedTuple):
    """Size of an image as multiples of the dataset's.

    cells: factor of beams and range bins.  pixels: factor of the image's width and height.
    """

    cells: float
    pixels: float


def image_scales(data: RenderedData) -> list[ImageScale]:
    """The entries of `data.scales`: a number scales cells and pixels alike, a pair each of them."""
    scales = []
    for entry in data.scales:
        cells, pixels = entry if isinstance(entry, tuple) else (entry, entry)
        scales.append(ImageScale(cells, pixels))
    return scales


_SAME_SIZE = ImageScale(1.0, 1.0)


class RenderedSource(ImageSource):
    """Pairs made on the fly of rendered frames."""

    images: tuple[FrameRef, ...]

    def __init__(
        self, config: FactoryConfig, frames: tuple[FrameRef, ...], data: RenderedData, seed: int
    ) -> None:
        """config: how pairs are made.  frames: whose renders are at hand."""
        self.config = replace(config, seed=seed)
        self.images = frames
        self.data = data
        self.seed = seed


class RenderSource(RenderedSource):
    """Pairs of the configuration's device, under fresh noise at each visit."""

    @cached_property
    def _makers(self) -> dict[ImageScale, PairMaker]:
        scales = (_SAME_SIZE, *image_scales(self.data))
        sonars = {scale: resized(self.config.sonar, scale) for scale in scales}
        configs = {scale: replace(self.config, sonar=sonar) for scale, sonar in sonars.items()}
        kept_frames = frames_worth_keeping(len(configs) * len(self.images)) // len(configs)
        return {
            scale: PairMaker(config, open_views(config), kept_frames=kept_frames)
            for scale, config in configs.items()
        }

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """See `ImageSource`."""
        scale = _SAME_SIZE
        number = 0
        noise = None
        if visit is not None:
            scale = self.scale_of(index, visit)
            number = visit
            noise = self.noise_of(index, visit)
        maker = self._makers[scale]
        try:
            (pair,) = maker.pairs(self.images[index], (number,), noise)
        except FrameError as error:
            raise FactoryError(f"data=renders: {error}; leave the frame out") from error
        return TrainingImage(
            in_unit_range(pair.noisy),
            in_unit_range(pair.clean),
            pair.shadow.astype(np.float32),
            FanGeometry.from_record(maker.config.sonar, pair.record),
        )

    def scale_of(self, index: int, visit: int) -> ImageScale:
        """Size of the image of a visit: any of `data.scales`."""
        scales = image_scales(self.data)
        return scales[stream(self.seed, "scale", index, visit).integers(len(scales))]

    def noise_of(self, index: int, visit: int) -> NoiseSettings:
        """The noise of a visit: as configured, or with less of all effects, or some effects off.

        An effect that has no amount to make less of is left out in as many visits instead.
        """
        chosen = self.config.noise
        factor = weakened(self.data.weaker, self.seed, index, visit)
        rng = stream(self.seed, "fewer", index, visit)
        fewer = rng.random() < self.data.fewer
        present = blocks(chosen)
        changed = {}
        # Absent effects have their coins, too, so that the others keep theirs.
        for name in dict.fromkeys((*BUILT_IN, *present)):
            coins = rng.random(2)
            if name not in present:
                continue
            block = present[name]
            weaker = scaled(block, factor) if factor < 1 else block
            off = (fewer and coins[0] < 0.5) or factor == 0
            off |= factor < 1 and weaker == block and coins[1] >= factor
            changed[name] = replace(weaker, enabled=block.enabled and not off)
        return with_blocks(chosen, changed)


class DeviceSource(RenderedSource):
    """Pairs of drawn devices, with a configuration that has `devices`.

    Device, formation, display, size and rasterisation of the image are drawn at each visit.  The
    target is the same image without the artefacts of `networks.DEFAULT`, under the same random
    streams.
    """

    @cached_property
    def _views(self) -> Views:
        return open_views(self.config)

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """See `ImageSource`."""
        names = (index, "validation" if visit is None else visit)
        for attempt in range(_ATTEMPTS):
            # A frame that shows nothing to this device gives way to the next one.
            ref = self.images[(index + attempt // 4) % len(self.images)]
            try:
                sample = self._sample(ref, *names, attempt)
            except FrameError:
                continue
            if sample is not None:
                return sample
        raise FactoryError(
            f"data=mixed: no device sees enough of {self.images[index].name} and of the frames "
            "after it; make renders of other places"
        )

    def _sample(self, ref: FrameRef, *names: int | str) -> TrainingImage | None:
        """A training image of a frame by a drawn device; None where it is small or nearly empty.

        names: of the random streams, beside the frame's.
        """
        assert self.config.devices is not None
        device = devices.draw(self.config.devices, self.seed, ref.name, *names)
        view = self._views.view(ref)
        moment = Moment(view.frame(ref), view.rendered())
        observed, config = observe_by(device, moment, self.config, any_size=True)
        is_small = min(config.sonar.shape()) < self.data.least_side
        if is_small or observed.scene.filled.mean() < _LEAST_ECHOES:
            return None
        draws = draw(config.noise, self.seed, StreamNames.single(ref.name, *names))
        # Points are thinned by a variant's stream: any number that no other image has.
        variant = int(stream(self.seed, "variant", *names).integers(2**31))
        sample = observed.scene.sample(variant, draws.effects)
        window = observed.window
        noisy = rasterised(sample.noisy(draws.names), window, config.sonar, noisy=True)
        clean = rasterised(sample.without(DEFAULT), window, config.sonar, noisy=False)
        strength = np.float32(weakened(self.data.weaker, self.seed, *names))
        limits = (window.range_min_m, window.range_max_m)
        return TrainingImage(
            clean + strength * (noisy - clean),
            clean,
            (observed.shadow & (clean <= _BLACK)).astype(np.float32),
            FanGeometry.from_sonar(
                config.sonar, *limits, window.azimuth_min_rad, window.azimuth_max_rad
            ),
        )


def scaled(block: Any, factor: float) -> Any:
    """An effect's settings with `alpha`, `density` and `strength` times `factor`."""
    changes = {}
    for item in fields(block):
        value = getattr(block, item.name)
        if item.name in _AMOUNTS and isinstance(value, Distribution):
            values = tuple(number * factor for number in value.values)
            changes[item.name] = replace(value, values=values)
    return replace(block, **changes)


def resized(sonar: SonarSettings, scale: ImageScale) -> SonarSettings:
    """The device with other numbers of beams, range bins and pixels.

    Its point spread stays as many bins and beams wide, so with more of them it resolves more.
    Raises FactoryError when that is too many, and where there is a table of beams, which says
    nothing of beams between.
    """
    if scale == _SAME_SIZE:
        return sonar
    image = sonar.image
    cells = {name: round(scale.cells * getattr(sonar, name)) for name in ("beams", "range_bins")}
    pixels = {
        name: round(scale.pixels * getattr(image, name)) for name in ("width_px", "height_px")
    }
    try:
        return replace(sonar, **cells, image=replace(image, **pixels))
    except ValueError as error:
        raise FactoryError(
            f"data.scales: [{scale.cells:g}, {scale.pixels:g}] makes {cells | pixels}; 2 to 8192 "
            "of each are possible, and of a sonar with a table of beams only its own"
        ) from error
