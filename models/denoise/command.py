"""Denoise images, folders, HDF5 shards, videos, recordings and bags with trained weights."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Iterator, Sequence
from functools import cache, partial
from pathlib import Path

from ...factory import __version__
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, real_path, remove_stale_temporaries, sha256_of
from ...factory.common.progress import Bar
from ...factory.common.workers.machine import keep_freed_memory
from ..pretrained import POINTS
from ..recordings.inputs import (
    Geometries,
    InputFile,
    find_items,
    said_of_sequences,
    sequences,
)
from .blocks import FOLDER as UNFINISHED
from .comparison_video import comparison_video
from .denoiser import Denoiser
from .files import denoise_files
from .images import LevelRange
from .job import DenoisingJob
from .journal import opened_journal
from .options import SHEETS
from .reports import (
    FRAME_COLUMNS,
    TABLE,
    line_of,
    said_of_maps,
    write_rows,
    write_table,
)
from .sequences import Means, RunOptions

_MOST_LINES = 20  # of files; the table has them all


def run(options: argparse.Namespace) -> int:
    """Denoise what `options` names; 1 when some files were skipped."""
    keep_freed_memory()  # every image needs the same planes again
    out = Path(options.out).expanduser()
    inputs = [Path(name).expanduser() for name in options.inputs]
    with_sheets = options.compare == SHEETS
    video = Path(options.compare).expanduser() if options.compare and not with_sheets else None
    items = find_items(inputs, out, compare=with_sheets)
    _check_video(video, items, out)
    geometries = Geometries(options.geometry, options.opening)
    check_writable(out, "--out")

    load = cache(partial(Denoiser, device=options.device))
    denoise = load(options.weights)
    chosen = RunOptions(
        weights=options.weights,
        device=options.device,
        frames=options.frames,
        causal=options.causal,
        strength=options.strength,
        inverts=options.invert,
        levels=LevelRange(*options.levels) if options.levels else None,
        geometry=options.geometry,
        opening_deg=options.opening,
        topics=tuple(options.topic),
    )
    means = Means(chosen.denoising(denoise), geometries)
    with (
        opened_journal(out, _command(options, denoise)) as journal,
        comparison_video(video) as job_video,
    ):
        # The video to compare by has all images of the run.
        is_anew = options.again or video is not None
        if is_anew:
            journal.begin_anew()
            shutil.rmtree(out / UNFINISHED, ignore_errors=True)
        job = DenoisingJob(
            out=out,
            options=chosen,
            denoise=denoise,
            points=partial(load, options.weights or POINTS),
            means=means,
            journal=journal,
            workers=options.workers,
            compare=with_sheets,
            video=job_video,
        )
        if options.frames > 1:
            for line in said_of_sequences(items):
                print(line)
        _denoise_all(items, job)
        if options.table:
            table = Path(options.table).expanduser()
            write_rows(table, FRAME_COLUMNS, job.frame_rows, key="--table")

    for line in _summary(job, options):
        print(line)
    if video is not None:
        print(f"compared: {video}")
    return 1 if job.failures else 0


def _command(options: argparse.Namespace, denoise: Denoiser) -> dict[str, object]:
    """All that decides on the bytes of results but for the inputs."""
    names = (
        "noise",
        "strength",
        "frames",
        "invert",
        "causal",
        "topic",
        "device",
        "opening",
        "levels",
    )
    chosen: dict[str, object] = {name: getattr(options, name) for name in names}
    table = Path(options.geometry).expanduser()
    chosen["geometry"] = sha256_of(table) if table.is_file() else options.geometry
    chosen["sheets"] = bool(options.compare)
    chosen["weights"] = denoise.digest
    chosen["version"] = __version__
    return chosen


def _summary(job: DenoisingJob, options: argparse.Namespace) -> Iterator[str]:
    """What a run found and did, line by line."""
    yield from _lines_of_files(job)
    yield from job.means.geometries.summary()
    for name, found, count in job.fans:
        if note := job.means.geometries.note(name, found, count):
            yield note
    yield from said_of_maps(job.maps)
    yield from job.in_time.summary(job.window)
    yield from job.notes
    yield from job.removed.summary()
    if options.strength > 0:
        yield from job.unchanged.summary()
    if not options.invert:
        yield from job.inverted.summary()
    names = ", ".join(f"{name} ({count} file(s))" for name, count in job.used.items())
    yield f"weights: {names or job.denoise.name}"
    yield f"denoised: {job.used.total()} file(s) in {job.out}"
    yield f"table: {job.out / TABLE}"


def _lines_of_files(job: DenoisingJob) -> Iterator[str]:
    """A line for each recording, and for each sequence of images."""
    for row in job.rows[:_MOST_LINES]:
        yield line_of(row, job.window)
    if len(job.rows) > _MOST_LINES:
        yield f"{len(job.rows) - _MOST_LINES} more files: see {TABLE}"


def _check_video(video: Path | None, items: Sequence[InputFile], out: Path) -> None:
    """FactoryError for a video to compare by that would replace an input or a result."""
    if video is None:
        return
    others = [item.source for item in items] + [out / item.relative for item in items]
    if real_path(video) in {real_path(path) for path in others}:
        raise FactoryError(f"--compare {video}: is an input or a result; give another name")


def _denoise_all(items: Sequence[InputFile], job: DenoisingJob) -> None:
    """Denoise all files under a progress bar.  FactoryError when none could be."""
    runs = sequences(items)
    job.journal.begin(runs, in_time=job.window > 1)
    finished = sum(item in job.journal for item in items)
    if finished:
        print(
            f"already denoised: {finished} file(s), which have not changed since; --again denoises "
            "them, too"
        )
    images = sum(item.kind == "images" and item not in job.journal for item in items)
    for folder in {(job.out / name).parent for item in items for name in item.results()}:
        remove_stale_temporaries(folder)
    try:
        with Bar(total=images, unit="image", desc="denoising") as job.bar:
            job.bar.uncounted = sum(
                item.kind not in ("images", "shard") and item not in job.journal for item in items
            )
            for sequence in runs:
                denoise_files(sequence, job)
    except KeyboardInterrupt:
        print(
            f"denoised: {job.used.total()} file(s) in {job.out} before it was stopped; the same "
            "command goes on with the others",
            file=sys.stderr,
        )
        raise
    job.journal.finish()
    write_table(job.out, job.journal.rows())
    if job.failures and len(job.failures) == len(items):
        more = f" (and {len(job.failures) - 1} more)" if len(job.failures) > 1 else ""
        raise FactoryError(job.failures[0] + more)
    for word, lines in (("skipped", job.failures), ("warning", job.warnings)):
        for line in lines:
            print(f"{word}: {line}", file=sys.stderr)
