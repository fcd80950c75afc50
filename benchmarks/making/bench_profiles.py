"""What a warm pair of the physical profile costs beside one of the paper's, on the same frame.

One procedural 968x608 frame (with --frame the first of FLSea VI) whose render is in the cache, all
effects of either profile as they ship, pairs written to gzip-1 shards.  Both profiles take turns in
one process, so that what else the machine does changes the ratio least; two sizes of the pictures,
and two devices.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.making.bench_pair import PICTURES, prepare
from benchmarks.report import Options, Section, Table
from benchmarks.shared import PROVENANCE, frame_words, in_own_process
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.scenes import open_reader
from simnfnd.factory.scheduler.workers.memory import keep_freed_memory

DEVICES = {
    "512x512": PICTURES,
    "256x256": (),
    "aris_3000": ("sonar=aris_3000",),
    "oculus_m1200d_hf": ("sonar=oculus_m1200d_hf",),
}
TURNS, PER_SHARD = 9, 8


def measure(options: Options) -> Section:
    """A row a device."""
    rows = [_row(name, list(words), options) for name, words in DEVICES.items()]
    columns = ("pictures", "paper's, CPU ms", "physical, CPU ms", "times", "least to most")
    note = "Least CPU milliseconds a pair; medians and extremes of the ratios of turns."
    return Section((Table(columns, tuple(rows), note=note, bars="times"),))


def _row(name: str, words: list[str], options: Options) -> tuple[str, float, float, float, str]:
    turns, count = options.amount(TURNS), options.amount(PER_SHARD)
    paper, physical = in_own_process(
        in_turn, [*frame_words(options.frame), *words], ["experiment=physical"], turns, count
    )
    times = [other / one for one, other in zip(paper, physical, strict=True)]
    return (
        name,
        1000 * min(paper),
        1000 * min(physical),
        statistics.median(times),
        f"{min(times):.2f} to {max(times):.2f}",
    )


def in_turn(
    words: list[str], more: list[str], turns: int, count: int
) -> tuple[list[float], list[float]]:
    """CPU seconds a pair of each turn, with the words and with more of them."""
    keep_freed_memory()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = [
            _shard(
                folder, [*words, *added, "render=embree", f"cache.dir={folder / 'cache'}"], count
            )
            for added in ([], more)
        ]
        spent: tuple[list[float], list[float]] = ([], [])
        for turn in range(turns + 1):
            for shard, times in zip(made, spent, strict=True):
                began = time.process_time()
                shard()
                if turn:  # the first one loads
                    times.append((time.process_time() - began) / count)
        return spent


def _shard(folder: Path, words: list[str], count: int) -> Callable[[], None]:
    """A call that makes a shard of so many pairs of the first frame."""
    from simnfnd.factory.dataset.write.writer import write_shard
    from simnfnd.factory.pairs import pair_maker

    prepare(words)
    config = compose_config(words)
    ref = open_reader(config.scenes).discover().frames[0]

    def shard() -> None:
        # A source of its own for each pair: whatever it keeps of a frame, every frame is new to it.
        made = (pair_maker(config).pairs(ref, (number,))[0] for number in range(count))
        maker = pair_maker(config)
        axes, columns = maker.axes(), maker.columns()
        write_shard(folder, "train/pairs.h5", made, axes, columns, PROVENANCE, config.dataset)

    return shard
