"""`simnfnd plan [-m] ...`: what a command would make, and what it would cost.

Four frames are really made, in memory and in a temporary folder that is removed; nothing of the
dataset, the cache or the sweep is written.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, NamedTuple

from ...common.command_line import Parser
from ...common.errors import FactoryError, FrameError
from ...common.extras import require
from ...common.progress import clock
from ...common.workers.machine import available_memory_bytes, keep_freed_memory, usable_cores
from ...common.workers.settings import RENDERER_GB, WORKER_GB
from ...dataset.frame_ref import FrameRef
from ...simulation.config.compose import compose_points
from ...simulation.config.needs import needs_of

if TYPE_CHECKING:
    from ...simulation.config.root import FactoryConfig

_PROBED = 4


def main(words: list[str]) -> int:
    """Print the plan; returns 0, or 1 when disk or memory does not suffice."""
    from ...simulation.pairs.views import open_views
    from ..cli.generate import job_of

    parser = Parser(prog="simnfnd plan")
    parser.add_argument("-m", "--multirun", action="store_true", help="plan a sweep")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="as for `simnfnd make`")
    arguments = parser.parse_intermixed_args(words)
    points = compose_points([*(["-m"] if arguments.multirun else []), *arguments.settings])
    config = points[0]
    require(needs_of(config))
    if len(points) > 1:
        print(f"sweep: {len(points)} points, of which this is the first")
    job = job_of(config, ())
    for split in ("train", "test"):
        own = [task for task in job.own_tasks if task.split == split]
        print(f"{split}: {sum(task.samples for task in own)} pairs in {len(own)} shards")
    pairs = len(points) * sum(task.samples for task in job.own_tasks)
    used = tuple(dict.fromkeys(ref for task in job.own_tasks for ref, _ in task.items))
    if not used:
        print("nothing is to be made")
        return 0
    packed = config.scenes.kind == "pack"
    views = open_views(job.config)
    renders = 0 if packed else sum(not views.holds(ref) for ref in used)
    print(f"renders: {len(used) - renders} of {len(used)} are in the cache, shared by all points")
    worker_counts = config.scheduler.worker_counts(len(job.own_tasks), 0 if packed else len(used))
    print(
        f"workers: {worker_counts.render} that render and {worker_counts.noise} that only add noise"
    )
    cost = _probe(config, used)
    print(
        f"probe: {cost.render_s:.2f} s to render a frame, {cost.pair_s:.2f} s to make a pair; "
        f"{cost.render_bytes / 1e3:.0f} kB per render, {cost.pair_bytes / 1e3:.0f} kB per pair"
    )
    seconds = renders * cost.render_s / min(max(worker_counts.render, 1), usable_cores())
    seconds += pairs * cost.pair_s / min(worker_counts.total, usable_cores())
    disk_gb = (pairs * cost.pair_bytes + renders * cost.render_bytes) / 1e9
    free_gb = _free_gb(job.directory)
    memory_gb = worker_counts.render * RENDERER_GB + worker_counts.noise * WORKER_GB
    available_gb = available_memory_bytes() / 1e9
    print(
        f"expected: {disk_gb:.2f} of {free_gb:.0f} GB of disk, {memory_gb:.1f} of "
        f"{available_gb:.1f} GB of memory, {clock(seconds)}"
    )
    lacking = [("disk", disk_gb, free_gb), ("memory", memory_gb, available_gb)]
    short = [resource for resource, needed, available in lacking if needed > available]
    for resource in short:
        print(f"TOO LITTLE {resource}; set frames.total or scheduler.workers lower")
    return 1 if short else 0


def _free_gb(directory: Path) -> float:
    """Free space where a folder will be made."""
    folder = directory.absolute()
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free / 1e9


class _Cost(NamedTuple):
    """Mean cost of a render and of a pair: seconds of one worker, and bytes on disk."""

    render_s: float
    pair_s: float
    render_bytes: float
    pair_bytes: float


def _probe(config: FactoryConfig, frames: Sequence[FrameRef]) -> _Cost:
    """Make pairs of four frames, evenly spread over all, and measure what they cost.

    The first, which has Blender to load, is not timed.
    Raises FactoryError when none of them can be made.
    """
    from ...dataset.schema import Provenance
    from ...dataset.writer import write_shard
    from ...simulation.pairs.pair_maker import pair_maker
    from ...simulation.pairs.views import ViewMaker

    keep_freed_memory()  # as the workers do, whose time is estimated
    chosen = [frames[k * len(frames) // _PROBED] for k in range(min(_PROBED, len(frames)))]
    times = []
    pairs = []
    sizes = []
    problem = ""
    with tempfile.TemporaryDirectory() as folder:
        config = replace(config, cache=replace(config.cache, dir=folder))
        maker = None if config.scenes.kind == "pack" else ViewMaker(config)
        source = pair_maker(config)
        for ref in chosen:
            try:
                begun = time.perf_counter()
                sizes.append(maker.prepare(ref).bytes if maker else 0)
                rendered = time.perf_counter()
                pairs += source.pairs(ref, (0,))
            except FrameError as error:
                problem = str(error)
                continue
            times.append((rendered - begun, time.perf_counter() - rendered))
        if not pairs:
            raise FactoryError(f"plan: none of {len(chosen)} frames could be made: {problem}")
        info = write_shard(
            Path(folder), "train/probe.h5", pairs, source.axes(), source.columns(),
            Provenance({}, "0" * 16, "plan"), config.dataset,
        )  # fmt: skip
    assert info is not None
    render_s, pair_s = map(fmean, zip(*(times[1:] or times), strict=True))
    return _Cost(render_s, pair_s, fmean(sizes), info.bytes / len(pairs))
