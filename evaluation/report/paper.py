"""`simnfnd evaluate paper`: Tables 2 and 3 and Figure 14 of the paper, from the dataset on.

Every step is a command of its own, which is printed.  Making and training resume where they were
interrupted and do nothing where they are done; the report is measured anew each time.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable
from ...factory.common.words import quote
from .build import REPORT_NAME
from .document import write_files
from .tables import as_markdown, as_table, beside_paper

_NEWLOSS = ("loss=newloss", "loss.shadow=ste", "loss.weight=0.05")
"""As printed, the second term has no gradient (docs/models.md): here it is straight through."""
_RIVAL = "sid_tgan"
_FIGURE_ROWS = {
    "lpmsde": "LPMsDE, after the abstract",
    _RIVAL: "SID-TGAN, after the abstract",
    "simnfnd_newloss": "SimNFND + NewLoss",
}
"""Methods of Figure 14: row of the report -> what it is."""
_FIGURE_IMAGES = 16
_QUICK_TIME = "3 minutes on two idle cores, 10 beside other work"
_FIGURE_EXAMPLES = 6


@dataclass(frozen=True)
class PaperPlan:
    """How much is made and trained.

    scenes: a folder of FLSea VI, None for procedural places.  real: the images of OldData.
    frames: rendered, each with two noise variants where they are few.  steps: of a training.
    """

    out: Path
    scenes: Path | None
    real: Path | None
    quick: bool
    frames: int
    steps: int

    @property
    def about(self) -> str:
        """One sentence for the tables."""
        source = "procedural places" if self.scenes is None else self.scenes.name
        pairs = f"{self.frames * (1 + self.quick)} pairs of {self.frames} frames at most ({source})"
        text = f"{pairs}, {self.steps} steps per training"
        text += "" if self.real else ", without OldData"
        return f"Quick mode, no reproduction: {text}." if self.quick else f"{text}."


def main(words: Sequence[str]) -> int:
    """Make, train, judge, and print the tables; the exit code of the step that failed, or 0."""
    parser = Parser(prog="simnfnd evaluate paper")
    parser.add_argument("--quick", action="store_true", help=f"use few pairs: {_QUICK_TIME}")
    parser.add_argument(
        "--scenes", type=Path, metavar="DIR", help="folder of FLSea VI (default: procedural places)"
    )
    parser.add_argument(
        "--real",
        type=Path,
        metavar="DIR",
        help="Marine Debris Dataset, for OldData (default: without that row)",
    )
    parser.add_argument(
        "--frames",
        type=int,
        metavar="N",
        help="number of frames to render (default: 8000; quick: 32)",
    )
    parser.add_argument(
        "--steps", type=int, metavar="N", help="steps of each training (default: 4000; quick: 200)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("outputs/paper"),
        help="folder for everything (outputs/paper)",
    )
    options = parser.parse_args(list(words))
    for key, least in (("frames", 4), ("steps", 1)):
        if (value := getattr(options, key)) is not None and value < least:
            raise FactoryError(f"--{key}: at least {least}, given {value}")
    for key in ("scenes", "real"):
        if (folder := getattr(options, key)) is not None and not folder.is_dir():
            raise FactoryError(f"--{key} {folder}: no such folder")
    check_writable(options.out, "--out")
    frames = options.frames or (32 if options.quick else 8000)
    steps = options.steps or (200 if options.quick else 4000)
    plan = PaperPlan(options.out, options.scenes, options.real, options.quick, frames, steps)
    print(plan.about, flush=True)
    if plan.quick:
        print(f"time: {_QUICK_TIME}", flush=True)
    for step in steps_of(plan):
        print("simnfnd " + " ".join(step), flush=True)
        if code := run(step):
            print("stopped; the same command goes on from here", file=sys.stderr)
            return code
    print(written(plan))
    return 0


def run(words: Sequence[str]) -> int:
    """`simnfnd WORDS` in a process of its own; its exit code."""
    return subprocess.run([sys.executable, "-m", "simnfnd", *words], check=False).returncode


def steps_of(plan: PaperPlan) -> Iterator[list[str]]:
    """The commands, in their order."""
    dataset = f"dataset.dir={quote(str(plan.out / 'dataset'))}"
    make = ["make", "experiment=simnfnd", f"frames.variants={1 + plan.quick}", dataset]
    if plan.scenes is None:
        # Four frames of each place; a quarter of the places tests.
        places = max(plan.frames // 4, 4)
        make += ["scenes=seabed", "split.test=[]", f"scenes.locations={places}"]
        make.append(f"scenes.frames_per_location={-(-plan.frames // places)}")
    else:
        make.append(f"scenes.root={quote(str(plan.scenes))}")
    yield [*make, f"frames.total={plan.frames}", f"render={'analytic' if plan.quick else 'cycles'}"]
    ablation = {"simnfnd_l1": [dataset, "loss=l1"], "simnfnd_newloss": [dataset, *_NEWLOSS]}
    if plan.real is not None:
        ablation["olddata_l1"] = [*_olddata(plan.real), "loss=l1"]
    trainings = {**ablation, _RIVAL: [dataset, f"model={_RIVAL}", "loss=l1"]}
    for name, words in trainings.items():
        check = min(plan.steps, 200)
        patch = 64 if plan.quick else 128
        yield [
            "train", *words, f"name={name}", f"out={quote(str(plan.out / name))}",
            f"train.steps={plan.steps}", f"train.check_every={check}", f"data.patch={patch}",
        ]  # fmt: skip
    weights = [f"ablation.{name}={quote(str(plan.out / name))}" for name in ablation]
    rival = quote(str(plan.out / _RIVAL))
    report = f"out={quote(str(plan.out / 'report'))}"
    judge = ["evaluate", dataset, report, "baselines=[paper,lpmsde]", f"models=[{rival}]"]
    yield [*judge, "tuning.auto=false", *weights]
    if plan.real is not None:
        ours = quote(str(plan.out / "simnfnd_newloss"))
        yield [
            "evaluate", "real", str(_images_of(plan.real)), "baselines=[lpmsde]",
            f"models=[{rival},{ours}]", "groups=false", f"limit={_FIGURE_IMAGES}", "in_time=0",
            f"examples={_FIGURE_EXAMPLES}", f"out={quote(str(plan.out / 'figure14'))}",
        ]  # fmt: skip


def written(plan: PaperPlan) -> str:
    """Both tables as Markdown, also in tables.md.  FactoryError where it cannot be written."""
    content = json.loads((plan.out / "report" / REPORT_NAME).read_text(encoding="utf-8"))
    ours = "ours (quick)" if plan.quick else "ours"
    parts = [plan.about]
    for number in (2, 3):
        table = beside_paper(content[f"table_{number}"]).rename(columns={"ours": ours})
        parts += [f"## Table {number}", as_markdown(table, "lrrl")]
    parts += ["## Figure 14", _figure_14(plan, content["rows"])]
    text = "\n\n".join(parts)
    title = "# Tables 2 and 3 and Figure 14 of the paper"
    write_files(plan.out, {"tables.md": f"{title}\n\n{text}\n"})
    return text


def _figure_14(plan: PaperPlan, rows: Sequence[Mapping[str, Any]]) -> str:
    """The methods of the figure on the test pairs, and where real images are shown."""
    lines = []
    for row in rows:
        if row["label"] not in ("noisy", *_FIGURE_ROWS) or row["lost"] is not None:
            continue
        means = {name: metric["mean"] for name, metric in row["metrics"].items()}
        psnr_db = f"{means['psnr']:.2f}"
        lines.append([_FIGURE_ROWS.get(row["label"], "as made"), psnr_db, f"{means['ssim']:.3f}"])
    table = as_markdown(as_table(["method", "PSNR, dB", "SSIM"], lines), "lrr")
    note = "Real images: none, without `--real`."
    if plan.real is not None:
        note = f"Real images, which have no truth: `{plan.out / 'figure14' / 'real.html'}`."
    return f"{table}\n\n{note}"


def _olddata(folder: Path) -> list[str]:
    """Real images taken as clean; where their fans are says a table beside them."""
    words = ["data=olddata", f"data.folder={quote(str(_images_of(folder)))}"]
    table = folder / "fan_geometry.csv"
    return [*words, f"data.geometry={quote(str(table))}"] if table.is_file() else words


def _images_of(folder: Path) -> Path:
    """The folder of images of the Marine Debris Dataset, or the folder itself."""
    return folder / "Images" if (folder / "Images").is_dir() else folder
