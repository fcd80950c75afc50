"""What a further frame costs through `simnfnd make` itself: by the difference of two runs.

Each is the median of three.  Everything is in it that a user pays: finding and reading the frame,
the render and its cache entry, both images (512x512), the shard, the bars, and nothing that is
paid once a run.  With --frame frames of FLSea VI, too: copies of the first one there, of which one
depth differs by a thousandth, so that no render serves two.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from statistics import median

import numpy as np
from PIL import Image

from benchmarks.literal import LiteralRecipe
from benchmarks.shared import (
    Cell,
    Options,
    Section,
    Table,
    cpu_seconds,
    frame_words,
    in_own_process,
    quiet,
    run_command,
)
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.scenes import open_reader

# Single runs differ by a tenth of a second: by a tenth of what a further frame costs.
TURNS = 3
IMAGE_SETTINGS = (
    *("sonar.beams=512", "sonar.range_bins=512"),
    *("sonar.image.width_px=512", "sonar.image.height_px=512"),
)
RENDERERS = ("analytic", "embree", "cycles")
# One worker, for two would wait for each other's memory; a preview is paid once a run.
ONE = ("scheduler.workers=1", "dataset.preview_pairs=0")


def measure(options: Options) -> Section:
    """A table for procedural frames, and one for real ones."""
    few = options.amount(4, 1)
    many = options.amount(44, 2)
    tables = []
    with tempfile.TemporaryDirectory(prefix="command-") as name:
        folder = Path(name)
        places = ["scenes=seabed", "scenes.locations=1", f"scenes.frames_per_location={many}"]
        tables.append(_table("procedural frame", "", places, (few, many), folder, options))
        if options.frame:
            root = folder / "flsea"
            copies(Path(options.frame), root, many)
            words = [
                "scenes=flsea",
                f"scenes.root={root}",
                "split.test=[]",
                "split.test_fraction=0",
            ]
            title = "FLSea VI frame"
            tables.append(
                _table(title, options.frame, words, (few, many), folder / "read", options)
            )
    return Section(tables)


def _table(
    title: str, root: str, words: list[str], counts: tuple[int, int], folder: Path, options: Options
) -> Table:
    recipe = in_own_process(literal, [*frame_words(root), *IMAGE_SETTINGS], options.amount(3))
    rows: list[tuple[Cell, ...]] = [("literal recipe", 1.0, recipe, "")]
    # Not counted: the first run of a machine compiles the loops.
    run_command(
        "make", *words, *ONE, "render=analytic", "frames.limit=1",
        f"cache.dir={folder / 'no cache'}", f"dataset.dir={folder / 'no'}",
    )  # fmt: skip
    for renderer in RENDERERS:
        overrides = [*words, *IMAGE_SETTINGS, *ONE, f"render={renderer}"]
        for state in ("cold", "warm"):
            spent = []
            for count in counts:
                times = []
                for turn in range(options.amount(TURNS)):
                    turn_folder = folder / renderer / str(count) / str(turn)
                    # A warm run has the cache of the cold one before it.
                    places = [
                        f"cache.dir={turn_folder / 'cache'}",
                        f"dataset.dir={turn_folder / state}",
                    ]
                    times.append(
                        run_command("make", *overrides, f"frames.limit={count}", *places).cpu
                    )
                spent.append(median(times))
            less, more = spent
            few, many = counts
            frame = (more - less) / (many - few)
            rows.append((f"{renderer}, {state}", recipe / frame, frame, less - few * frame))
    columns = ("through the command", "times less CPU", "CPU s a further frame", "CPU s of a run")
    return Table(columns, tuple(rows), title)


def literal(words: list[str], repeats: int) -> float:
    """CPU seconds of the paper's recipe for one frame."""
    reader = open_reader(compose_config(words).scenes)
    frame = reader.load(reader.discover().frames[0])
    with tempfile.TemporaryDirectory() as folder, quiet():
        recipe = LiteralRecipe(Path(folder))
        return cpu_seconds(lambda: recipe.pair(frame), repeats)


def copies(source: Path, target: Path, count: int) -> None:
    """Write `count` different copies of the first FLSea VI frame at `source` to `target`."""
    frame = open_reader(compose_config(frame_words(str(source))).scenes).discover().frames[0]
    image, depth = map(Path, frame.paths)
    scene_folder = target / frame.location / frame.scene
    for name in ("imgs", "depth"):
        (scene_folder / name).mkdir(parents=True)
    with Image.open(depth) as opened:
        depth_m = np.array(opened)
    # A pixel with depth, far enough from the upper left corner to be part of the scene.
    row, column = np.argwhere(depth_m > 0)[len(depth_m)]
    for number in range(count):
        changed_m = depth_m.copy()
        changed_m[row, column] += 1e-3 * number
        stamp = str(int(frame.frame) + number)
        image_name = image.name.replace(frame.frame, stamp)
        depth_name = depth.name.replace(frame.frame, stamp)
        shutil.copy(image, scene_folder / "imgs" / image_name)
        depth_path = scene_folder / "depth" / depth_name
        Image.fromarray(changed_m).save(depth_path, compression="tiff_lzw")
