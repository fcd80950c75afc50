"""What pairs of a configuration cost on this machine: measured once, and kept beside the renders.

Four frames are really made, in memory and in a temporary folder that is removed.
"""

from __future__ import annotations

import json
import platform
import shutil
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from ... import __version__
from ...common.errors import FactoryError, FrameError
from ...common.files import write_atomically
from ...common.workers.machine import keep_freed_memory
from ...dataset.frame_ref import FrameRef
from ...dataset.schema import Provenance, config_hash
from ...simulation.config.identity import identity
from ...simulation.config.root import FactoryConfig
from ..scheduler.plan import DatasetJob

GREY_IMAGES = ("noisy", "clean")
_FILE = "costs.json"
_PROBED_FRAMES = 4
# Parts of an identity that choose frames, and change none of them.
_CHOICE_OF_FRAMES = ("frames", "split", "shard", "scheduler", "seed")


class Range(NamedTuple):
    """The least and the most of some measured values."""

    least: float
    most: float


class Costs(NamedTuple):
    """What a render and a pair cost: seconds of one core, and bytes on disk.

    is_remembered: whether an earlier plan measured them.
    """

    render_s: Range
    pair_s: Range
    render_bytes: float
    pair_bytes: float
    is_remembered: bool = False

    def core_seconds(self, renders: int, pairs: int) -> Range:
        """Seconds of one core for so many renders and pairs."""
        return Range(
            renders * self.render_s.least + pairs * self.pair_s.least,
            renders * self.render_s.most + pairs * self.pair_s.most,
        )

    def disk_bytes(self, renders: int, pairs: int, cache_limit: int) -> float:
        """Bytes of the dataset and of the renders, the latter up to the limit."""
        return pairs * self.pair_bytes + min(renders * self.render_bytes, cache_limit)


def remembered_costs(config: FactoryConfig) -> Costs | None:
    """What an earlier plan measured of such pairs on this machine; None where there was none."""
    values = _read(config).get(_digest(config))
    if values is None:
        return None
    render_s, pair_s, render_bytes, pair_bytes = values
    return Costs(Range(*render_s), Range(*pair_s), render_bytes, pair_bytes, is_remembered=True)


def measured_costs(config: FactoryConfig, frames: Sequence[FrameRef]) -> Costs:
    """Measure what four frames cost, evenly spread over all, and remember it.

    The first, which has libraries to load, is not timed.
    Raises FactoryError when none of them can be made.
    """
    costs = _probe(config, frames)
    if config.cache.enabled:
        known = _read(config)
        known[_digest(config)] = list(costs[:4])
        with suppress(OSError, FactoryError):
            config.cache.folder.mkdir(parents=True, exist_ok=True)
            write_atomically(config.cache.folder / _FILE, json.dumps(known).encode())
    return costs


def free_bytes(directory: Path) -> int:
    """Free space where a folder will be made."""
    folder = directory.absolute()
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free


def disk_warning(config: FactoryConfig, job: DatasetJob) -> str | None:
    """Say that the shards that are still to be made will not fit on the disk; None where they will.

    Where no plan has measured such pairs, their images count as they are without compression.
    """
    missing = [task for task in job.own_tasks if not (job.directory / task.path).exists()]
    pairs = sum(task.samples for task in missing)
    costs = remembered_costs(config)
    if costs is None:
        image = config.sonar.image
        pixels = image.width_px * image.height_px
        if image.layout == "polar":
            pixels = config.sonar.beams * config.sonar.range_bins
        needed = pairs * pixels * np.dtype(config.dataset.dtype).itemsize * len(GREY_IMAGES)
        kind = "up to "
    else:
        frames = {ref for task in missing for ref, _ in task.items}
        renders = len(frames) if config.cache.enabled and config.scenes.kind != "pack" else 0
        needed = round(costs.disk_bytes(renders, pairs, config.cache.max_bytes))
        kind = ""
    free = free_bytes(job.directory)
    if needed <= free:
        return None
    return (
        f"disk: {pairs} pairs take {kind}{needed / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free; "
        "`simnfnd plan` with the same words measures it"
    )


def _read(config: FactoryConfig) -> dict[str, Any]:
    try:
        known = json.loads((config.cache.folder / _FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) else {}


def _digest(config: FactoryConfig) -> str:
    """Of all that decides what a pair costs."""
    values = {key: value for key, value in identity(config).items() if key not in _CHOICE_OF_FRAMES}
    return config_hash({**values, "version": __version__, "machine": platform.node()})


def _probe(config: FactoryConfig, frames: Sequence[FrameRef]) -> Costs:
    from ...dataset.writer import write_shard
    from ...simulation.pairs.pair_maker import pair_maker
    from ...simulation.pairs.views import ViewMaker

    keep_freed_memory()  # as the workers do, whose time is estimated
    count = min(_PROBED_FRAMES, len(frames))
    chosen = [frames[index * len(frames) // count] for index in range(count)]
    render_s = []
    pair_s = []
    pairs = []
    render_bytes = []
    problem = ""
    with tempfile.TemporaryDirectory() as folder:
        config = replace(config, cache=replace(config.cache, dir=folder))
        maker = None if config.scenes.kind == "pack" else ViewMaker(config)
        source = pair_maker(config)
        for ref in chosen:
            try:
                begun = time.perf_counter()
                size = maker.prepare(ref).bytes if maker else 0
                rendered = time.perf_counter()
                pairs += source.pairs(ref, (0,))
            except FrameError as error:
                problem = str(error)
                continue
            render_bytes.append(size)
            render_s.append(rendered - begun)
            pair_s.append(time.perf_counter() - rendered)
        if not pairs:
            raise FactoryError(f"plan: none of {count} frames could be made: {problem}")
        info = write_shard(
            Path(folder), "train/probe.h5", pairs, source.axes(), source.columns(),
            Provenance({}, "0" * 16, "plan"), config.dataset,
        )  # fmt: skip
    assert info is not None
    return Costs(
        _range(render_s[1:] or render_s),
        _range(pair_s[1:] or pair_s),
        fmean(render_bytes),
        info.bytes / len(pairs),
    )


def _range(values: Sequence[float]) -> Range:
    return Range(min(values), max(values))
