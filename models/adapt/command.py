"""`simnfnd adapt RECORDING --out WEIGHTS`: fit trained weights to recordings without truth."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...factory.cli import Parser
from ...factory.errors import FactoryError
from ...factory.files import check_writable, sha256_of
from ..denoise.geometries import FIND, Geometries
from ..pretrained import find_weights

if TYPE_CHECKING:
    from ..networks.network import Network
    from .clips import Found
    from .objectives import StillLesson
    from .simulated import Simulated
    from .tuning import Tuned

_BATCH, _RATE = 2, 1e-3


def main(arguments: Sequence[str]) -> int:
    """Write the fitted weights; 1 when nothing came out better and so nothing was written."""
    chosen = _parsed(arguments)
    out = Path(chosen.out).expanduser()
    start = find_weights(chosen.weights)
    if out.exists() and out.resolve() == start.resolve():
        raise FactoryError(f"--out {out}: would replace the weights to begin with")
    check_writable(out.parent, "--out")
    geometries = Geometries(chosen.geometry)

    from .clips import read_clips

    found = read_clips([Path(name).expanduser() for name in chosen.recordings], out, geometries)
    for line in found.skipped[:3]:
        print(f"skipped: {line}", file=sys.stderr)
    for line in geometries.summary():
        print(line)
    return _adapt(chosen, found, start, out)


def _parsed(arguments: Sequence[str]) -> Any:
    parser = Parser(prog="simnfnd adapt")
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="IN",
        help="folder, video, .aris, .ddf or .raw; several are learned from alike",
    )
    parser.add_argument("--out", required=True, help="file to write, NAME.safetensors")
    parser.add_argument(
        "--weights", help="weights to begin with: a file, or the name of weights that ship"
    )
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--minutes", type=float, default=5.0, help="about how long it may take (5)")
    length.add_argument("--steps", type=int, help="how many steps instead; repeatable to the bit")
    parser.add_argument(
        "--keep",
        type=float,
        default=0.5,
        help="weight of simulated pictures, so that nothing is forgotten, 0 to below 1 (0.5)",
    )
    parser.add_argument(
        "--pairs", metavar="DATASET", help="folder of `simnfnd make` to take these pictures from"
    )
    parser.add_argument(
        "--geometry",
        default=FIND,
        help="of pictures and videos: `find` it in the picture (default), `polar`, `none`, or a "
        "CSV table of fans as `simnfnd geometry` prints; recordings know theirs",
    )
    parser.add_argument(
        "--part",
        type=float,
        default=1.0,
        help="part of the change of the weights that is kept, 0 to 1 (1); less serves other sonars",
    )
    parser.add_argument(
        "--untold",
        type=float,
        default=0.0,
        help="part of the steps without a word about geometry, 0 to 1 (0); more serves other "
        "sonars",
    )
    parser.add_argument("--batch", type=int, default=_BATCH, help=f"crops a step ({_BATCH})")
    parser.add_argument(
        "--learning-rate", type=float, default=_RATE, help=f"of AdamW at its highest ({_RATE:g})"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="auto")
    chosen = parser.parse_args(list(arguments))
    if Path(chosen.out).suffix != ".safetensors":
        raise FactoryError(f"--out {chosen.out}: must end in .safetensors")
    if not 0 <= chosen.keep < 1:
        raise FactoryError(f"--keep {chosen.keep:g}: must be 0 or more and less than 1")
    if chosen.steps is not None and chosen.steps < 1:
        raise FactoryError(f"--steps {chosen.steps}: must be 1 or more")
    if not 0 < chosen.minutes <= 1e4:
        raise FactoryError(f"--minutes {chosen.minutes:g}: must be more than 0, and 10000 at most")
    if not 0 < chosen.part <= 1:
        raise FactoryError(f"--part {chosen.part:g}: must be more than 0, and 1 at most")
    if not 0 <= chosen.untold <= 1:
        raise FactoryError(f"--untold {chosen.untold:g}: must lie between 0 and 1")
    if not 1 <= chosen.batch <= 1024:
        raise FactoryError(f"--batch {chosen.batch}: must lie between 1 and 1024")
    if not 0 < chosen.learning_rate <= 1:
        raise FactoryError(f"--learning-rate {chosen.learning_rate:g}: must lie between 0 and 1")
    if chosen.seed < 0:
        raise FactoryError(f"--seed {chosen.seed}: must be 0 or more")
    return chosen


def _adapt(chosen: Any, found: Found, start: Path, out: Path) -> int:
    # torch takes seconds to import: only when there is something to learn from.
    import torch

    from ..networks.weights import load_weights, save_weights
    from .objectives import KeptLesson
    from .tuning import Pace, tune

    if chosen.device == "gpu" and not torch.cuda.is_available():
        raise FactoryError("--device gpu: no usable GPU here; use --device cpu")
    device = "cuda" if torch.cuda.is_available() and chosen.device != "cpu" else "cpu"
    trained = load_weights(start)
    model = dict(trained.model)
    network = _network(model, trained.network).to(device)
    lesson, facts = _lesson(found, chosen, device)
    kept = None
    if chosen.keep:
        simulated = _simulated(chosen)
        lesson_kept = KeptLesson(simulated, network, chosen.batch, chosen.seed, device)
        if len(lesson_kept):
            kept, remembered = lesson_kept, lesson_kept.figure(network)
            facts |= {"kept": simulated.name, "kept.pictures": len(kept)}
        else:
            print("simulated pictures: the weights improve none of them, so there is none to keep")
    pace = Pace(chosen.steps, chosen.minutes, chosen.keep, chosen.learning_rate, part=chosen.part)
    tuned = tune(network, lesson, kept, pace, chosen.seed)
    print(_said(lesson, tuned))
    if kept is not None:
        print(
            f"simulated pictures held out, PSNR: before {remembered:.2f}, "
            f"after {kept.figure(network):.2f} dB"
        )
    if not tuned.is_better:
        print("nothing written: no weights on the way were better than those it began with")
        return 1
    facts |= {
        "start": sha256_of(start)[:16],
        "start.training": dict(trained.training),
        "steps": tuned.steps,
        "keep": chosen.keep,
        "learning_rate": pace.learning_rate,
        "batch": chosen.batch,
        "part": pace.part,
        "untold": chosen.untold,
        "seed": chosen.seed,
        "validation": {"step": tuned.step, "before": tuned.before, "after": tuned.after},
    }
    save_weights(out, network, model, facts)
    print(f"weights: {out} (step {tuned.step} of {tuned.steps}; use them with --weights {out})")
    return 0


def _network(model: Mapping[str, Any], trained: Network) -> Network:
    from ..networks import build_network
    from ..networks.weights import channels_last

    network = build_network(model)
    network.load_state_dict(trained.state_dict())
    return channels_last(network).eval()


def _lesson(found: Found, chosen: Any, device: str) -> tuple[StillLesson, dict[str, Any]]:
    """What there is to learn from in the recordings, and facts about it."""
    from .objectives import StillLesson
    from .still import find_lessons

    read = sum(len(clip.shots) for clip in found.clips)
    if read < 2:
        raise FactoryError(
            f"{found.clips[0].name}: is one picture; adapting needs at least two frames, and four "
            "of a scene that stands still are better"
        )
    share = f"{read} of {found.frames}" if read < found.frames else f"{read}"
    lessons = find_lessons(found.clips)
    if lessons is None:
        raise FactoryError(
            f"{found.clips[0].name}: nothing stands still in {share} frames, so no mean of other "
            "frames can be learned from; record a scene with the sonar at rest"
        )
    still = StillLesson(lessons, chosen.batch, chosen.seed, device, chosen.untold)
    learning, held = (
        sum(len(one.frames) for one in part) for part in (lessons.learning, lessons.held)
    )
    stretches = len(lessons.learning) + (0 if lessons.same else len(lessons.held))
    print(
        f"{stretches} stretch(es) stand still in {share} frames: {learning} frames to learn from, "
        f"{held} held out" + (", of the same stretch" if lessons.same else "")
    )
    return still, {
        "adapted.by": "mean of the other frames",
        "adapted.frames": learning,
        "adapted.stretches": len(lessons.learning),
    }


def _simulated(chosen: Any) -> Simulated:
    from .simulated import of_dataset, of_reliefs

    if chosen.pairs is not None:
        return of_dataset(chosen.pairs, chosen.seed)
    return of_reliefs(chosen.seed)


def _said(lesson: StillLesson, tuned: Tuned) -> str:
    figures = f"before {tuned.before:.2f}, after {tuned.after:.2f} dB"
    worse = tuned.after < lesson.noisy
    return f"frames held out, PSNR after levels: noisy {lesson.noisy:.2f}, {figures}" + (
        "\nthat is less than the frames as they are; more --minutes may help" if worse else ""
    )
