"""`simnfnd make`: from a configuration to a finished dataset."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ... import __version__
from ...common.command_line import EXIT_BAD_INPUT
from ...common.errors import FactoryError
from ...common.extensions import refuse_main
from ...common.extras import require
from ...common.files import check_writable
from ...common.progress import RunReporter, stage_if_slow
from ...common.words import list_word, shell_line
from ...common.workers import template
from ...dataset.frame_ref import FrameRef
from ...dataset.quality import images_digest, lit_share, noisiness, seen_sector_deg
from ...dataset.schema import Provenance, config_hash
from ...dataset.storage import shown
from ...simulation.config.hydra_loader import config_folder_words
from ...simulation.config.identity import extensions_of, has_input_files, identity
from ...simulation.config.key_effects import refuse_keys_without_effect
from ...simulation.config.named_keys import named_keys
from ...simulation.config.needs import needs_of
from ...simulation.config.renderer_choice import renderer_of
from ...simulation.config.root import (
    FactoryConfig,
    composed_values,
    from_mapping,
    plain,
    with_cache,
)
from ...simulation.config.selection import (
    choose_frames,
    frames_digest,
    split_frames,
    split_warnings,
)
from ...simulation.labels.insonified import THIN_SHARE, thin_pairs
from ...simulation.pairs.compilation import compile_needed
from ...simulation.pairs.pair_maker import pair_maker
from ...simulation.pairs.views import Cache, ViewMaker
from ...simulation.scenes import open_reader
from ..scheduler.plan import DatasetJob, plan_shards, with_inputs, work_folder
from . import PRELOADED
from .costs import disk_warning

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from ..scheduler.results import RunReport

PRINTING = RunReporter()
# File in the folder of the cache.
_DIGESTS_NAME = "input-digests.json"
# Nobody wants images of which a smaller share is lit.
_LEAST_LIT = 0.01
_WHOLE_SECTOR_SHARE = 0.98
_REMEDY = (
    "check sonar.hfov_deg (degrees), sonar.range (metres) and, of your own recordings, "
    "scenes.intrinsics (pixels) and scenes.depth_scale"
)


def generate(composed: DictConfig) -> int:
    """Make the dataset that a composed configuration describes; returns the exit code.

    0: every frame became pairs.  1: some frames failed (listed in failed.jsonl), the rest is there.
    Raises FactoryError when nothing can be made.
    """
    from hydra.core.hydra_config import HydraConfig

    from .sweep import each_its_folder, in_sweep, note, reporter

    try:
        each_its_folder(composed)
        config = from_mapping(composed_values(composed))
        refuse_keys_without_effect(config, named_keys(HydraConfig.get().overrides.task))
        point_words = HydraConfig.get().overrides.task if in_sweep() else sys.argv[1:]
        words = [*config_folder_words(), *point_words]
        report, directory = run(config, words, reporter())
        code = 1 if report.failures else 0
    except FactoryError as error:
        note(state="failed", reason=" ".join(str(error).split()), exit_code=EXIT_BAD_INPUT)
        raise
    except KeyboardInterrupt as stopped:
        note(state="interrupted", exit_code=int(getattr(stopped, "exit_code", 130)))
        raise
    folder = shown(directory)
    if in_sweep() and config.shard.count == 1:
        figures = {name: round(value, 4) for name, value in noisiness(directory).items()}
        counts = {"pairs": report.samples, "failed": len(report.failures)}
        result = {"dataset": str(directory), "images": images_digest(directory)}
        note(state="made", **counts, **figures, exit_code=code, **result)
    print(f"dataset: {folder}")
    if report.failures:
        count, reason = _commonest(report)
        share = "all" if count == len(report.failures) else str(count)
        print(
            f"failed: {len(report.failures)} of {report.frames} frames, {share} because: {reason}; "
            f"`simnfnd status {shlex.quote(folder)} --failed` lists them"
        )
    return code


def _commonest(report: RunReport) -> tuple[int, str]:
    """How many frames failed for the commonest reason, and one of their reasons."""
    alike: dict[str, list[str]] = {}
    for failure in report.failures:
        reason = failure.reason.removeprefix(f"{failure.ref.name}: ")
        alike.setdefault(re.sub(r"[0-9.]+", "#", reason), []).append(reason)
    reasons = max(alike.values(), key=len)
    return len(reasons), reasons[0]


def run(
    config: FactoryConfig, arguments: Sequence[str], reporter: RunReporter = PRINTING
) -> tuple[RunReport, Path]:
    """Discover, plan and make one dataset.  `arguments` are the words that would make it again."""
    from ..scheduler.run import make_dataset

    require(needs_of(config))
    if config.scheduler.backend != "serial":
        for kind, name in extensions_of(config):
            refuse_main(kind, name)
    if config.cache.enabled and config.scenes.kind != "pack":
        check_writable(config.cache.folder, "cache.dir")
    if not (template.runs() and config.scheduler.backend == "local"):
        # Else the process that workers are forked from loads them, and the first worker compiles
        # what that does not find.
        coherent = config.acoustics.formation == "coherent"
        compile_needed(scenes=config.scenes.kind, field=coherent)
    job = job_of(config, arguments, reporter)
    if warning := disk_warning(config, job):
        reporter.warning(warning)
    report = make_dataset(job)
    if job.shard.part:
        reporter.fact(
            f"slice {job.shard.index} of {job.shard.count} is done; when all are, "
            "the same command without shard.index and shard.count completes the dataset"
        )
        return report, job.directory
    if not report.samples:
        count, reason = _commonest(report)
        # The remedy helps where no echo arrived, not where a file has to be repaired.
        hint = f"; {_REMEDY}" if "no echo" in reason else ""
        raise FactoryError(
            f"no frame could be used: {len(report.failures)} of {len(report.failures)} failed, "
            f"{count} of them because: {reason}{hint}"
        )
    narrowest, widest = seen_sector_deg(job.directory)
    if narrowest < _WHOLE_SECTOR_SHARE * config.sonar.hfov_deg:
        reporter.fact(
            f"sonar: the camera saw {narrowest:.0f} to {widest:.0f} of {config.sonar.hfov_deg:g} "
            "degrees; the rest is masked (azimuth_min_deg and azimuth_max_deg in /meta)"
        )
    # Again at the end: what was said first has scrolled away.
    for warning in job.warnings:
        reporter.warning(warning)
    if (share := lit_share(job.directory)) < _LEAST_LIT:
        reporter.warning(f"{100 * share:.2g} % of the images is lit; {_REMEDY}")
    return report, job.directory


def job_of(
    config: FactoryConfig, arguments: Sequence[str], reporter: RunReporter = PRINTING
) -> DatasetJob:
    """The frames that there are, planned as shards, and how they are made.

    Reports what there is and what the recordings lack.  Raises FactoryError when no frame is left.
    """
    looking = f"looking for the frames of scenes={config.scenes.kind}"
    with stage_if_slow(looking, tell=reporter.stage):
        discovery = open_reader(config.scenes).discover()
    for note in discovery.notes:
        reporter.fact(f"scenes: {note}")
    for reason, count in sorted(discovery.skipped.items()):
        reporter.fact(f"scenes: {count} skipped: {reason}")
    frames = choose_frames(discovery.frames, config)
    splits = split_frames(frames, config)
    plan_options = (config.frames.variants, config.scheduler.shard_size, config.dataset.limits)
    tasks = plan_shards(splits, *plan_options)
    if has_input_files(config):
        with stage_if_slow("comparing the frames' files", tell=reporter.stage):
            table_path = config.cache.folder / _DIGESTS_NAME if config.cache.enabled else None
            tasks = with_inputs(tasks, table_path)
    counts = [(split, sum(t.samples for t in tasks if t.split == split)) for split in splits]
    pairs = " and ".join(f"{count} {split}" for split, count in counts)
    scenes = len({(ref.location, ref.scene) for ref in frames})
    reporter.fact(f"frames: {len(frames)} of {scenes} scenes; pairs: {pairs}")
    render = renderer_of(config).text
    reporter.fact(f"render: {render}")
    warnings = split_warnings(splits, config)
    for warning in warnings:
        reporter.warning(warning)
    values = {**identity(config), "frames_found": frames_digest(frames)}
    directory = config.dataset.directory(config_hash(values), config.shard.part)
    working = with_cache(config, work_folder(directory, config.shard))
    return DatasetJob(
        directory=directory,
        tasks=tasks,
        source=pair_maker,
        preparer=None if config.scenes.kind == "pack" else ViewMaker,
        config=working,
        provenance=Provenance(values, config_hash(values), f"simnfnd {__version__}"),
        config_values=plain(config),
        dataset=config.dataset,
        scheduler=config.scheduler,
        shard=config.shard,
        rerun_command=lambda ref: _rerun_command(ref, arguments, directory),
        skipped=discovery.skipped,
        facts=lambda directory: _facts(directory, config, reporter),
        on_prepared=Cache(working.cache).note_growth,
        warnings=warnings,
        preload=PRELOADED,
        reporter=reporter,
    )


def _facts(directory: Path, config: FactoryConfig, reporter: RunReporter) -> list[str]:
    """What the card states of a finished dataset; what deserves attention is reported, too."""
    facts = [f"ideal echoes by {renderer_of(config).text}"]
    if config.devices is None:
        thin, total = thin_pairs(directory, config.sonar)
        if thin:
            counted = (
                f"less than {THIN_SHARE:.0%} of the sector is insonified in {thin} of {total} pairs"
            )
            facts.append(counted)
            reporter.warning(
                f"{counted}; frames.min_insonified={THIN_SHARE:g} refuses them (see "
                "sonar.tilt_deg, sonar.altitude_m, sonar.range)"
            )
    return facts


def _rerun_command(ref: FrameRef, arguments: Sequence[str], directory: Path) -> str:
    words = [
        word
        for word in arguments
        if not word.startswith(("dataset.dir=", "frames.only="))
        and word not in ("-m", "--multirun")
    ]
    one_frame = list_word("frames.only", [ref.name])
    # Commands for two frames make two datasets.
    folder = f"{shown(directory)}-retry/{ref.name.replace('/', '-')}"
    return shell_line(["simnfnd", "make", *words, one_frame, f"dataset.dir={folder}"])
