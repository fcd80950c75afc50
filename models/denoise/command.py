"""Denoise images, folders, HDF5 shards, videos, recordings and bags with trained weights."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from functools import cache, partial
from pathlib import Path

from ...factory import __version__
from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, real_path, remove_stale_temporaries, sha256_of
from ...factory.common.progress import progress_bar
from ...factory.common.workers.machine import keep_freed_memory
from ..pretrained import DEFAULT as DEFAULT_WEIGHTS
from ..pretrained import POINTS
from ..recordings.inputs import (
    FIND,
    Geometries,
    InputFile,
    find_items,
    said_of_sequences,
    sequences,
)
from .comparison_video import SUFFIX, comparison_video
from .denoiser import Denoiser
from .files import denoise_files
from .images import Denoising, LevelRange
from .job import DenoisingJob
from .journal import opened_journal
from .reports import TABLE, line_of, write_table
from .temporal.stream import FRAMES

SHEETS = "sheets"
_MOST_LINES = 20  # of files; the table has them all
_WHICH = f"""\
weights that ship:
  {DEFAULT_WEIGHTS:16}  real sonars: single frames and recordings (default)
  {POINTS:16}  the paper's points: datasets say so, other files need --noise points
your own sonar: `simnfnd adapt RECORDING --out own.safetensors`, then --weights own.safetensors
"""
_COMPARE = (
    "also write sheets: noisy, denoised, and removed in standard deviations of the grain; with a "
    "file name, one video of noisy and denoised side by side instead"
)


def main(arguments: Sequence[str]) -> int:
    """`simnfnd denoise IN... --out DIR`; 1 when some files were skipped."""
    keep_freed_memory()  # every image needs the same planes again
    options = _options(arguments)
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
    denoising = Denoising(
        denoise,
        frames=options.frames,
        causal=options.causal,
        strength=options.strength,
        inverts=options.invert,
        level_range=LevelRange(*options.levels) if options.levels else None,
    )
    with (
        opened_journal(out, _command(options, denoise)) as journal,
        comparison_video(video) as job_video,
    ):
        # The video to compare by has all images of the run.
        is_anew = options.again or video is not None
        if is_anew:
            journal.begin_anew()
        job = DenoisingJob(
            out=out,
            denoise=denoise,
            points=partial(load, options.weights or POINTS),
            denoising=denoising,
            geometries=geometries,
            journal=journal,
            compare=with_sheets,
            topics=options.topic,
            video=job_video,
        )
        if options.frames > 1:
            for line in said_of_sequences(items):
                print(line)
        _denoise_all(items, job)

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
    yield from job.geometries.summary()
    yield from job.denoising.summary()
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
        yield line_of(row, job.denoising.frames)
    if len(job.rows) > _MOST_LINES:
        yield f"{len(job.rows) - _MOST_LINES} more files: see {TABLE}"


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options of the command line, checked.  Raises FactoryError for wrong ones."""
    parser = Parser(
        prog="simnfnd denoise",
        epilog=_WHICH,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    inputs_help = "image, folder, shard, video, recording or array to denoise"
    add("inputs", nargs="*", metavar="IN", help=inputs_help)
    add("--out", required=True, metavar="DIR", help="folder for the results; names are kept")
    add(
        "--weights",
        metavar="FILE",
        help="weights.safetensors of a training, or a name of those that ship (below)",
    )
    noise_help = (
        "noise of real sonars (default), or of the paper's points; shards state it themselves"
    )
    add("--noise", choices=("real", "points"), default="real", help=noise_help)
    add(
        "--strength",
        type=float,
        default=1.0,
        metavar="PART",
        help="part of the change, 0 to 1 (default: 1)",
    )
    frames_help = (
        "fuse up to N frames of a recording, video, stack or folder numbered in time, where they "
        f"show the same scene: half before and half after each; odd ({FRAMES}; 1: each alone)"
    )
    add("--frames", type=int, default=FRAMES, metavar="N", help=frames_help)
    add("--invert", action="store_true", help="denoise images of dark echoes on a bright ground")
    add(
        "--causal",
        action="store_true",
        help="fuse each frame with earlier ones alone, for live use",
    )
    add("--compare", nargs="?", const=SHEETS, default="", metavar="FILE.mp4", help=_COMPARE)
    geometry_help = (
        "geometry of images and videos: `find` it in the image (default), `polar`, `none`, or a "
        "CSV table of fans (file, apex_x, apex_y, ...); shards and recordings know theirs"
    )
    add("--geometry", default=FIND, help=geometry_help)
    opening_help = "for --geometry polar: degrees from the first column's edge to the last one's"
    add("--opening", type=float, metavar="DEG", help=opening_help)
    levels_help = (
        "values of black and white in float pings and images, such as -60 0 (default: 0 1)"
    )
    add("--levels", type=float, nargs=2, metavar=("BLACK", "WHITE"), help=levels_help)
    add("--again", action="store_true", help="denoise all files, finished ones too")
    topics_help = "topic of a bag to denoise (may be repeated; default: those of sonars)"
    add("--topic", action="append", default=[], metavar="NAME", help=topics_help)
    add(
        "--device",
        choices=("auto", "cpu", "gpu"),
        default="auto",
        help="device that computes (auto: a GPU if there is one)",
    )

    options = parser.parse_args(list(arguments))
    if options.compare not in ("", SHEETS) and Path(options.compare).suffix.lower() != SUFFIX:
        # An input that follows `--compare`.
        if options.inputs and not Path(options.compare).expanduser().exists():
            raise FactoryError(
                f"--compare {options.compare}: no input of that name; the name of a video to "
                f"write ends in {SUFFIX}"
            )
        options.inputs.insert(0, options.compare)
        options.compare = SHEETS
    if not options.inputs:
        raise FactoryError("IN: nothing to denoise; give images, recordings or folders first")
    if not 0 <= options.strength <= 1:
        raise FactoryError(f"--strength {options.strength:g}: must lie between 0 and 1")
    if options.levels and not options.levels[0] < options.levels[1]:
        black, white = options.levels
        raise FactoryError(f"--levels {black:g} {white:g}: black must be less than white")
    if options.noise == "points":
        if options.weights is not None:
            raise FactoryError("--noise points: chooses weights that ship; leave out --weights")
        options.weights = POINTS
    return options


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
    job.journal.begin(runs, in_time=job.denoising.frames > 1)
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
        with progress_bar(total=images, unit="image", desc="denoising") as job.bar:
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
