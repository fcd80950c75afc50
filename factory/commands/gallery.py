"""`simnfnd gallery`: the paper's Figures 3 to 8 and 12, from procedural seabed scenes.

Any words KEY=VALUE go to the configuration, so that the same figures can be made of other scenes or
another sonar: `simnfnd gallery scenes=flsea scenes.root=DIR`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..cli import Parser
from ..cli.extras import needs_of, require
from ..config import FactoryConfig, from_mapping
from ..dataset.describe.quality import psnr_db
from ..distribution import Distribution, number
from ..errors import FactoryError
from ..frame import Frame, FrameRef
from ..gallery import figures
from ..gallery.figures import Figure, Panel
from ..noise.registry import EFFECTS, NoiseSettings
from ..pairs import ObservedFrame, make_pair, observe
from ..render.base import Rendered
from ..sonar.surface import insonified

# The paper's view from above, drawn larger than data sets need.
_PICTURE = (
    "sonar.projection=top_view", "sonar.image.width_px=360", "sonar.image.height_px=360",
    "sonar.beams=320", "sonar.range_bins=320", "resample.rate=0.6", "dataset.dtype=float32",
)  # fmt: skip
_SCENES = (
    "scenes=seabed", "scenes.places=[debris,pier,pipeline,quay]", "scenes.locations=4",
    "scenes.frames_per_location=1",
)  # fmt: skip
_MOST_SCENES = 4
_RATES = (0.05, 0.2, 0.8)
_MANY = 5
# Figure of the paper -> (effect, what it is called).
_EFFECTS = {
    "5": ("background", "Background noise"),
    "7": ("multipath", "Multipath ghosts"),
    "8": ("azimuth", "Azimuthal artefacts"),
}
_ALONE = ("range_spreading", "multipath", "azimuth", "background")


@dataclass(frozen=True, eq=False)
class View:
    """One frame with everything that the figures show of it."""

    frame: Frame
    rendered: Rendered
    observed: ObservedFrame


def main(words: list[str]) -> None:
    """Draw the figures that `words` ask for."""
    parser = Parser(prog="simnfnd gallery")
    parser.add_argument("--out", type=Path, default=Path("outputs/gallery"), help="folder to fill")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="as for making a dataset")
    given = parser.parse_args(words)
    for path in gallery(given.out, given.settings):
        print(f"gallery: {path}")


def gallery(out: Path, settings: Iterable[str] = ()) -> list[Path]:
    """Draw all figures into `out` as PNG; equal settings give equal files.

    Raises FactoryError for a bad setting or when no frame can be used.
    """
    config = compose(settings)
    require(needs_of(config))
    views = list(_views(config))
    return [figures.save(figure, out) for figure in _figures(views, config)]


def compose(settings: Iterable[str]) -> FactoryConfig:
    """The configuration of the gallery with `settings` on top."""
    # Hydra imports antlr and plugins.
    from hydra import compose as hydra_compose
    from hydra import initialize_config_module
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from ..distribution import as_override

    words = [as_override(word) for word in settings]
    base = _PICTURE if any(word.startswith("scenes=") for word in words) else _SCENES + _PICTURE
    try:
        with initialize_config_module("simnfnd.conf", version_base="1.3"):
            composed = hydra_compose("factory", overrides=[*base, *words])
        values = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    except (HydraException, OmegaConfBaseException) as error:
        reason = " ".join(str(error).split())
        raise FactoryError(f"gallery: {reason} (see `simnfnd make --cfg job`)") from error
    assert isinstance(values, dict)
    return from_mapping({str(key): item for key, item in values.items() if key != "experiment"})


def alone(config: FactoryConfig, effect: str, quantile: float, **fixed: Any) -> FactoryConfig:
    """`config` with one noise effect, its parameters at `quantile` (0 or 1) of their ranges."""
    blocks = {
        item.name: replace(block, enabled=item.name == effect)
        for item in fields(NoiseSettings)
        if (block := getattr(config.noise, item.name)) is not None
    }
    block = blocks[effect]
    ends = {
        item.name: number(_end(value, quantile))
        for item in fields(block)
        if isinstance(value := getattr(block, item.name), Distribution)
    }
    blocks[effect] = replace(block, **{**ends, **fixed})
    return replace(config, noise=NoiseSettings(**blocks))


def _end(distribution: Distribution, quantile: float) -> float:
    values = distribution.values
    if distribution.kind == "normal":
        mean, std = values
        value = mean + (4 * quantile - 2) * std
    else:
        value = min(values) + quantile * (max(values) - min(values))
    return min(max(value, distribution.low), distribution.high)


def _views(config: FactoryConfig) -> Iterator[View]:
    from ..render import open_renderer
    from ..scenes import frames_of, open_reader
    from ..selection import choose_frames

    reader = open_reader(config.scenes)
    found = choose_frames(frames_of(reader), config)
    first: dict[tuple[str, str], FrameRef] = {}
    for ref in found:
        first.setdefault((ref.location, ref.scene), ref)
    renderer = open_renderer(config.render)
    for ref in list(first.values())[:_MOST_SCENES]:
        frame = reader.load(ref)
        rendered = renderer.render(frame, config.sonar.mount)
        yield View(frame, rendered, observe(frame, rendered, config))


def _figures(views: list[View], config: FactoryConfig) -> Iterator[Figure]:
    main_view = views[0]
    yield Figure(
        "figure-03",
        "Figure 3   RGBD data and the ideal render",
        [
            [
                figures.photo("colour" if first else "", view.frame.rgb)
                for first, view in _told(views)
            ],
            [figures.depth("depth" if first else "", view.frame) for first, view in _told(views)],
            [
                figures.radiance("rendered, light at the sonar" if first else "", view.rendered)
                for first, view in _told(views)
            ],
        ],
    )
    yield Figure(
        "figure-04",
        "Figure 4   The cloud with reflective intensity, seen from above",
        [
            [
                figures.radiance("rendered", view.rendered),
                _from_above(view, config),
            ]
            for view in views[:2]
        ],
    )
    clean = _clean(main_view, config, "clean")
    for figure, (effect, name) in _EFFECTS.items():
        yield Figure(
            f"figure-{int(figure):02d}",
            f"Figure {figure}   {name} alone, from weak to strong (PSNR against clean)",
            [[clean, *_strengths(main_view, config, effect)]],
        )
        if figure == "5":
            yield _spreading(main_view, config, clean)
    yield Figure(
        "noise-effects",
        "Each effect alone at the strong end of its range, and all as drawn (PSNR)",
        [
            [clean, *(_noisy(main_view, alone(config, e, 1), _word(e)) for e in _ALONE[:2])],
            [
                *(_noisy(main_view, alone(config, e, 1), _word(e)) for e in _ALONE[2:]),
                _noisy(main_view, config, "all together"),
            ],
        ],
    )
    yield Figure(
        "resampling",
        "Three resampling rates: a coarser sonar keeps fewer points",
        [
            [_clean(main_view, _at(config, rate), f"clean, rate {rate:g}") for rate in _RATES],
            [_noisy(main_view, _at(config, rate), f"noisy, rate {rate:g}") for rate in _RATES],
        ],
    )
    yield Figure(
        "figure-12",
        "Figure 12   From frame to pairs: colour, render, ideal picture, noisy at three rates",
        [
            [
                figures.photo("colour", view.frame.rgb),
                figures.radiance("rendered", view.rendered),
                _clean(view, config, "clean"),
                *(_noisy(view, _at(config, rate), f"noisy, rate {rate:g}") for rate in _RATES),
            ]
            for view in views[:3]
        ],
    )


def _spreading(view: View, config: FactoryConfig, clean: Panel) -> Figure:
    modes = (
        ("radial", "radial (default)"),
        ("exponential", "exponential"),
        ("paper", "as printed"),
    )
    return Figure(
        "figure-06",
        "Figure 6   Range spreading alone, at the strong end of its range (PSNR against clean)",
        [
            [
                clean,
                *(
                    _noisy(view, alone(config, "range_spreading", 1, mode=mode), name)
                    for mode, name in modes
                ),
            ]
        ],
    )


def _strengths(view: View, config: FactoryConfig, effect: str) -> list[Panel]:
    weak, strong = (alone(config, effect, end) for end in (0, 1))
    many = alone(config, effect, 1, density=number(_MANY * _density(strong, effect)))
    return [
        _noisy(view, weak, "weak end"),
        _noisy(view, strong, "strong end"),
        _noisy(view, many, f"{_MANY} times as many points"),
    ]


def _density(config: FactoryConfig, effect: str) -> float:
    density: Distribution = getattr(config.noise, effect).density
    return density.values[0]


def _told(views: list[View]) -> Iterator[tuple[bool, View]]:
    """Views, the first of them marked: one label a row is enough."""
    return ((number == 0, view) for number, view in enumerate(views))


def _at(config: FactoryConfig, rate: float) -> FactoryConfig:
    return replace(config, resample=replace(config.resample, rate=number(rate)))


def _from_above(view: View, config: FactoryConfig) -> Panel:
    found = insonified(view.frame, view.rendered, view.observed.window, config.sonar)
    return figures.from_above("view from above", found.echoes)


def _clean(view: View, config: FactoryConfig, name: str) -> Panel:
    return figures.sonar(name, make_pair(view.observed, 0, config).clean)


def _noisy(view: View, config: FactoryConfig, name: str) -> Panel:
    """A noisy picture, with the figure of how noisy it is."""
    pair = make_pair(view.observed, 0, config)
    return figures.sonar(f"{name}   {psnr_db(pair.clean, pair.noisy):.1f} dB", pair.noisy)


def _word(effect: str) -> str:
    assert effect in EFFECTS
    return effect.replace("_", " ")
