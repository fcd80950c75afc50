"""Denoise images, folders, HDF5 shards, videos, recordings and bags with trained weights."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path

from ...factory.cli import Parser
from ...factory.errors import FactoryError, FrameError
from ...factory.files import check_writable
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.machine import keep_freed_memory
from ..pretrained import DEFAULT as DEFAULT_WEIGHTS
from ..pretrained import POINTS
from .denoiser import Denoiser
from .files import Job, denoise_files, denoise_recording, opened
from .inputs import FIND, Finished, Geometries, Item, find_items, sequences
from .pictures import Denoising, check_frames
from .temporal.stream import FRAMES

Points = Callable[[], Denoiser] | None

_WHICH = f"""\
weights that ship:
  {DEFAULT_WEIGHTS:16}  real sonars: single frames and recordings (default)
  {POINTS:16}  the paper's points: datasets say so, other files need --noise points
your own sonar: `simnfnd adapt RECORDING --out own.safetensors`, then --weights own.safetensors
"""


def main(arguments: Sequence[str]) -> int:
    """`simnfnd denoise IN... --out DIR`; 1 when some files were skipped."""
    keep_freed_memory()  # every picture needs the same planes again
    parser = Parser(
        prog="simnfnd denoise",
        epilog=_WHICH,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "inputs",
        nargs="+",
        metavar="IN",
        help="image, folder, shard, video, .aris, .ddf, .raw, bag or array (.npy)",
    )
    parser.add_argument("--out", required=True, help="folder for the results; names are kept")
    parser.add_argument(
        "--weights",
        help="weights.safetensors of a training, or the name of weights that ship (see below)",
    )
    parser.add_argument(
        "--noise",
        choices=("real", "points"),
        default="real",
        help="of real sonars, or of the paper's points; shards say it themselves",
    )
    parser.add_argument(
        "--strength", type=float, default=1.0, help="part of the change, 0 to 1 (default: 1)"
    )
    parser.add_argument(
        "--frames",
        type=int,
        default=FRAMES,
        metavar="N",
        help="fuse up to N frames of a recording, video, stack or folder numbered in time where "
        f"they show the same, half before and half after each; odd ({FRAMES}; 1: each by itself)",
    )
    parser.add_argument(
        "--causal", action="store_true", help="fuse with frames before alone, for live use"
    )
    parser.add_argument("--compare", action="store_true", help="also write pictures side by side")
    parser.add_argument(
        "--geometry",
        default=FIND,
        help="of images and videos: `find` it in the picture (default), `polar`, `none`, or a CSV "
        "table of fans (file, apex_x, apex_y, ...); shards and recordings know theirs",
    )
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        help="of bags: whose pictures to denoise (may be repeated; default: those of sonars)",
    )
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto")
    chosen = parser.parse_args(list(arguments))
    if not 0 <= chosen.strength <= 1:
        raise FactoryError(f"--strength {chosen.strength:g}: must lie between 0 and 1")
    out = Path(chosen.out).expanduser()
    inputs = [Path(name).expanduser() for name in chosen.inputs]
    items = find_items(inputs, out, compare=chosen.compare)
    geometries = Geometries(chosen.geometry)
    # What is asked for by hand is not what predicts other frames of a recording.
    calibrated = chosen.strength == 1
    if chosen.noise == "points":
        if chosen.weights is not None:
            raise FactoryError("--noise points: chooses weights that ship; leave out --weights")
        chosen.weights = POINTS
    check_frames(chosen.frames)
    check_writable(out, "--out")
    load = cache(partial(Denoiser, device=chosen.device, strength=chosen.strength))
    denoise = load(chosen.weights)
    points = partial(load, POINTS) if chosen.weights is None else None
    denoising = Denoising(
        denoise, frames=chosen.frames, causal=chosen.causal, calibrated=calibrated
    )
    job = Job(out, denoising, geometries.of, chosen.compare, chosen.topic)
    finished = Finished(out, denoise.digest, list(arguments))
    failed, used = _all(items, job, denoise, points, finished)
    for line in (*geometries.summary(), *denoising.summary()):
        print(line)
    names = ", ".join(f"{name} ({count} file(s))" for name, count in used.items())
    print(f"weights: {names or denoise.name}")
    print(f"denoised: {used.total()} file(s) in {out}")
    return 1 if failed else 0


def _denoised(
    items: Sequence[Item], job: Job, denoise: Denoiser, points: Points
) -> Iterator[tuple[Item, str, FrameError | str]]:
    """Denoise pictures that follow each other, or one other file.

    points: what denoises shards of points instead; None: the same.
    Gives each with the name of its weights, and a warning, mostly empty, or what is wrong with it.
    """
    if items[0].kind == "image":
        for item, error in denoise_files(items, job):
            yield item, denoise.name, error or ""
        return
    (item,) = items
    of_points, warning = False, ""
    try:
        if item.kind == "shard":
            from .shards import denoise_shard, made_of_points  # loads h5py, for datasets alone

            of_points = made_of_points(item)
            denoise = points() if of_points and points is not None else denoise
            denoise_shard(item, job, denoise)
        else:
            warning = denoise_recording(item, job)
        warnings = filter(None, [warning, _unsuited(item, denoise, of_points)])
        yield item, denoise.name, "; ".join(warnings)
    except FrameError as error:
        yield item, denoise.name, error


def _unsuited(item: Item, denoise: Denoiser, of_points: bool) -> str:
    """A warning where weights that ship were made for other noise."""
    if denoise.name not in (DEFAULT_WEIGHTS, POINTS) or of_points == (denoise.name == POINTS):
        return ""
    made_for = "the paper's points" if denoise.name == POINTS else "real sonars"
    other = DEFAULT_WEIGHTS if denoise.name == POINTS else POINTS
    return f"{item.source}: {denoise.name} is made for {made_for}; {other} suits this file"


def _all(
    items: Sequence[Item], job: Job, denoise: Denoiser, points: Points, finished: Finished
) -> tuple[int, Counter[str]]:
    """Denoise all files under a progress bar.

    Returns how many could not be, and the names of weights with how many files they denoised.
    """
    used: Counter[str] = Counter()
    failures: list[str] = []
    warnings: list[str] = []
    job.finished = finished.of(items)
    if job.finished:
        print(f"already denoised: {len(job.finished)} file(s), of a run that was stopped")
    total = sum(_pictures(item, job.topics) for item in items if item.relative not in job.finished)
    try:
        with progress_bar(total=total, unit="image", desc="denoising") as bar:
            job.tick = bar.update
            for some in sequences(items):
                if some[0].kind != "image" and some[0].relative in job.finished:
                    continue
                for item, name, said in _denoised(some, job, denoise, points):
                    if isinstance(said, FrameError):
                        failures.append(str(said))
                        bar.set_postfix(failed=len(failures))
                    else:
                        finished.add(item)
                        used[name] += 1
                        warnings += filter(None, [said])
    except KeyboardInterrupt:
        finished.save()
        print(
            f"denoised: {used.total()} file(s) in {job.out} before it was stopped; the same "
            "command goes on with the others",
            file=sys.stderr,
        )
        raise
    finished.forget()
    if failures and len(failures) == len(items):
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        raise FactoryError(failures[0] + more)
    for line in failures:
        print(f"skipped: {line}", file=sys.stderr)
    for line in warnings:
        print(f"warning: {line}", file=sys.stderr)
    return len(failures), used


def _pictures(item: Item, topics: Sequence[str]) -> int:
    """How many pictures a file holds, for the progress bar; 0 for one that cannot be read."""
    if item.kind == "image":
        return 1
    try:
        if item.kind == "shard":
            from .shards import opened_shard

            with opened_shard(item) as shard:
                return len(shard["noisy"])
        with opened(item, topics) as recording:
            return len(recording)
    except FactoryError:
        return 0
