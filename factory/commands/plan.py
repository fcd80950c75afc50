"""`simnfnd plan [-m] ...`: what a command would make, and what it would cost.

Four frames are really made, in memory and in a folder of the system's temporary files that goes
again; nothing of the dataset, the cache or the sweep is written.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING

from ..cli import Parser
from ..cli.compose import compose_points
from ..cli.extras import needs_of, require
from ..cli.generate import say_warnings
from ..errors import FactoryError, FrameError
from ..frame import FrameRef
from ..progress import clock
from ..scheduler.plan import ShardTask, plan_shards
from ..scheduler.settings import RENDERER_GB, WORKER_GB
from ..scheduler.workers.machine import available_memory_bytes, usable_cores

if TYPE_CHECKING:
    from ..config import FactoryConfig

_PROBED = 4


@dataclass(frozen=True)
class Cost:
    """Of one frame: seconds to render and to add noise (one pair), bytes of render and pair."""

    render_s: float
    pair_s: float
    render_bytes: float
    pair_bytes: float


def main(words: list[str]) -> int:
    """Print the plan; returns 0, or 1 when disk or memory will not do."""
    parser = Parser(prog="simnfnd plan")
    parser.add_argument("-m", "--multirun", action="store_true", help="plan a sweep")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="as for `simnfnd make`")
    given = parser.parse_intermixed_args(words)
    points = compose_points([*(["-m"] if given.multirun else []), *given.settings])
    config = points[0][1]
    frames, tasks = _planned(config)
    shards = {split: [t for t in tasks if t.split == split] for split in ("train", "test")}
    scenes = len({(ref.location, ref.scene) for ref in frames})
    pairs = sum(task.samples for task in tasks)
    if len(points) > 1:
        print(
            f"sweep: {len(points)} points, {' ... '.join(' '.join(points[k][0]) for k in (0, -1))}"
        )
    print(f"frames: {len(frames)} of {scenes} scenes, {config.frames.variants} pairs each")
    for split, own in shards.items():
        print(f"{split}: {sum(t.samples for t in own)} pairs in {len(own)} shards")
    used = tuple(dict.fromkeys(ref for task in tasks for ref, _ in task.items))
    kept = _kept(config, used)
    if not tasks:
        print("nothing is to be made")
        return 0
    crew = config.scheduler.crew(len(tasks), len(used) if config.scenes.kind != "pack" else 0)
    print(f"workers: {crew.render} that render and {crew.noise} that only add noise")
    cost = probe(config, used)
    print(
        f"probe: {cost.render_s:.2f} s to render a frame, {cost.pair_s:.2f} s a pair; "
        f"{cost.render_bytes / 1e3:.0f} kB a render, {cost.pair_bytes / 1e3:.0f} kB a pair"
    )
    renders = len(used) - kept
    disk = len(points) * pairs * cost.pair_bytes + renders * cost.render_bytes
    parallel = min(crew.total, usable_cores())
    seconds = renders * cost.render_s / min(max(crew.render, 1), usable_cores())
    seconds += len(points) * pairs * cost.pair_s / parallel
    print(f"renders: {kept} of {len(used)} are in the cache, shared by all points")
    print(f"expected: {_megabytes(disk)} of disk, {clock(seconds)}")
    return 0 if _fits(config, disk, crew.render, crew.noise) else 1


def _planned(config: FactoryConfig) -> tuple[tuple[FrameRef, ...], tuple[ShardTask, ...]]:
    from ..render.views import check_views
    from ..scenes import open_reader
    from ..selection import choose_frames, split_frames, split_warnings

    require(needs_of(config))
    check_views(config, touch=False)
    frames = choose_frames(open_reader(config.scenes).discover().frames, config)
    splits = split_frames(frames, config)
    say_warnings(split_warnings(splits, config))
    how = (config.frames.variants, config.scheduler.shard_size, config.dataset.limits)
    return frames, plan_shards(splits, *how)[config.shard.index :: config.shard.count]


def probe(config: FactoryConfig, frames: Sequence[FrameRef]) -> Cost:
    """Make four frames from all over the list, and see.

    The first, which has Blender to load, is not counted.
    Raises FactoryError when none of them can be made.
    """
    from ..config import with_cache
    from ..dataset.schema import Provenance
    from ..dataset.writer import write_shard
    from ..pairs import pair_maker
    from ..render.views import ViewMaker
    from ..scheduler.workers.machine import keep_freed_memory

    keep_freed_memory()  # as the workers do whose time is to be foretold
    chosen = [frames[k * len(frames) // _PROBED] for k in range(min(_PROBED, len(frames)))]
    with tempfile.TemporaryDirectory() as folder:
        config = with_cache(
            replace(config, cache=replace(config.cache, enabled=False)), Path(folder)
        )
        packed = config.scenes.kind == "pack"
        maker, pairs = None if packed else ViewMaker(config), pair_maker(config)
        render_s, pair_s, made, sizes, problem = [], [], [], [], ""
        for ref in chosen:
            try:
                begun = time.perf_counter()
                sizes.append(0 if maker is None else maker.prepare(ref).bytes)
                rendered = time.perf_counter()
                made += pairs.pairs(ref, (0,))
            except FrameError as error:
                problem = str(error)
                continue
            render_s.append(rendered - begun)
            pair_s.append(time.perf_counter() - rendered)
        if not made:
            raise FactoryError(f"plan: none of {len(chosen)} frames could be made: {problem}")
        provenance = Provenance({}, "0" * 16, "plan")
        axes, columns = pairs.axes(), pairs.columns()
        info = write_shard(
            Path(folder), "train/probe.h5", made, axes, columns, provenance, config.dataset
        )
        assert info is not None
    counted = slice(1, None) if len(made) > 1 else slice(None)
    return Cost(
        fmean(render_s[counted]), fmean(pair_s[counted]), fmean(sizes), info.bytes / len(made)
    )


def _kept(config: FactoryConfig, frames: Sequence[FrameRef]) -> int:
    """Frames whose render is at hand."""
    from ..render.views import open_views

    if not config.cache.enabled and config.scenes.kind != "pack":
        return 0
    views = open_views(config)
    return sum(views.holds(ref) for ref in frames)


def _fits(config: FactoryConfig, disk: float, render: int, noise: int) -> bool:
    folder = config.dataset.directory("0" * 16)
    while not folder.exists():
        folder = folder.absolute().parent
    free = shutil.disk_usage(folder).free
    memory = render * RENDERER_GB + noise * WORKER_GB
    available = available_memory_bytes() / 1e9
    good = disk < free and memory < available
    print(f"disk: {_megabytes(free)} free{'' if disk < free else ', TOO LITTLE'}")
    print(
        f"memory: about {memory:.1f} GB of {available:.1f} GB"
        f"{'' if memory < available else ', TOO LITTLE; set scheduler.workers lower'}"
    )
    return good


def _megabytes(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"
