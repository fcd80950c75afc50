"""One frame -> its pairs: the whole method (Yang et al. 2024, section 3).

    frame -> render (light at the sonar) -> echoes -> resampled scene -+-> clean picture T
                                                              + noise -+-> noisy picture X

Clean and noisy come from the same resampled scene, through the same image formation and the same
transfer curve.  Only the noise differs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from simnfnd.factory import noise, seeds
from simnfnd.factory.dataset.format.sample import Axis, Column, Pair
from simnfnd.factory.errors import FrameError
from simnfnd.factory.formation import layers as truth
from simnfnd.factory.formation import resample
from simnfnd.factory.formation.field.pairs import field_scene, make_field_pair
from simnfnd.factory.formation.record import columns, image_axes, record
from simnfnd.factory.frame import Frame, FrameRef
from simnfnd.factory.render.views import open_views
from simnfnd.factory.sonar import polar, surface, transfer
from simnfnd.factory.sonar.echoes import Echoes, join
from simnfnd.factory.sonar.fan import lay_out, lay_out_nearest
from simnfnd.factory.sonar.settings import SonarSettings
from simnfnd.factory.sonar.window import Window
from simnfnd.factory.sonar.window_fit import fit_window
from simnfnd.factory.workers.memory import keep_freed_memory

if TYPE_CHECKING:
    from simnfnd.factory.config import FactoryConfig
    from simnfnd.factory.render.base import Rendered


@dataclass(frozen=True, eq=False)
class Scene:
    """The rendered scene as the sonar measures it, at full density; no randomness up to here.

    echoes: every insonified surface point in the window, strengths after time-varying gain.
    window: range and azimuth limits of the picture.  shadow: (H, W) bool picture.
    layers: (H, W) pictures of what is behind each pixel, where asked for.
    """

    ref: FrameRef
    echoes: Echoes
    window: Window
    shadow: npt.NDArray[np.bool_]
    layers: Mapping[str, npt.NDArray[np.generic]] = field(default_factory=dict)


class PairMaker:
    """Makes pairs of renders; a `sample.PairSource`.  Needs no renderer."""

    def __init__(self, config: FactoryConfig) -> None:
        keep_freed_memory()
        self.config = config
        self.views = open_views(config)

    def axes(self) -> tuple[Axis, Axis]:
        """Row and column axes of the pictures."""
        return image_axes(self.config.sonar)

    def columns(self) -> tuple[Column, ...]:
        """Columns of the sample table."""
        return columns(self.config.noise)

    def pairs(self, ref: FrameRef, variants: tuple[int, ...]) -> list[Pair]:
        """The asked variants of one frame.

        Raises FrameError when the frame is bad, NotRendered when its render is not at hand.
        """
        view = self.views.view(ref)
        frame, rendered, config = view.frame(ref), view.rendered(), self.config
        if config.acoustics.formation == "field":
            heard = field_scene(frame, rendered, config)
            return [make_field_pair(heard, variant, config) for variant in variants]
        scene = observe(frame, rendered, config.sonar, config.dataset.layers)
        return [make_pair(scene, variant, config) for variant in variants]

    def ready(self, ref: FrameRef) -> bool:
        """Whether the frame's render is at hand."""
        return self.views.holds(ref)


def observe(
    frame: Frame, rendered: Rendered, sonar: SonarSettings, layers: Sequence[str] = ()
) -> Scene:
    """The rendered pixels of a frame as echoes around the sonar.

    layers: names of `dataset.layers`.
    Raises FrameError when the sonar's sector holds no insonified surface.
    """
    try:
        window = fit_window(surface.extent(frame, rendered, sonar), sonar)
    except FrameError as error:
        raise FrameError(f"{frame.ref.name}: {error}") from error
    echoes, pixel, hit = surface.insonified(frame, rendered, window, sonar)
    shadow = ~polar.covered(hit) & polar.seen_beams(window, sonar)
    behind = truth.pictures(layers, frame, echoes, pixel, window, sonar)
    return Scene(
        frame.ref,
        echoes,
        window,
        lay_out_nearest(shadow, window, sonar),
        {name: lay_out_nearest(picture, window, sonar) for name, picture in behind.items()},
    )


def make_pair(scene: Scene, variant: int, config: FactoryConfig) -> Pair:
    """One (noisy, clean) pair; the same scene, variant and configuration give the same bytes."""
    sonar, window = config.sonar, scene.window
    names = (scene.ref.location, scene.ref.scene, scene.ref.frame, variant)
    rate = config.resample.rate.draw(seeds.stream(config.seed, "parameter", "resample", *names))
    drawn = noise.draw(config.noise, config.seed, *names)

    if config.resample.kind == "random":
        thinning = seeds.stream(config.seed, "resample", *names)
        kept = movable = resample.random_subset(scene.echoes, rate, thinning)
    else:
        size_m = resample.voxel_size_m(scene.echoes, rate)
        kept, movable = resample.voxel(scene.echoes, size_m), scene.echoes
    clean_level = _image_level([kept], window, sonar)
    full_scale = transfer.full_scale(clean_level, sonar.transfer)

    made = noise.layers(kept, movable, window, drawn, config.seed, *names)

    def picture(level: npt.NDArray[np.float32]) -> npt.NDArray[np.generic]:
        grey = transfer.grey(level, full_scale, sonar.transfer)
        return transfer.quantise(lay_out(grey, window, sonar), config.dataset.dtype)

    def noisy(effects: dict[str, Echoes]) -> npt.NDArray[np.generic]:
        cloud = noise.parts(movable, effects, full_scale)
        if config.resample.kind == "voxel":
            cloud = [resample.voxel(join(*cloud), size_m)]
        return picture(_image_level(cloud, window, sonar))

    layers = dict(scene.layers)
    if "effects" in config.dataset.layers:
        layers |= {f"layers/{effect}": noisy({effect: one}) for effect, one in made.items()}
    return Pair(
        noisy=noisy(made),
        clean=picture(clean_level),
        shadow=scene.shadow,
        record=record(scene.ref, variant, config, window, rate, drawn, kept, made, full_scale),
        layers=layers,
    )


def _image_level(
    cloud: Sequence[Echoes], window: Window, sonar: SonarSettings
) -> npt.NDArray[np.float32]:
    """(range_bins, beams) echo level as the device resolves it; 0 in beams without data."""
    scene, *added = cloud
    level = polar.spread_points(polar.accumulate(scene, window, sonar, *added), sonar)
    level[:, ~polar.seen_beams(window, sonar)] = 0
    return level
