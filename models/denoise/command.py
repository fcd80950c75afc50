"""Denoise images, folders, HDF5 shards, videos, recordings and bags with trained weights."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ...factory.cli import Parser
from ...factory.errors import FactoryError, FrameError
from ...factory.files import check_writable
from ...factory.imaging.contract import ARTEFACTS
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.memory import keep_freed_memory
from ..pretrained import POINTS, REMOVAL
from ..recordings import Levels, open_recording
from ..removal import DEFAULT
from .bags import denoise_bag, open_bag
from .denoiser import (
    EXACT,
    OVERLAP,
    TILE,
    Denoiser,
    load_denoiser,
)
from .files import (
    Tick,
    denoise_file,
    denoise_pings,
    denoise_video,
)
from .geometries import FIND, Geometries
from .inputs import Item, find_items
from .runtime import PRECISIONS
from .shards import denoise_shard, made_of_points, opened_shard
from .temporal import Steady
from .watch import Watched, watch
from .weighing.in_turn import OVER, InTurn, asked_denoiser
from .weighing.suited import Suited


def main(arguments: Sequence[str]) -> int:
    """`simnfnd denoise IN... --out DIR`, or --watch FOLDER; 1 when some files were skipped."""
    keep_freed_memory()  # every picture needs the same planes again
    parser = Parser(prog="simnfnd denoise")
    parser.add_argument(
        "inputs",
        nargs="*",
        metavar="IN",
        help="image, folder, shard, video, .aris, .ddf, .raw, bag, array (.npy; of .npz, .mat and "
        "HDF5 also FILE::NAME)",
    )
    parser.add_argument("--out", required=True, help="folder for the results; names are kept")
    parser.add_argument(
        "--weights",
        help="weights.safetensors of a training, or the name of weights that ship (default: "
        f"simnfnd, for shards and pictures of the paper's points {POINTS}, and {REMOVAL} for what "
        f"--remove names of {', '.join(OVER)})",
    )
    parser.add_argument(
        "--remove",
        metavar="LIST",
        help=f"what to remove, of {','.join(ARTEFACTS)} (default: {','.join(DEFAULT)})",
    )
    parser.add_argument(
        "--strength", type=float, default=1.0, help="how much of it, 0 to 1 (default: 1)"
    )
    parser.add_argument(
        "--frames",
        type=int,
        default=1,
        metavar="N",
        help="average up to N frames of a video, recording or numbered pictures first, half of "
        "them before and half after each, where the scene stands still; odd (1: do not)",
    )
    parser.add_argument("--compare", action="store_true", help="also write pictures side by side")
    parser.add_argument(
        "--geometry",
        default=FIND,
        help="of images and videos: `find` it in the picture (default), `polar`, `none`, or a CSV "
        "table of fans (file, apex_x, apex_y, ...); shards and recordings know theirs",
    )
    parser.add_argument(
        "--levels",
        nargs=2,
        type=float,
        metavar=("BLACK", "WHITE"),
        help="of arrays and TIFF files: which numbers show as black and as white, such as -60 0 "
        "for decibels",
    )
    parser.add_argument(
        "--topic",
        action="append",
        default=[],
        help="of bags: whose pictures to denoise (may be repeated; default: those of sonars)",
    )
    parser.add_argument(
        "--tile", type=int, default=TILE, help=f"largest side in one go, pixels ({TILE})"
    )
    parser.add_argument(
        "--overlap", type=int, default=OVERLAP, help=f"pixels that tiles share ({OVERLAP})"
    )
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto")
    parser.add_argument(
        "--precision",
        choices=PRECISIONS,
        default=EXACT,
        help=f"arithmetic; auto: bf16-mixed, faster, where the device has it ({EXACT})",
    )
    parser.add_argument(
        "--watch", metavar="FOLDER", help="denoise what comes into a folder, until Ctrl-C"
    )
    parser.add_argument(
        "--every", type=float, default=2.0, help="seconds between two looks at it (2)"
    )
    chosen = parser.parse_args(list(arguments))
    if not 0 <= chosen.overlap <= chosen.tile // 2:
        raise FactoryError(f"--overlap {chosen.overlap}: must be at most half of --tile")
    if bool(chosen.inputs) == (chosen.watch is not None):
        raise FactoryError("give files or folders to denoise, or --watch FOLDER, and not both")
    if not 0 < chosen.every < 86_400:
        raise FactoryError(f"--every {chosen.every:g}: give seconds, more than 0")
    if not 0 <= chosen.strength <= 1:
        raise FactoryError(f"--strength {chosen.strength:g}: must lie between 0 and 1")
    out = Path(chosen.out).expanduser()
    levels = _levels(chosen.levels)
    watched = Watched(Path(chosen.watch).expanduser(), out, levels) if chosen.watch else None
    items = find_items([Path(name).expanduser() for name in chosen.inputs], out, levels)
    geometries = Geometries(chosen.geometry)
    steady = Steady(chosen.frames, items)
    check_writable(out, "--out")
    how: dict[str, Any] = {
        "device": chosen.device,
        "tile": chosen.tile,
        "overlap": chosen.overlap,
        "strength": chosen.strength,
        "precision": chosen.precision,
    }
    remove = None if chosen.remove is None else chosen.remove.split(",")
    denoise = asked_denoiser(chosen.weights, remove=remove, **how)
    steady.see(denoise.looks)
    points = suited = None
    if chosen.weights is None and remove is None:
        points = cache(lambda: load_denoiser(POINTS, **how))
        suited = Suited(denoise, points)
    work = _Work(out, denoise, points, suited, geometries, steady, chosen.topic, chosen.compare)
    failed = _watch(work, watched, chosen.every) if watched else _all(work, items)
    said = suited.summary() if suited else ()
    for line in (*geometries.summary(), *steady.summary(), *said):
        print(line)
    print(f"denoised: {work.done} file(s) in {out}")
    return 1 if failed and not watched else 0


def _levels(given: Sequence[float] | None) -> Levels | None:
    if given is None:
        return None
    black, white = given
    if not (math.isfinite(black) and math.isfinite(white) and black != white):
        raise FactoryError(f"--levels {black:g} {white:g}: give two different numbers")
    return Levels(black, white)


@dataclass
class _Work:
    """What `denoise` does to a file.

    points: what denoises shards of points instead of `denoise`; None: the same.  suited: what
    denoises pictures of which nothing is known; None: the same.
    done: how many were denoised.
    """

    out: Path
    denoise: Denoiser | InTurn
    points: Callable[[], Denoiser] | None
    suited: Suited | None
    geometries: Geometries
    steady: Steady
    topics: Sequence[str]
    compare: bool
    done: int = 0

    def on(self, item: Item, tick: Tick) -> str:
        """Denoise one file; returns a warning, mostly empty.  FrameError when that cannot be."""
        warning = ""
        out, denoise, compare = self.out, self.denoise, self.compare
        find, steady = self.geometries.of, self.steady
        if item.kind == "shard":
            if self.points is not None and made_of_points(item):
                denoise = self.points()
            denoise_shard(
                item, out, denoise, weights_sha256=denoise.digest, compare=compare, tick=tick
            )
        elif item.kind == "pings":
            warning = denoise_pings(item, out, denoise, compare=compare, tick=tick, steady=steady)
        elif item.kind == "bag":
            warning = denoise_bag(
                item, out, denoise, find,
                topics=self.topics, compare=compare, tick=tick, steady=steady,
            )  # fmt: skip
        else:
            on_file = denoise_video if item.kind == "video" else denoise_file
            suited = self.suited or denoise
            on_file(item, out, suited, find, compare=compare, tick=tick, steady=steady)
        self.done += 1
        return warning


def _all(work: _Work, items: Sequence[Item]) -> int:
    """Denoise all files under a progress bar; returns how many could not be."""
    failures: list[str] = []
    warnings: list[str] = []
    with progress_bar(
        total=sum(_pictures(item, work.topics) for item in items), unit="image", desc="denoising"
    ) as bar:
        for item in items:
            try:
                warnings += filter(None, [work.on(item, bar.update)])
            except FrameError as error:
                failures.append(str(error))
                bar.set_postfix(failed=len(failures))
    if failures and len(failures) == len(items):
        more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
        raise FactoryError(failures[0] + more)
    for line in failures:
        print(f"skipped: {line}", file=sys.stderr)
    for line in warnings:
        print(f"warning: {line}", file=sys.stderr)
    return len(failures)


def _watch(work: _Work, watched: Watched, every_s: float) -> int:
    """Denoise what comes, with a line each; returns how many files could not be."""
    failures = 0

    def on(item: Item) -> None:
        nonlocal failures
        began = time.perf_counter()
        try:
            warning = work.on(item, lambda: None)
        except FrameError as error:
            failures += 1
            print(f"skipped: {error}", file=sys.stderr, flush=True)
            return
        if warning:
            print(f"warning: {warning}", file=sys.stderr, flush=True)
        print(f"{item.relative}: {time.perf_counter() - began:.2f} s", flush=True)

    print(f"watching {watched.folder}; Ctrl-C ends", flush=True)
    watch(watched, on, every_s)
    return failures


def _pictures(item: Item, topics: Sequence[str]) -> int:
    """How many pictures a file holds, for the progress bar; 0 for one that cannot be read."""
    if item.kind == "image":
        return 1
    try:
        if item.kind == "shard":
            with opened_shard(item) as shard:
                return len(shard["noisy"])
        if item.kind == "bag":
            return len(open_bag(item, topics))
        with open_recording(item.source, item.levels) as recording:
            return len(recording)
    except FactoryError:
        return 0
