"""`simnfnd adapt RECORDING --out WEIGHTS`: fit trained weights to recordings without truth.

The target of a frame is the mean of the *other* frames of a stretch in which the scene stands
still, laid over it below a pixel (after Lehtinen et al., Noise2Noise, ICML 2018; the mean of
several has less noise left than one).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, real_path, sha256_of
from ..pretrained import find_weights
from ..pretrained.learned_files import KEY as LEARNED_FROM
from ..pretrained.learned_files import described, learned_files
from ..recordings.inputs import FIND, Geometries
from .stretches import Lessons, ReadClips, find_lessons, read_clips

_BOUNDS = {"steps": (1, math.inf), "learning_rate": (1e-9, 1), "seed": (0, math.inf)}
"""Option -> the least and the largest value."""


def main(arguments: Sequence[str]) -> int:
    """Write the fitted weights; 1 when nothing came out better and so nothing was written."""
    options = _parsed(arguments)
    out = Path(options.out).expanduser()
    start = find_weights(options.weights)
    if out.exists() and real_path(out) == real_path(start):
        raise FactoryError(f"--out {out}: would replace the weights to begin with")
    check_writable(out.parent, "--out")
    geometries = Geometries(options.geometry)
    read = read_clips([Path(name).expanduser() for name in options.recordings], out, geometries)
    for line in read.skipped[:3]:
        print(f"skipped: {line}", file=sys.stderr)
    for line in read.notes:
        print(line)
    if read.copies:
        print(f"repeated frames: {read.copies} copies of others are left out")
    for line in geometries.summary():
        print(line)
    return _adapt(options, _lessons(read), read.paths, start, out)


def _parsed(arguments: Sequence[str]) -> Any:
    parser = Parser(prog="simnfnd adapt")
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="IN",
        help="folder, video, .aris, .ddf or .raw to learn from; several have equal weight",
    )
    parser.add_argument(
        "--out", required=True, metavar="FILE", help="file to write, NAME.safetensors"
    )
    parser.add_argument(
        "--weights",
        metavar="FILE",
        help="weights to begin with: a file, or the name of weights that ship",
    )
    parser.add_argument(
        "--steps",
        type=int,
        default=500,
        help="training steps of two crops each (500, about 3 CPU minutes)",
    )
    parser.add_argument(
        "--geometry",
        default=FIND,
        help="geometry of images and videos: `find` it in the image (default), `polar`, `none`, or "
        "a CSV table of fans (file, apex_x, apex_y, ...); recordings know theirs",
    )
    parser.add_argument(
        "--learning-rate", type=float, default=2e-4, help="highest learning rate of AdamW (0.0002)"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of all random draws (0)")
    parser.add_argument(
        "--device", choices=("auto", "cpu", "gpu"), default="auto", help="device that computes"
    )
    chosen = parser.parse_args(list(arguments))
    if Path(chosen.out).suffix != ".safetensors":
        raise FactoryError(f"--out {chosen.out}: must end in .safetensors")
    for name, (least, most) in _BOUNDS.items():
        if not least <= getattr(chosen, name) <= most:
            raise FactoryError(
                f"--{name.replace('_', '-')} {getattr(chosen, name):g}: must lie between {least:g} "
                f"and {most:g}"
            )
    return chosen


def _lessons(read: ReadClips) -> Lessons:
    """Find the static stretches of the recordings; FactoryError without any."""
    frame_count = sum(len(clip.shots) for clip in read.clips)
    share = f"{frame_count} of {read.frames}" if frame_count < read.frames else f"{frame_count}"
    lessons = find_lessons(read.clips)
    if lessons is None:
        raise FactoryError(
            f"{read.clips[0].name}: no scene is static in {share} frames, so no mean of other "
            "frames can be learned from; record a scene with the sonar at rest"
        )
    learning, held = (
        sum(len(stretch.frames) for stretch in part) for part in (lessons.learning, lessons.held)
    )
    stretches = len(lessons.learning) + (0 if lessons.same else len(lessons.held))
    print(
        f"{stretches} static stretch(es) in {share} frames: {learning} frames to learn from, "
        f"{held} held out" + (", of the same stretch" if lessons.same else "")
    )
    return lessons


def _adapt(chosen: Any, lessons: Lessons, paths: Sequence[Path], start: Path, out: Path) -> int:
    # torch takes seconds to import: only when there is something to learn from.
    from ..networks.weights import load_weights, save_weights
    from ..training.loop import device_of
    from .adapting import Lesson, tune

    device = device_of(chosen.device, "--device ")
    trained = load_weights(start)
    network = trained.network.to(device)
    lesson = Lesson(lessons, chosen.seed, network.extras)
    rate = chosen.learning_rate
    steps = chosen.steps
    best = tune(network, lesson, steps, rate, device)
    noisy = lesson.figure(lesson.judging)
    before = best["before"]
    after = best["after"]
    frames = "frames held out"
    if not lesson.is_judged_apart:
        frames += " (one, which chose the weights too)"
    print(
        f"{frames}, PSNR after levels: noisy {noisy:.2f}, before {before:.2f}, after {after:.2f} dB"
    )
    if after < noisy:
        print("that is less than the frames as they are; more --steps may help")
    if not after > before:
        print("nothing written: the frames held out are no better by the weights on the way")
        return 1
    facts = {
        "adapted.by": "mean of the other frames",
        "adapted.frames": sum(len(stretch.frames) for stretch in lessons.learning),
        "adapted.stretches": len(lessons.learning),
        LEARNED_FROM: [
            entry._asdict() for entry in dict.fromkeys([*described(paths), *learned_files(start)])
        ],
        "start": sha256_of(start)[:16],
        "start.training": dict(trained.training),
        "steps": steps,
        "learning_rate": rate,
        "seed": chosen.seed,
        "validation": best,
    }
    save_weights(out, network, trained.model, facts)
    print(f"weights: {out} (step {best['step']} of {steps}; use them with --weights {out})")
    return 0
