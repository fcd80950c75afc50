"""The paper's Figures 3 to 8 and 12, and the devices of the physical profile, as PNG.

    python examples/paper_figures.py --out outputs/figures
    python examples/paper_figures.py scenes=flsea scenes.root=flsea-vi --out outputs/flsea-figures

Words KEY=VALUE are those of `simnfnd make`.  Needs the extras `figures` and, unless another
render= is given, `blender`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from importlib import resources
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib import pyplot

from simnfnd.factory.common.distribution import Distribution, number
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.quality import psnr_db
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.config.selection import choose_frames
from simnfnd.factory.simulation.frames.frame import Frame
from simnfnd.factory.simulation.noise.registry import BUILT_IN, NoiseSettings
from simnfnd.factory.simulation.pairs.pair_maker import ObservedFrame, make_pair, observe
from simnfnd.factory.simulation.render import open_renderer
from simnfnd.factory.simulation.render.base import Rendered
from simnfnd.factory.simulation.scenes import open_reader
from simnfnd.factory.simulation.sonar.surface import insonified

# The paper's view from above, drawn larger than datasets need.
IMAGE_SETTINGS = (
    "sonar.projection=top_view", "sonar.image.width_px=360", "sonar.image.height_px=360",
    "sonar.beams=320", "sonar.range_bins=320", "resample.rate=0.6", "dataset.dtype=float32",
)  # fmt: skip
SCENES = (
    "scenes=seabed", "scenes.places=[debris,pier,pipeline]", "scenes.locations=3",
    "scenes.frames_per_location=1",
)  # fmt: skip
RATES = (0.05, 0.2, 0.8)
MANY = 5
# Figure of the paper -> the effect that it shows alone.
EFFECTS = {5: "background", 6: "range_spreading", 7: "multipath", 8: "azimuth"}


@dataclass(frozen=True)
class Panel:
    """One image: (H, W) values, or (H, W, 3) uint8 colours.

    limits: values that are black and white.  size_m: (left, right, bottom, top), for a map.
    """

    title: str
    image: Any
    limits: tuple[float, float] = (0.0, 1.0)
    size_m: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class View:
    """One frame with everything that the figures show of it."""

    frame: Frame
    rendered: Rendered
    observed: ObservedFrame


def main() -> None:
    """Draw all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE")
    parser.add_argument("--out", type=Path, default=Path("outputs/figures"))
    parser.add_argument("--only", choices=("paper", "devices"))
    options = parser.parse_intermixed_args()
    own = any(word.startswith("scenes=") for word in options.settings)
    config = compose_config([*(() if own else SCENES), *IMAGE_SETTINGS, *options.settings])
    matplotlib.use("Agg")
    options.out.mkdir(parents=True, exist_ok=True)
    if options.only != "devices":
        for name, rows in figures(views(config), config).items():
            save(options.out / f"{name}.png", rows)
    if options.only != "paper":
        renders = [word for word in options.settings if word.startswith("render=")]
        save(options.out / "devices.png", devices(renders))


def views(config: FactoryConfig, most: int = 3) -> list[View]:
    """The first frame of (at most `most`) scenes, rendered and observed."""
    reader = open_reader(config.scenes)
    first = {}
    for ref in choose_frames(reader.discover().frames, config):
        first.setdefault((ref.location, ref.scene), ref)
    renderer = open_renderer(config.render)
    views_of_scenes = []
    for ref in list(first.values())[:most]:
        frame = reader.load(ref)
        rendered = renderer.render(frame, config.sonar.mount)
        views_of_scenes.append(View(frame, rendered, observe(frame, rendered, config)))
    return views_of_scenes


def figures(observed_views: Sequence[View], config: FactoryConfig) -> dict[str, list[list[Panel]]]:
    """File name -> rows of panels."""
    first = observed_views[0]
    alike = clean(first, config)
    rows_of_figure = {
        "figure-03": [[photo(v), depth(v), radiance(v)] for v in observed_views],
        "figure-04": [[radiance(v), from_above(v, config)] for v in observed_views[:2]],
    }
    for figure, effect in EFFECTS.items():
        weak, strong = (alone(config, effect, end) for end in (0.0, 1.0))
        row = [alike, noisy(first, weak, f"{effect}, weak end"), noisy(first, strong, "strong end")]
        if hasattr(getattr(config.noise, effect), "density"):
            row.append(noisy(first, more(strong, effect), f"{MANY} times as many points"))
        rows_of_figure[f"figure-{figure:02d}"] = [row]
    rows_of_figure["figure-12"] = [
        [photo(v), radiance(v), clean(v, config)]
        + [noisy(v, at_rate(config, rate), f"noisy, rate {rate:g}") for rate in RATES]
        for v in observed_views
    ]
    return rows_of_figure


def alone(config: FactoryConfig, effect: str, quantile: float) -> FactoryConfig:
    """`config` with one noise effect, its parameters at `quantile` (0 or 1) of their ranges."""
    blocks = {
        name: replace(block, enabled=name == effect)
        for name in BUILT_IN
        if (block := getattr(config.noise, name)) is not None
    }
    block = blocks[effect]
    ends = {
        item.name: number(end(value, quantile))
        for item in fields(block)
        if isinstance(value := getattr(block, item.name), Distribution)
    }
    blocks[effect] = replace(block, **ends)
    return replace(config, noise=NoiseSettings(**blocks))


def more(config: FactoryConfig, effect: str) -> FactoryConfig:
    """The same with MANY times as many points of an effect."""
    block = getattr(config.noise, effect)
    block = replace(block, density=number(MANY * block.density.values[0]))
    return replace(config, noise=replace(config.noise, **{effect: block}))


def end(distribution: Distribution, quantile: float) -> float:
    """The weak (0) or strong (1) end of a distribution; of a normal one two deviations off."""
    low = min(distribution.values)
    high = max(distribution.values)
    if distribution.kind == "normal":
        mean, std = distribution.values
        low, high = mean - 2 * std, mean + 2 * std
    value = low + quantile * (high - low)
    return min(max(value, distribution.low), distribution.high)


def at_rate(config: FactoryConfig, rate: float) -> FactoryConfig:
    """The same with another resampling rate: a coarser sonar keeps fewer points."""
    return replace(config, resample=replace(config.resample, rate=number(rate)))


def photo(view: View) -> Panel:
    """Colours as they are."""
    return Panel("colour", view.frame.rgb)


def depth(view: View) -> Panel:
    """Depth along the optical axis; near is bright, black is no measurement."""
    near, far = np.percentile(view.frame.depth_m[view.frame.valid], (0.5, 99.5))
    image = np.where(view.frame.valid, view.frame.depth_m, np.inf)
    return Panel("depth", -image, (-float(far + 0.15 * (far - near)), -float(near)))


def radiance(view: View) -> Panel:
    """Rendered echo strength of each camera pixel, on a square-root scale."""
    value = np.sqrt(np.maximum(view.rendered.radiance, 0))
    return Panel("rendered", value, (0, float(np.percentile(value[value > 0], 99))))


def from_above(view: View, config: FactoryConfig, cells: int = 420) -> Panel:
    """Mean echo strength of the cloud per cell of the floor plan, metres."""
    echoes = insonified(view.frame, view.rendered, view.observed.window, config.sonar).echoes
    ground_m = echoes.range_m * np.cos(echoes.elevation_rad)
    right_m = ground_m * np.sin(echoes.azimuth_rad)
    ahead_m = ground_m * np.cos(echoes.azimuth_rad)
    half_m = np.abs(right_m).max()
    near_m = ahead_m.min()
    far_m = ahead_m.max()
    box = ((near_m, far_m), (-half_m, half_m))
    total, _, _ = np.histogram2d(ahead_m, right_m, cells, box, weights=echoes.strength)
    count, _, _ = np.histogram2d(ahead_m, right_m, cells, box)
    mean = (total / np.maximum(count, 1))[::-1]
    limits = (0.0, float(np.percentile(mean[mean > 0], 97)))
    return Panel("view from above, m", mean, limits, (-half_m, half_m, near_m, far_m))


def clean(view: View, config: FactoryConfig) -> Panel:
    """The clean image."""
    return Panel("clean", make_pair(view.observed, 0, config).clean)


def noisy(view: View, config: FactoryConfig, title: str) -> Panel:
    """A noisy image, with the figure of how noisy it is."""
    pair = make_pair(view.observed, 0, config)
    return Panel(f"{title}   {psnr_db(pair.clean, pair.noisy):.1f} dB", pair.noisy)


def devices(settings: Sequence[str]) -> list[list[Panel]]:
    """One procedural place through every device, by the sonar equation."""
    folder = resources.files("simnfnd.conf") / "sonar"
    names = sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir())
    panels = []
    for name in names:
        words = [*SCENES, "scenes.locations=1", "experiment=physical", "dataset.dtype=float32"]
        config = compose_config([*words, f"sonar={name}", *settings])
        (view,) = views(config, 1)
        image = make_pair(view.observed, 0, config).noisy
        rows = image.any(axis=1).nonzero()[0]
        columns = image.any(axis=0).nonzero()[0]
        part = image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        panels.append(Panel(f"{name}, {config.sonar.frequency_khz:g} kHz", part))
    return [panels[first : first + 5] for first in range(0, len(panels), 5)]


def save(path: Path, rows: Sequence[Sequence[Panel]]) -> None:
    """Draw rows of panels, and say where."""
    wide = max(map(len, rows))
    figure, axes = pyplot.subplots(
        len(rows), wide, figsize=(2.6 * wide, 2.5 * len(rows)), squeeze=False, layout="constrained"
    )
    for row, places in zip(rows, axes, strict=True):
        for place in places:
            place.set_axis_off()
        for panel, place in zip(row, places, strict=False):
            low, high = panel.limits
            place.imshow(panel.image, "gray", vmin=low, vmax=high, extent=panel.size_m)
            place.set_title(panel.title, fontsize=8)
            place.set_axis_on()
            place.set(xticks=[], yticks=[]) if panel.size_m is None else place.tick_params(
                labelsize=6
            )
            place.set_facecolor("black")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
    print(f"figure: {path}")


if __name__ == "__main__":
    try:
        main()
    except FactoryError as error:
        raise SystemExit(str(error)) from error
