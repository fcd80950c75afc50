"""The options of `simnfnd denoise`: help and mistakes answer before anything is loaded."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ..pretrained import DEFAULT as DEFAULT_WEIGHTS
from ..pretrained import POINTS

SHEETS = "sheets"
"""Value of `--compare` for a sheet an image."""
FRAMES = 15
"""Frames of a recording that are fused, where `--frames` is not given."""
_VIDEO_SUFFIX = ".mp4"  # of a comparison video
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
    options = options_of(arguments)
    from .command import run

    return run(options)


def options_of(arguments: Sequence[str]) -> argparse.Namespace:
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
    add("--geometry", default="find", help=geometry_help)
    opening_help = "for --geometry polar: degrees from the first column's edge to the last one's"
    add("--opening", type=float, metavar="DEG", help=opening_help)
    levels_help = (
        "values of black and white in float pings and images, such as -60 0 (default: 0 1)"
    )
    add("--levels", type=float, nargs=2, metavar=("BLACK", "WHITE"), help=levels_help)
    table_help = "also write a CSV row for each frame: its motion, and how much was fused"
    add("--table", metavar="FILE.csv", help=table_help)
    workers_help = "processes that denoise a recording side by side (1; any number: same bytes)"
    add("--workers", type=int, default=1, metavar="N", help=workers_help)
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
    if (
        options.compare not in ("", SHEETS)
        and Path(options.compare).suffix.lower() != _VIDEO_SUFFIX
    ):
        # An input that follows `--compare`.
        if options.inputs and not Path(options.compare).expanduser().exists():
            raise FactoryError(
                f"--compare {options.compare}: no input of that name; the name of a video to "
                f"write ends in {_VIDEO_SUFFIX}"
            )
        options.inputs.insert(0, options.compare)
        options.compare = SHEETS
    if not options.inputs:
        raise FactoryError("IN: nothing to denoise; give images, recordings or folders first")
    if not 0 <= options.strength <= 1:
        raise FactoryError(f"--strength {options.strength:g}: must lie between 0 and 1")
    if options.workers < 1:
        raise FactoryError(f"--workers {options.workers}: must be 1 or more")
    if options.levels and not options.levels[0] < options.levels[1]:
        black, white = options.levels
        raise FactoryError(f"--levels {black:g} {white:g}: black must be less than white")
    if options.noise == "points":
        if options.weights is not None:
            raise FactoryError("--noise points: chooses weights that ship; leave out --weights")
        options.weights = POINTS
    return options
