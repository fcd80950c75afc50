"""`simnfnd make`: from a configuration to a finished dataset."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..config import (
    FactoryConfig,
    FramesSettings,
    composed_values,
    digest,
    from_mapping,
    identity,
    plain,
    with_cache,
)
from ..dataset.quality import lit_share
from ..dataset.schema import Provenance
from ..errors import FactoryError
from ..frame import FrameRef
from ..pairs import pair_maker
from ..progress import stage_if_slow
from ..render.views import Limit, ViewMaker, check_views
from ..scheduler.workers import template
from ..selection import choose_frames, frames_digest, split_frames, split_warnings
from ..storage.copies import shown
from . import EXIT_BAD_INPUT, PRELOADED
from .extras import needs_of, require

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from ..scheduler.plan import Job
    from ..scheduler.results import RunReport

# So many procedural frames take minutes.
_MANY = 50
# Pictures of which less is lit are hardly meant.
_LEAST_LIT = 0.01
_LIKELIEST = (
    "check sonar.hfov_deg (degrees), sonar.range (metres) and, of your own recordings, "
    "scenes.intrinsics (pixels) and scenes.depth_scale"
)


def generate(composed: DictConfig) -> int:
    """Make the dataset that a composed configuration describes; returns the exit code.

    0: every frame became pairs.  1: some frames failed (listed in failed.jsonl), the rest is there.
    Raises FactoryError when nothing can be made.
    """
    from .sweep import each_its_folder, note_failure, note_result

    try:
        each_its_folder(composed)
        config = from_mapping(composed_values(composed))
        report, directory = run(config, arguments=sys.argv[1:])
        code = 1 if report.failures else 0
        if config.shard.count == 1:
            note_result(directory, report, code)
    except FactoryError as error:
        note_failure("failed", str(error), EXIT_BAD_INPUT)
        raise
    except KeyboardInterrupt as stopped:
        note_failure("interrupted", str(stopped), int(getattr(stopped, "exit_code", 130)))
        raise
    print(f"dataset: {shown(directory)}")
    if report.failures:
        print(_failed(report, shown(directory)))
    return code


def _failed(report: RunReport, directory: str) -> str:
    """How many frames failed, the commonest reason, and the command that lists them."""
    count, reason = commonest(report)
    share = "all" if count == len(report.failures) else str(count)
    return (
        f"failed: {len(report.failures)} of {report.frames} frames, {share} because: {reason}; "
        f"`simnfnd status {directory} --failed` lists them"
    )


def commonest(report: RunReport) -> tuple[int, str]:
    """How many frames failed for the commonest reason, and one of their reasons."""
    alike: dict[str, list[str]] = {}
    for failure in report.failures:
        reason = failure.reason.removeprefix(f"{failure.ref.name}: ")
        alike.setdefault(re.sub(r"[0-9.]+", "#", reason), []).append(reason)
    found = max(alike.values(), key=len)
    return len(found), found[0]


def run(config: FactoryConfig, arguments: list[str]) -> tuple[RunReport, Path]:
    """Discover, plan and make one dataset.  `arguments` are the words that would make it again."""
    from ..compiled import compile_needed
    from ..scheduler.run import make_dataset

    require(needs_of(config))
    check_views(config)
    forked = template.runs() and config.scheduler.backend == "local"
    if not forked:
        # Else the process that workers are forked from loads them, and the first worker compiles
        # what that does not find.
        compile_needed(
            scenes=config.scenes.kind,
            field=config.acoustics.formation == "field" or config.devices is not None,
        )
    job = job_of(config, arguments)
    report = make_dataset(job)
    if job.shard.part:
        print(
            f"slice {job.shard.index} of {job.shard.count} is done; when all are, "
            "the same command without shard.index and shard.count completes the dataset"
        )
        return report, job.directory
    if not report.samples:
        count, reason = commonest(report)
        raise FactoryError(
            f"no frame could be used: {len(report.failures)} of {len(report.failures)} failed, "
            f"{count} of them because: {reason}; {_LIKELIEST}"
        )
    # Again at the end: what was said first has scrolled away.
    say_warnings(job.warnings)
    if (share := lit_share(job.directory)) < _LEAST_LIT:
        say_warnings([f"{100 * share:.2g} % of the pictures is lit; {_LIKELIEST}"])
    return report, job.directory


def job_of(config: FactoryConfig, arguments: list[str]) -> Job:
    """The frames that there are, planned as shards, and how they are made.

    Prints what the recordings lack.  Raises FactoryError when no frame is left.
    """
    from .. import __version__
    from ..scenes import open_reader
    from ..scheduler.plan import Job, plan_shards, work_folder

    with stage_if_slow(f"looking for the frames of scenes={config.scenes.kind}"):
        discovery = open_reader(config.scenes).discover()
    for note in discovery.notes:
        print(f"scenes: {note}")
    for reason, count in sorted(discovery.skipped.items()):
        print(f"scenes: {count} skipped: {reason}")
    frames = choose_frames(discovery.frames, config)
    splits = split_frames(frames, config)
    print(_told(frames, splits, config), flush=True)
    warnings = split_warnings(splits, config)
    say_warnings(warnings)
    values = {**identity(config), "frames_found": frames_digest(frames)}
    config_hash = digest(values)
    directory = config.dataset.directory(config_hash, config.shard.part)
    how = (config.frames.variants, config.scheduler.shard_size, config.dataset.limits)
    working = with_cache(config, work_folder(directory, config.shard))
    return Job(
        directory,
        plan_shards(splits, *how),
        source=pair_maker,
        preparer=None if config.scenes.kind == "pack" else ViewMaker,
        config=working,
        provenance=Provenance(values, config_hash, f"simnfnd {__version__}"),
        config_values=plain(config),
        dataset=config.dataset,
        scheduler=config.scheduler,
        shard=config.shard,
        rerun_command=lambda ref: _rerun_command(ref, arguments, directory),
        skipped=discovery.skipped,
        on_prepared=Limit(working.cache),
        warnings=warnings,
        preload=PRELOADED,
    )


def _told(
    frames: Sequence[FrameRef], splits: Mapping[str, Sequence[FrameRef]], config: FactoryConfig
) -> str:
    """What is going to be made, before it is; and how to get less of what is made up anyway."""
    scenes = len({(ref.location, ref.scene) for ref in frames})
    limits = config.dataset.limits
    counts = []
    for split, refs in splits.items():
        pairs, limit = len(refs) * config.frames.variants, limits.get(split)
        counts.append(f"{pairs if limit is None else min(pairs, limit)} {split}")
    text = f"frames: {len(frames)} of {scenes} scenes; pairs: {' and '.join(counts)}"
    if config.scenes.kind == "seabed" and len(frames) > _MANY and config.frames == FramesSettings():
        text += " (frames.total=8 makes a small dataset in less than a minute)"
    return text


def say_warnings(warnings: Sequence[str]) -> None:
    """One line each on stderr."""
    for line in warnings:
        print(f"warning: {line}", file=sys.stderr, flush=True)


def _rerun_command(ref: FrameRef, arguments: list[str], directory: Path) -> str:
    words = [
        word
        for word in arguments
        if not word.startswith(("dataset.dir=", "frames.only="))
        and word not in ("-m", "--multirun")
    ]
    again = [*words, f"frames.only=[{ref.name}]", f"dataset.dir={shown(directory)}-retry"]
    return " ".join(["simnfnd make", *map(shlex.quote, again)])
