"""A frame to a finished pair: the paper's recipe to the letter against ours, in one process.

Both start from the same decoded 968x608 frame (procedural, so anyone can repeat it) and end with
both pictures on disk, 512x512.  CPU seconds of all threads, medians; ratios first.  Imports and
Blender's start are paid before the clock runs, for both.
"""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.literal import LiteralRecipe
from benchmarks.shared import cpu_seconds, write_pair
from factory import pairs
from factory.commands.compose import compose_config
from factory.config import FactoryConfig
from factory.frame import Frame
from factory.render import RenderSettings, open_renderer
from factory.scenes import open_reader

LITERAL_REPEATS, OUR_REPEATS = 3, 7
OURS = {
    "cold, Cycles mesh": RenderSettings(kind="cycles"),
    "cold, Cycles points": RenderSettings(kind="cycles", geometry="points"),
    "cold, embree": RenderSettings(kind="embree"),
    "cold, analytic": RenderSettings(kind="analytic"),
}


def main() -> None:
    """Print the table."""
    config = compose_config(
        [
            "scenes.locations=1",
            "sonar.beams=512",
            "sonar.range_bins=512",
            "sonar.image.width_px=512",
            "sonar.image.height_px=512",
        ]
    )
    reader = open_reader(config.scenes)
    frame = reader.load(reader.discover().frames[0])
    rows: list[tuple[str, float]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for label, settings in OURS.items():
            renderer = open_renderer(settings)

            def cold(renderer: Any = renderer) -> None:
                rendered = renderer.render(frame, config.sonar.mount)
                scene = pairs.observe(frame, rendered, config.sonar)
                write_pair(pairs.make_pair(scene, 0, config), folder)

            rows.append((label, cpu_seconds(cold, OUR_REPEATS)))
        rows += warm_rows(frame, renderer.render(frame, config.sonar.mount), config, folder)
        recipe = LiteralRecipe(folder)
        with quiet():
            literal = cpu_seconds(lambda: recipe.pair(frame), LITERAL_REPEATS)
    print("| pair | times less CPU than the literal recipe | CPU s |")
    print("|---|---:|---:|")
    print(f"| literal recipe | 1 | {literal:.2f} |")
    for label, spent in rows:
        print(f"| ours, {label} | {literal / spent:.0f} | {spent:.3f} |")


def warm_rows(
    frame: Frame, rendered: Any, config: FactoryConfig, folder: Path
) -> list[tuple[str, float]]:
    """Pairs of a render that is at hand, and of echoes that are (further variants of a frame)."""
    scene = pairs.observe(frame, rendered, config.sonar)

    def from_render() -> None:
        again = pairs.observe(frame, rendered, config.sonar)
        write_pair(pairs.make_pair(again, 0, config), folder)

    return [
        ("warm, from the render", cpu_seconds(from_render, OUR_REPEATS)),
        (
            "warm, a further variant",
            cpu_seconds(lambda: write_pair(pairs.make_pair(scene, 0, config), folder), OUR_REPEATS),
        ),
    ]


@contextmanager
def quiet() -> Any:
    """Blender tells of every render on the C level; the report is on stdout."""
    sys.stdout.flush()
    keep = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(keep, 1)
        os.close(keep)


if __name__ == "__main__":
    main()
