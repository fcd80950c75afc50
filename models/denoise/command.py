"""Denoise images, folders, HDF5 shards, videos, recordings and bags with trained weights."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

from ...factory.cli import Parser
from ...factory.errors import FactoryError
from ...factory.files import check_writable
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.machine import keep_freed_memory
from ..pretrained import DEFAULT as DEFAULT_WEIGHTS
from ..pretrained import POINTS
from .denoiser import Denoiser
from .files import Job, denoise_files
from .inputs import FIND, Finished, Geometries, Item, find_items, sequences
from .pictures import Denoising
from .temporal.stream import FRAMES

_WHICH = f"""\
weights that ship:
  {DEFAULT_WEIGHTS:16}  real sonars: single frames and recordings (default)
  {POINTS:16}  the paper's points: datasets say so, other files need --noise points
your own sonar: `simnfnd adapt RECORDING --out own.safetensors`, then --weights own.safetensors
"""
_COMPARE = "also write sheets: noisy, denoised, and removed in standard deviations of the grain"


def main(arguments: Sequence[str]) -> int:
    """`simnfnd denoise IN... --out DIR`; 1 when some files were skipped."""
    keep_freed_memory()  # every picture needs the same planes again
    how = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog="simnfnd denoise", epilog=_WHICH, formatter_class=how)
    add = parser.add_argument
    add("inputs", nargs="+", metavar="IN", help="image, folder, shard, video, recording, array")
    add("--out", required=True, help="folder for the results; names are kept")
    add("--weights", help="weights.safetensors of a training, or a name of those that ship (below)")
    of_noise = "of real sonars, or of the paper's points; shards say it themselves"
    add("--noise", choices=("real", "points"), default="real", help=of_noise)
    add("--strength", type=float, default=1.0, help="part of the change, 0 to 1 (default: 1)")
    fused = (
        "fuse up to N frames of a recording, video, stack or folder numbered in time where they "
        f"show the same, half before and half after each; odd ({FRAMES}; 1: each by itself)"
    )
    add("--frames", type=int, default=FRAMES, metavar="N", help=fused)
    add("--causal", action="store_true", help="fuse with frames before alone, for live use")
    add("--compare", action="store_true", help=_COMPARE)
    where = (
        "of images and videos: `find` it in the picture (default), `polar`, `none`, or a CSV table "
        "of fans (file, apex_x, apex_y, ...); shards and recordings know theirs"
    )
    add("--geometry", default=FIND, help=where)
    topics = "of bags: whose pictures to denoise (may be repeated; default: those of sonars)"
    add("--topic", action="append", default=[], help=topics)
    add("--device", choices=("auto", "cpu", "gpu"), default="auto")
    chosen = parser.parse_args(list(arguments))
    if not 0 <= chosen.strength <= 1:
        raise FactoryError(f"--strength {chosen.strength:g}: must lie between 0 and 1")
    out = Path(chosen.out).expanduser()
    inputs = [Path(name).expanduser() for name in chosen.inputs]
    items = find_items(inputs, out, compare=chosen.compare)
    geometries = Geometries(chosen.geometry)
    if chosen.noise == "points":
        if chosen.weights is not None:
            raise FactoryError("--noise points: chooses weights that ship; leave out --weights")
        chosen.weights = POINTS
    check_writable(out, "--out")
    load = cache(partial(Denoiser, device=chosen.device, strength=chosen.strength))
    denoise = load(chosen.weights)
    window = partial(Denoising, frames=chosen.frames, causal=chosen.causal)
    # What is asked for by hand is not what predicts other frames of a recording.
    denoising = window(denoise, calibrated=chosen.strength == 1)
    points = partial(load, chosen.weights or POINTS)
    finished = Finished(out, denoise.digest, list(arguments))
    job = Job(out, denoise, points, denoising, geometries, finished, chosen.compare, chosen.topic)
    _all(items, job)
    for line in (*geometries.summary(), *denoising.summary(), *job.removed.summary()):
        print(line)
    names = ", ".join(f"{name} ({count} file(s))" for name, count in job.used.items())
    print(f"weights: {names or denoise.name}")
    print(f"denoised: {job.used.total()} file(s) in {out}")
    return 1 if job.failures else 0


def _all(items: Sequence[Item], job: Job) -> None:
    """Denoise all files under a progress bar.  FactoryError when none could be."""
    before = sum(item in job.finished for item in items)
    if before:
        print(f"already denoised: {before} file(s), of a run that was stopped")
    images = sum(item.kind == "pictures" and item not in job.finished for item in items)
    try:
        with progress_bar(total=images, unit="image", desc="denoising") as job.bar:
            for some in sequences(items):
                denoise_files(some, job)
    except KeyboardInterrupt:
        job.finished.save()
        print(
            f"denoised: {job.used.total()} file(s) in {job.out} before it was stopped; the same "
            "command goes on with the others",
            file=sys.stderr,
        )
        raise
    job.finished.forget()
    if job.failures and len(job.failures) == len(items):
        more = f" (and {len(job.failures) - 1} more)" if len(job.failures) > 1 else ""
        raise FactoryError(job.failures[0] + more)
    for word, lines in (("skipped", job.failures), ("warning", job.warnings)):
        for line in lines:
            print(f"{word}: {line}", file=sys.stderr)
