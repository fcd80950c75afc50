"""`simnfnd physics`: the physical profile in pictures and figures.

Writes one procedural scene through every device (presets.png) and each effect alone
(physical-effects.png), and prints the statistics of an echo that is the same everywhere beside
those of other simulators, and the speckle of every device.  Words KEY=VALUE go to the configuration
of the pictures.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..cli import Parser
from ..cli.compose import compose_config
from ..cli.extras import needs_of, require
from ..distribution import as_override
from ..errors import FactoryError
from ..gallery import figures
from ..gallery.device_statistics import device_table
from ..gallery.figures import Figure, Panel
from ..gallery.statistics import table
from ..noise.registry import FIELD_EFFECTS
from ..pairs import make_pair, observe

if TYPE_CHECKING:
    from ..config import FactoryConfig
    from ..dataset.format.sample import Pair
    from ..frame import Frame
    from ..render.base import Rendered

Picture = npt.NDArray[np.generic]

# A place with an object or two on even ground, near enough for all devices.
_SCENE = (
    "experiment=physical", "scenes.places=[debris]", "scenes.locations=1",
    "scenes.frames_per_location=1", "dataset.dtype=float32",
)  # fmt: skip
_ROW = 4
# What each effect is turned up to where it is shown alone, to be seen in a small picture.
_STRONG = (
    "noise.speckle.looks=1", "noise.volume.strength_db=-48",
    "noise.surface_multipath={loss_db: 1, tilt_deg: 20}",
    "noise.bottom_multipath={enabled: true, loss_db: 1, altitude_m: 1.8, tilt_deg: 20}",
    "noise.texture={shape: 1, patch_m: 0.3}", "noise.sidelobe_arcs.level_db=-20",
    "noise.crosstalk={level_db: -10, spacing_beams: 24}",
    "noise.receiver.level_db=25", "noise.tvg_error={db_per_decade: 30, db_per_m: 1}",
    "noise.beam_gain={sigma_db: 3, dead: 3}", "noise.spokes={count: 3, level_db: -12}",
    "noise.ring_down={level_db: 0, decay_db_per_m: 20}",
    "noise.comb_lines={level_db: 0, spacing_m: 0.2, decay_db: 2}", "noise.saturation.level_db=-35",
    "water.depth_m=1.2",
    "sonar.range={auto: false, min_m: 0.2, max_m: 6}", "dataset.layers=[effects]",
)  # fmt: skip


def main(words: list[str]) -> None:
    """Draw and print what `words` ask for."""
    parser = Parser(prog="simnfnd physics")
    parser.add_argument("--out", type=Path, default=Path("outputs/physics"), help="folder to fill")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="as for making a dataset")
    given = parser.parse_args(words)
    for path in pictures(given.out, given.settings):
        print(f"physics: {path}")
    print(table())
    print(device_table(devices()), end="")


def devices() -> list[str]:
    """The names of the sonar presets."""
    folder = resources.files("simnfnd.conf") / "sonar"
    return sorted(
        one.name.removesuffix(".yaml") for one in folder.iterdir() if one.name.endswith(".yaml")
    )


def pictures(out: Path, settings: Iterable[str] = ()) -> list[Path]:
    """Draw both figures into `out` as PNG; equal settings give equal files.

    Raises FactoryError for a bad setting or when the frame cannot be used.
    """
    words = [*_SCENE, *settings]
    config = compose_config(words)
    if config.acoustics.formation != "field":
        raise FactoryError("physics: acoustics.formation must be field")
    require(needs_of(config))
    frame, rendered = _first_frame(config)
    return [
        figures.save(_presets(words), out),
        figures.save(_effects(words, frame, rendered), out),
    ]


def _first_frame(config: FactoryConfig) -> tuple[Frame, Rendered]:
    from ..render import open_renderer
    from ..scenes import frames_of, open_reader
    from ..selection import choose_frames

    reader = open_reader(config.scenes)
    frame = reader.load(choose_frames(frames_of(reader), config)[0])
    return frame, open_renderer(config.render).render(frame, config.sonar.mount)


def _presets(words: list[str]) -> Figure:
    panels = []
    # Devices of one sector see the same frame.
    seen: dict[object, tuple[Frame, Rendered]] = {}
    for device in devices():
        config = compose_config([*words, f"sonar={device}"])
        if config.scenes not in seen:
            seen[config.scenes] = _first_frame(config)
        pair = _pair(config, *seen[config.scenes])
        echo = pair.clean.astype(np.float32) > 0
        columns, rows = echo.any(axis=0).nonzero()[0], echo.any(axis=1).nonzero()[0]
        part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        name = f"{device}   {config.sonar.frequency_khz:g} kHz"
        panels.append(figures.sonar(name, _square(pair.noisy[part])))
    return Figure(
        "presets",
        "The same procedural place through every device, acoustics=field",
        list(_rows(panels)),
    )


def _effects(words: list[str], frame: Frame, rendered: Rendered) -> Figure:
    """With a window from the sonar on, so that ring-down and comb lines have somewhere to be."""
    strong = [as_override(word) for word in _STRONG]
    pair = _pair(compose_config([*words, *strong]), frame, rendered)
    alone = [
        figures.sonar(name.replace("_", " "), pair.layers[f"layers/{name}"])
        for name in FIELD_EFFECTS
        if f"layers/{name}" in pair.layers
    ]
    usual = _pair(compose_config(words), frame, rendered)
    return Figure(
        "physical-effects",
        "experiment=physical: clean, noisy, and each effect alone, stronger than usual",
        list(
            _rows(
                [
                    figures.sonar("clean", usual.clean),
                    figures.sonar("noisy, as drawn for one sample", usual.noisy),
                    *alone,
                ]
            )
        ),
    )


def _pair(config: FactoryConfig, frame: Frame, rendered: Rendered) -> Pair:
    return make_pair(observe(frame, rendered, config), 0, config)


def _square(image: Picture) -> Picture:
    """Centred on black, as wide as high: panels of one size are easier to compare."""
    size = max(image.shape)
    square = np.zeros((size, size), image.dtype)
    top, left = (size - image.shape[0]) // 2, (size - image.shape[1]) // 2
    square[top : top + image.shape[0], left : left + image.shape[1]] = image
    return square


def _rows(panels: list[Panel]) -> Iterator[list[Panel]]:
    for first in range(0, len(panels), _ROW):
        yield panels[first : first + _ROW]
