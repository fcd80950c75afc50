"""`simnfnd plan [-m] ...`: what a command would make, and what it would cost.

Nothing of the dataset, the cache or the sweep is written.
"""

from __future__ import annotations

from ...common.command_line import Parser
from ...common.extras import require
from ...common.progress import clock
from ...common.workers.machine import available_memory_bytes, usable_cores
from ...common.workers.settings import RENDERER_GB, WORKER_GB
from ...simulation.config.compose import compose_points
from ...simulation.config.needs import needs_of
from ..cli.costs import Costs, Range, free_bytes, measured_costs, remembered_costs

_LONG_S = 36_000


def main(words: list[str]) -> int:
    """Print the plan; returns 0, or 1 when disk or memory does not suffice."""
    parser = Parser(prog="simnfnd plan")
    parser.add_argument("-m", "--multirun", action="store_true", help="plan a sweep")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="as for `simnfnd make`")
    arguments = parser.parse_intermixed_args(words)

    from ...simulation.pairs.views import open_views
    from ..cli.generate import job_of

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
    costs = remembered_costs(config) or measured_costs(config, used)
    print(_costs_line(costs))

    cores = min(worker_counts.total, usable_cores())
    core_s = costs.core_seconds(renders, pairs)
    disk_gb = costs.disk_bytes(renders, pairs, config.cache.max_bytes) / 1e9
    free_gb = free_bytes(job.directory) / 1e9
    memory_gb = worker_counts.render * RENDERER_GB + worker_counts.noise * WORKER_GB
    available_gb = available_memory_bytes() / 1e9
    print(
        f"expected: {disk_gb:.2f} of {free_gb:.0f} GB of disk, {memory_gb:.1f} of "
        f"{available_gb:.1f} GB of memory, {_time_text(core_s, cores)}"
    )
    lacking = [("disk", disk_gb, free_gb), ("memory", memory_gb, available_gb)]
    short = [resource for resource, needed, available in lacking if needed > available]
    for resource in short:
        print(f"TOO LITTLE {resource}; set frames.total or scheduler.workers lower")
    return 1 if short else 0


def _costs_line(costs: Costs) -> str:
    source = "measured by an earlier plan" if costs.is_remembered else "probe"
    return (
        f"{source}: {_seconds_text(costs.render_s)} to render a frame, "
        f"{_seconds_text(costs.pair_s)} to make a pair; {costs.render_bytes / 1e3:.0f} kB per "
        f"render, {costs.pair_bytes / 1e3:.0f} kB per pair"
    )


def _seconds_text(seconds: Range) -> str:
    return f"{seconds.least:.2f} to {seconds.most:.2f} s"


def _time_text(core_s: Range, cores: int) -> str:
    """Such as `0:20 to 0:35 on 2 cores (0.01 to 0.02 core hours)`."""
    hours = [
        f"{seconds / 3600:,.0f}" if seconds >= _LONG_S else f"{seconds / 3600:.2g}"
        for seconds in core_s
    ]
    return (
        f"{clock(core_s.least / cores)} to {clock(core_s.most / cores)} on {cores} core(s) "
        f"({hours[0]} to {hours[1]} core hours)"
    )
