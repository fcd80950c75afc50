"""`simnfnd make`: from a configuration to a finished dataset."""

from __future__ import annotations

import fnmatch
import hashlib
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simnfnd.factory.config import FactoryConfig, digest, from_mapping, identity, plain
from simnfnd.factory.dataset.describe.quality import seen_sector_deg
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.extras import needs_of, require
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.pairs import pair_maker
from simnfnd.factory.render.cache import Limit
from simnfnd.factory.render.views import ViewMaker, check_views, with_cache

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from simnfnd.factory.jobs.job import Job
    from simnfnd.factory.jobs.ledger import RunReport


def generate(composed: DictConfig) -> int:
    """Make the dataset that a composed configuration describes; returns the exit code.

    0: every frame became pairs.  1: some frames failed (listed in failed.jsonl), the rest is there.
    Raises FactoryError when nothing can be made.
    """
    from simnfnd.factory.sweep import note_result

    config = from_mapping(composed_values(composed))
    report, directory = run(config, arguments=sys.argv[1:])
    code = 1 if report.failures else 0
    if config.shard.count == 1:
        note_result(directory, config, report, code)
    print(f"dataset: {directory}")
    return code


def run(config: FactoryConfig, arguments: list[str]) -> tuple[RunReport, Path]:
    """Discover, plan and make one dataset.  `arguments` are the words that would make it again."""
    from simnfnd.factory.compiled import compile_all
    from simnfnd.factory.jobs.run import make_dataset

    require(needs_of(config))
    check_views(config)
    compile_all()
    job = job_of(config, arguments)
    report = make_dataset(job)
    if job.shard.part:
        print(
            f"slice {job.shard.index} of {job.shard.count} is done; when all are, "
            "the same command without shard.index and shard.count completes the dataset"
        )
        return report, job.directory
    if not report.samples:
        first = report.failures[0].reason
        raise FactoryError(
            f"no frame could be used: {len(report.failures)} of {len(report.failures)} failed, "
            f"the first because: {first}"
        )
    _report_sector(job.directory, config)
    return report, job.directory


def job_of(config: FactoryConfig, arguments: list[str]) -> Job:
    """The frames that there are, planned as shards, and how they are made.

    Prints what the recordings lack.  Raises FactoryError when no frame is left.
    """
    from simnfnd.factory import __version__
    from simnfnd.factory.jobs.extend import plan_extension
    from simnfnd.factory.jobs.job import Job, work_folder
    from simnfnd.factory.jobs.plan import plan_shards
    from simnfnd.factory.scenes import open_reader

    discovery = open_reader(config.scenes).discover()
    for note in discovery.notes:
        print(f"scenes: {note}")
    for reason, count in sorted(discovery.skipped.items()):
        print(f"scenes: {count} skipped: {reason}")
    frames = choose_frames(discovery.frames, config)
    splits = split_frames(frames, config)
    values = {**identity(config), "frames_found": frames_digest(frames)}
    config_hash = digest(values)
    directory = config.dataset.directory(config_hash)
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
        extension=lambda earlier: plan_extension(splits, *how, earlier),
    )


def _report_sector(directory: Path, config: FactoryConfig) -> None:
    """Tell the user when the camera saw less than the sonar's sector."""
    narrowest, widest = seen_sector_deg(directory)
    if narrowest < 0.98 * config.sonar.hfov_deg:
        print(
            f"sonar: the camera saw {narrowest:.0f} to {widest:.0f} of {config.sonar.hfov_deg:g} "
            "degrees; the rest is masked (azimuth_min_deg and azimuth_max_deg in /meta)"
        )


def choose_frames(found: tuple[FrameRef, ...], config: FactoryConfig) -> tuple[FrameRef, ...]:
    """The frames that stride, limit and `only` leave, in order.

    Raises FactoryError when none is left or a name in `frames.only` is unknown.
    """
    settings = config.frames
    by_scene: dict[tuple[str, str], list[FrameRef]] = {}
    for ref in found:
        by_scene.setdefault((ref.location, ref.scene), []).append(ref)
    chosen = [
        ref for refs in by_scene.values() for ref in refs[:: settings.stride][: settings.limit]
    ]
    if settings.only is not None:
        unknown = set(settings.only) - {ref.name for ref in found}
        if unknown:
            raise FactoryError(f"frames.only: no frame named {sorted(unknown)[0]}")
        chosen = [ref for ref in found if ref.name in settings.only]
    if not chosen:
        raise FactoryError(
            "frames: no frame is left; check frames.stride, frames.limit, frames.only"
        )
    return tuple(chosen)


def split_frames(
    frames: tuple[FrameRef, ...], config: FactoryConfig
) -> dict[str, tuple[FrameRef, ...]]:
    """Train and test frames; a scene is in one of them, never in both.

    Raises FactoryError when a name in split.test matches no scene of a whole data set.
    """
    scenes = sorted({(ref.location, ref.scene) for ref in frames})
    if config.split.test:
        testing = {
            scene
            for scene in scenes
            if any(
                fnmatch.fnmatch(name, pattern)
                for pattern in config.split.test
                for name in (scene[1], "/".join(scene))
            )
        }
    else:
        # By a hash of the name: a scene that is added later moves few others, and no order matters.
        ranked = sorted(
            scenes, key=lambda scene: hashlib.blake2b("/".join(scene).encode()).digest()
        )
        count = round(config.split.test_fraction * len(scenes))
        if config.split.test_fraction > 0 and len(scenes) > 1:
            count = max(count, 1)
        testing = set(ranked[:count])
    return {
        "train": tuple(ref for ref in frames if (ref.location, ref.scene) not in testing),
        "test": tuple(ref for ref in frames if (ref.location, ref.scene) in testing),
    }


def frames_digest(frames: tuple[FrameRef, ...]) -> str:
    """Hash of the names of the frames: a download that has grown makes another dataset."""
    names = "\n".join(ref.name for ref in frames)
    return hashlib.blake2b(names.encode(), digest_size=8).hexdigest()


def composed_values(composed: DictConfig) -> dict[str, Any]:
    """The plain values of a composed configuration.  Raises FactoryError when one is missing."""
    from omegaconf import OmegaConf
    from omegaconf.errors import MissingMandatoryValue

    try:
        values = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    except MissingMandatoryValue as error:
        key = error.full_key
        raise FactoryError(f"{key}: a value is required; give {key}=...") from error
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items() if key != "experiment"}


def _rerun_command(ref: FrameRef, arguments: list[str], directory: Path) -> str:
    words = [
        word
        for word in arguments
        if not word.startswith(("dataset.dir=", "dataset.on_existing=", "frames.only="))
        and word not in ("-m", "--multirun")
    ]
    again = [*words, f"frames.only=[{ref.name}]", f"dataset.dir={directory}-retry"]
    return " ".join(["simnfnd make", *map(shlex.quote, again)])
