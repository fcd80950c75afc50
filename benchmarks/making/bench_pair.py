"""A frame to a finished pair: the paper's recipe to the letter against ours.

All start from the same decoded 968x608 frame (procedural, so that anyone can repeat it; with
--frame one of FLSea VI, too) and end with both pictures on disk, 512x512.  Ours are written as the
factory does: a gzip-1 shard with checksums.  Warm ones begin with the render in the cache, on disk;
a further variant with the echoes of its frame at hand.  Each row has a process of its own; imports,
compilation and Blender's start are paid before the clock runs, for all.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from benchmarks.report import Options, Section, Table
from benchmarks.shared import (
    PROVENANCE,
    Spent,
    clock,
    frame_words,
    in_own_process,
    quiet,
    write_pair,
)
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import FactoryConfig
from simnfnd.factory.scenes import open_reader
from simnfnd.factory.scheduler.workers.memory import keep_freed_memory

PICTURES = (
    *("sonar.beams=512", "sonar.range_bins=512"),
    *("sonar.image.width_px=512", "sonar.image.height_px=512"),
)
COLD = {
    "ours cold, Cycles": ["render=cycles"],
    "ours cold, Cycles, stride 1": ["render=cycles", "render.stride=1"],
    "ours cold, Cycles mesh, stride 1": [
        *("render=cycles", "render.stride=1", "render.geometry=mesh"),
    ],
    "ours cold, embree": ["render=embree"],
    "ours cold, analytic": ["render=analytic"],
}
LITERAL = "literal recipe"
# A shard is many pairs: its own cost (opening, table, two fsyncs) is spread over them.
PER_SHARD = 16


def measure(options: Options) -> Section:
    """A table for the procedural frame, and one for a real frame."""
    sources = {"procedural frame": ""}
    if options.frame:
        sources["FLSea VI frame"] = options.frame
    tables = [_table(title, root, options) for title, root in sources.items()]
    note = "" if options.frame else "Without --frame DIR (FLSea VI) no real frame was measured."
    return Section(tuple(tables), note)


def _table(title: str, root: str, options: Options) -> Table:
    words = [*frame_words(root), *PICTURES]
    ours, theirs = options.amount(7), options.amount(3)
    spent: dict[str, Spent] = {LITERAL: in_own_process(literal, words, theirs)}
    for label, render in COLD.items():
        spent[label] = in_own_process(cold, [*words, *render], ours)
    spent["ours warm, render in the cache"] = in_own_process(
        warm, words, ours, options.amount(PER_SHARD, 2)
    )
    spent["ours warm, physical profile"] = in_own_process(
        warm, [*words, "experiment=physical"], ours, options.amount(PER_SHARD, 2)
    )
    spent["ours, a further variant"] = in_own_process(
        further, words, ours, options.amount(PER_SHARD, 2)
    )
    rows = tuple(
        (
            label,
            spent[LITERAL].cpu / one.cpu,
            one.cpu,
            one.spread,
            one.wall,
            round(one.peak_mb),
        )
        for label, one in spent.items()
    )
    columns = ("pair", "times less CPU", "CPU s", "least to most", "wall s", "peak memory, MB")
    return Table(columns, rows, title, bars="times less CPU")


def literal(words: list[str], repeats: int) -> Spent:
    """The recipe of the paper."""
    from benchmarks.making.literal import LiteralRecipe

    frame = _frame(compose_config(words))
    with tempfile.TemporaryDirectory() as folder, quiet():
        recipe = LiteralRecipe(Path(folder))
        return clock(lambda: recipe.pair(frame), repeats)


def cold(words: list[str], repeats: int) -> Spent:
    """Render, pair, shard of one."""
    from simnfnd.factory import pairs
    from simnfnd.factory.pairs import pair_maker
    from simnfnd.factory.render import open_renderer

    keep_freed_memory()
    config = compose_config(words)
    frame, renderer, maker = _frame(config), open_renderer(config.render), pair_maker(config)
    axes, columns = maker.axes(), maker.columns()
    with tempfile.TemporaryDirectory() as folder:

        def one() -> None:
            rendered = renderer.render(frame, config.sonar.mount)
            scene = pairs.observe(frame, rendered, config)
            write_pair(pairs.make_pair(scene, 0, config), axes, columns, Path(folder))

        return clock(one, repeats)


def warm(words: list[str], repeats: int, count: int) -> Spent:
    """From the cached render: read and decode it, observe, make the pair, write it in a shard."""
    from simnfnd.factory.dataset.write.writer import write_shard
    from simnfnd.factory.pairs import pair_maker

    keep_freed_memory()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cached = [*words, "render=embree", f"cache.dir={folder / 'cache'}"]
        in_own_process(prepare, cached)
        config = compose_config(cached)
        ref = open_reader(config.scenes).discover().frames[0]

        def shard() -> None:
            # A source of its own each time: whatever it keeps of a frame, every frame is new to it.
            made = (pair_maker(config).pairs(ref, (number,))[0] for number in range(count))
            axes, columns = pair_maker(config).axes(), pair_maker(config).columns()
            write_shard(folder, "train/warm.h5", made, axes, columns, PROVENANCE, config.dataset)

        return clock(shard, repeats, count)


def prepare(words: list[str]) -> None:
    """Leave the frame's render in the cache, as a worker that renders does."""
    from simnfnd.factory.render.cache.views import ViewMaker

    config = compose_config(words)
    ViewMaker(config).prepare(open_reader(config.scenes).discover().frames[0])


def further(words: list[str], repeats: int, count: int) -> Spent:
    """Other noise on a frame whose echoes are at hand, written in a shard."""
    from simnfnd.factory import pairs
    from simnfnd.factory.dataset.write.writer import write_shard
    from simnfnd.factory.pairs import pair_maker
    from simnfnd.factory.render import open_renderer

    keep_freed_memory()
    config = compose_config([*words, "render=analytic"])
    frame, maker = _frame(config), pair_maker(config)
    axes, columns = maker.axes(), maker.columns()
    rendered = open_renderer(config.render).render(frame, config.sonar.mount)
    scene = pairs.observe(frame, rendered, config)
    with tempfile.TemporaryDirectory() as folder:

        def shard() -> None:
            made = (pairs.make_pair(scene, number, config) for number in range(count))
            write_shard(
                Path(folder), "train/more.h5", made, axes, columns, PROVENANCE, config.dataset
            )

        return clock(shard, repeats, count)


def _frame(config: FactoryConfig) -> Any:
    reader = open_reader(config.scenes)
    return reader.load(reader.discover().frames[0])
