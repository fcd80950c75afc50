"""Measure the figures of README.md anew: `python -m tools.readme_figures`.

It runs the commands that README.md names, keeps their figures in docs/figures.json, writes tables
between two marks of README.md, paper/paper.md and two pages of the docs, and draws
docs/images/in-time.png.
`--reports FOLDER` takes the reports that lie in FOLDER/real, FOLDER/detect and FOLDER/groups;
what is absent is measured.  `--groups FOLDER`: the static groups of the Marine Debris Dataset;
without them their figures stay as they are.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from simnfnd import denoise
from simnfnd.command import main as simnfnd
from simnfnd.evaluation.filters.windows import registered_mean
from simnfnd.factory.common.array_types import Float32s
from simnfnd.models.recordings.views import frame_image

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "didson" / "lamprey.avi"
FIGURES = ROOT / "docs" / "figures.json"
README = ROOT / "README.md"
PAPER = ROOT / "paper" / "paper.md"
EVALUATION = ROOT / "docs" / "evaluation.md"
RECORDINGS = ROOT / "docs" / "how-to" / "recordings.md"
SPEED = ROOT / "docs" / "speed.md"
IMAGE = ROOT / "docs" / "images" / "in-time.png"
MARKS = "<!-- figures: python -m tools.readme_figures -->", "<!-- /figures -->"

COMMANDS = {
    "real": "simnfnd evaluate real examples/didson/lamprey.avi models=[simnfnd]",
    "detect": "simnfnd evaluate targets examples/didson/lamprey.avi",
    "groups": "simnfnd evaluate real mdd-groups models=[simnfnd]",
}
SPEED_COMMAND = "python -m benchmarks command --frame FLSEA"

_GAUSSIAN = "gaussian (sigma_px=1.5)"
_KEPT_DIGITS = 7  # of which the lines show three at most: rounded once, as in the reports

_PROBE_FRAMES = range(11, 26)  # of the example
_PROBED = 18
_AWAY = 3  # frames nearer than this are a denoiser's, not the reference's
_LIT = 8 / 255
_CROPS = (slice(20, 380), slice(20, 380)), (slice(230, 350), slice(120, 240))
_CROP_PX = 240
_GAP_PX = 4
_CAPTION_PX = 24

Figures = dict[str, Any]


def example_frames() -> Float32s:
    """(N, H, W) float32 in 0..1: some frames of the recording that ships."""
    return np.stack([frame_image(EXAMPLE, number)[0] for number in _PROBE_FRAMES])


def probe() -> dict[str, float]:
    """PSNR of a frame of the example alone and in time, dB, against frames outside its window.

    Measured in seconds, so that a test can tell whether the denoiser is still the one whose figures
    are kept.
    """
    frames = example_frames()
    middle = _PROBED - _PROBE_FRAMES.start
    reference = _mean_outside(frames, middle)
    lit = reference > _LIT

    def psnr_db(image: Float32s) -> float:
        return round(float(-10 * np.log10(((image - reference)[lit] ** 2).mean())), 3)

    single = denoise(frames[middle])
    in_time = denoise(frames)[middle]
    return {"single_db": psnr_db(single), "in_time_db": psnr_db(in_time)}


def measured(reports: Path, groups: Path | None, before: Mapping[str, Any]) -> Figures:
    """All figures, from reports in a folder; those that are not there are made.

    before: the figures so far, of which those of the groups are kept where `groups` is None.
    """
    inputs = {"real": EXAMPLE, "detect": EXAMPLE, "groups": groups}
    contents: dict[str, Any] = {}
    for name, source in inputs.items():
        report = reports / name / ("targets.json" if name == "detect" else "real.json")
        if source is None:
            continue
        if not report.is_file():
            words = COMMANDS[name].split()[1:3]
            models = [] if name == "detect" else ["models=[simnfnd]"]
            if code := simnfnd([*words, str(source), *models, f"out={report.parent}"]):
                raise SystemExit(code)
        contents[name] = json.loads(report.read_text(encoding="utf-8"))
    figures: Figures = {
        "real": {**_in_time(contents["real"]), **_single(contents["real"])},
        "detect": _targets(contents["detect"]),
        "groups": _single(contents["groups"]) if groups else before["groups"],
        "probe": probe(),
    }
    return figures


def tables(figures: Mapping[str, Any]) -> dict[Path, str]:
    """Page -> the table between its marks."""
    readme = readme_table(figures)
    return {
        README: readme,
        PAPER: without_links(readme),
        EVALUATION: targets_table(figures),
        RECORDINGS: in_time_table(figures),
    }


def readme_table(figures: Mapping[str, Any]) -> str:
    """The five figures of README.md."""
    real = figures["real"]
    static = real["static"]
    moving = real["moving"]
    targets = figures["detect"]
    groups = figures["groups"]
    best = groups["best"]
    window = _window_of(real)
    mean = f"mean of {window} + tuned TV"
    rows = [
        [
            "[Recording, static scene](docs/how-to/recordings.md#figures): PSNR / SSIM",
            _scores(static["simnfnd: fused and denoised"]),
            f"{_scores(static[mean])} (mean of {window} frames + TV), "
            f"{_scores(static['simnfnd: one frame'])} (single frames)",
            f"`{COMMANDS['real']}`",
        ],
        [
            "Recording, moving sonar: PSNR / SSIM",
            _scores(moving["simnfnd: fused and denoised"]),
            f"{_scores(moving[f'registered {mean}'])} (registered mean + TV), "
            f"{_scores(moving[mean])} (not registered)",
            "the same",
        ],
        [
            "[Contrast retained](docs/evaluation.md#moving-targets) for inserted targets",
            _share(targets[_fused_row(targets)]["contrast"]),
            f"{_share(targets['simnfnd, single frames']['contrast'])} (single frames), "
            f"{_share(targets[_GAUSSIAN]['contrast'])} (Gaussian of 1.5 px)",
            f"`{COMMANDS['detect']}`",
        ],
        [
            "[Single frames](docs/evaluation.md#real-images) of an ARIS: PSNR / SSIM",
            _scores(groups["simnfnd"]),
            f"{_scores(groups[best])} ({best.split()[0].upper()}, the best tuned filter)",
            f"`{COMMANDS['groups']}`",
        ],
        [
            "[CPU time](docs/speed.md) of a cold FLSea pair in closed form",
            f"1/{_rounded_times_less()}",
            "1 (the paper's recipe taken literally)",
            f"`{SPEED_COMMAND}`",
        ],
    ]
    return _table(["figure", "SimNFND", "for comparison", "measured by"], rows)


def targets_table(figures: Mapping[str, Any]) -> str:
    """What denoising leaves of targets inserted into the recording that ships."""
    targets = figures["detect"]
    fused = _fused_row(targets)
    labels = {
        "recorded": "as recorded",
        fused: f"`simnfnd denoise` ({fused.partition(', ')[2]})",
        "simnfnd, single frames": "`--frames 1`",
        _GAUSSIAN: "Gaussian of 1.5 px",
    }
    has_alarms = all("false_alarms" in targets[row] for row in labels)
    rows = []
    for row, label in labels.items():
        scores = targets[row]
        cells = [_share(scores["contrast"]), f"{scores['auc']:.3f}", _share(scores["detection"])]
        if has_alarms:
            cells.append(f"{scores['false_alarms']:.2f}")
        rows.append([label, *cells])
    head = ["", "contrast", "AUC", "detection", "false alarms per frame"]
    return _table(head[: len(rows[0])], rows, numbers_from=1)


def in_time_table(figures: Mapping[str, Any]) -> str:
    """PSNR and SSIM of the recording that ships, for a sonar at rest and a moving one."""
    real = figures["real"]
    window = _window_of(real)
    labels = {
        "simnfnd: one frame": "`--frames 1`",
        "fused": f"{window} frames, fused alone",
        "simnfnd: fused and denoised": f"`simnfnd denoise` ({window} frames)",
    }
    for words in ("mean of {}{}", "mean of {}{} + tuned TV", "registered mean of {}{} + tuned TV"):
        labels[words.format(window, "")] = words.format(window, " frames")
    rows = [
        [label, _scores(real["static"][row]), _scores(real["moving"][row])]
        for row, label in labels.items()
    ]
    return _table(["PSNR / SSIM", "sonar at rest", "moving sonar"], rows, numbers_from=1)


def _window_of(real: Mapping[str, Any]) -> int:
    """Number of frames that the means of a report on a recording are taken over."""
    (mean,) = [label for label in real["static"] if re.fullmatch(r"mean of \d+", label)]
    return int(mean.split()[-1])


def _fused_row(targets: Mapping[str, Any]) -> str:
    """Label of the network on several frames."""
    (label,) = [label for label in targets if re.fullmatch(r"simnfnd, \d+ frames", label)]
    return label


def _table(heading: list[str], rows: list[list[str]], numbers_from: int | None = None) -> str:
    """A Markdown table; columns from `numbers_from` on are aligned to the right."""
    right = len(heading) if numbers_from is None else numbers_from
    rule = ["---"] * right + ["---:"] * (len(heading) - right)
    lines = [f"| {' | '.join(cells)} |" for cells in (heading, *rows)]
    lines.insert(1, f"|{'|'.join(rule)}|")
    return "\n".join(lines) + "\n"


def row_figures(page: Path, heading: str, label: str) -> list[str]:
    """The last two figures of a row of the table under a heading; of a cell the first."""
    table = page.read_text(encoding="utf-8").split(f"\n{heading}\n")[1].split("\n\n")[0]
    (row,) = re.findall(rf"^\| {re.escape(label)} \|(.*)\|$", table, re.M)
    cells = [cell.split("(")[0].split("/")[0].strip() for cell in row.split("|")]
    return [cell for cell in cells if re.fullmatch(r"\d*\.\d+|\d+", cell)][-2:]


def _rounded_times_less() -> int:
    """How many times less CPU a cold FLSea frame takes, from the table of docs/speed.md."""
    heading = "| | CPU s | literal recipe over this | three runs |"
    median = row_figures(SPEED, heading, "FLSea, closed form, cold")[-1]
    return 10 * round(float(median) / 10)


def without_links(text: str) -> str:
    """The text of all links, for a page that stands alone."""
    return re.sub(r"\[([^\]]+)\]\([^)]+\)", r"\1", text)


def with_lines(page: str, lines: str) -> str:
    """A page with these lines between its marks."""
    first, last = MARKS
    pattern = re.compile(f"{re.escape(first)}\n.*?{re.escape(last)}", re.DOTALL)
    return pattern.sub(lambda _: f"{first}\n{lines}{last}", page)


def draw_image() -> None:
    """docs/images/in-time.png: a frame of the example by every way, whole and in detail."""
    frames = example_frames()
    middle = _PROBED - _PROBE_FRAMES.start
    images = {
        "as recorded": frames[middle],
        "single frame": denoise(frames[middle]),
        "in time": denoise(frames)[middle],
        "registered mean of 7": registered_mean(frames, middle, _AWAY),
        "mean of the others": _mean_outside(frames, middle),
    }
    side = _CROP_PX
    width = len(images) * (side + _GAP_PX) - _GAP_PX
    height = _CAPTION_PX + len(_CROPS) * (side + _GAP_PX) - _GAP_PX
    sheet = np.full((height, width), 24, np.uint8)
    font = cv2.FONT_HERSHEY_SIMPLEX
    for column, (name, image) in enumerate(images.items()):
        left = column * (side + _GAP_PX)
        cv2.putText(sheet, name, (left + 4, 17), font, 0.45, (235,), 1, cv2.LINE_AA)
        for row, crop in enumerate(_CROPS):
            top = _CAPTION_PX + row * (side + _GAP_PX)
            brightest = np.quantile(frames[middle][crop], 0.998)
            pixels = np.clip(image[crop] / brightest, 0, 1) * 255
            interpolation = cv2.INTER_AREA if pixels.shape[0] > side else cv2.INTER_NEAREST
            sheet[top : top + side, left : left + side] = cv2.resize(
                pixels.astype(np.float32), (side, side), interpolation=interpolation
            )
    cv2.imwrite(str(IMAGE), sheet)


def _mean_outside(frames: Float32s, middle: int) -> Float32s:
    """Mean of the frames that no window around one holds."""
    outside = [number for number in range(len(frames)) if abs(number - middle) > _AWAY]
    return np.asarray(frames[outside].mean(axis=0), np.float32)


def _in_time(report: Mapping[str, Any]) -> Figures:
    """Kind of input -> row -> PSNR and SSIM."""
    figures: Figures = {}
    for row in report["in_time"]:
        figures.setdefault(row["kind"], {})[row["row"]] = _kept(row["psnr"], row["ssim"])
    return figures


def _single(report: Mapping[str, Any]) -> Figures:
    """Row -> PSNR and SSIM of the best filter and the network; and which filter is the best."""
    metrics = {row["label"]: row["metrics"] for row in report["rows"] if row["lost"] is None}
    best = report["best_filter"]["psnr"]
    figures: Figures = {"best": best}
    for label in (best, "simnfnd"):
        figures[label] = _kept(*(metrics[label][name]["mean"] for name in ("psnr", "ssim")))
    return figures


def _kept(psnr_db: float, ssim: float) -> Figures:
    return {"psnr_db": round(psnr_db, _KEPT_DIGITS), "ssim": round(ssim, _KEPT_DIGITS)}


def _targets(report: Mapping[str, Any]) -> Figures:
    """Row -> AUC, contrast, detection and false alarms."""
    return {
        row["label"]: {
            name: round(row[name]["value"], _KEPT_DIGITS)
            for name in ("auc", "contrast", "detection", "false_alarms")
        }
        for row in report["rows"]
    }


def _scores(scores: Mapping[str, float]) -> str:
    return f"{scores['psnr_db']:.2f} dB / {scores['ssim']:.3f}"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


def write_tables(figures: Mapping[str, Any]) -> None:
    """Write the tables of all pages."""
    for page, table in tables(figures).items():
        text = page.read_text(encoding="utf-8")
        page.write_text(with_lines(text, table), encoding="utf-8")


def main() -> None:
    """Measure, and write all files."""
    parser = argparse.ArgumentParser(prog="python -m tools.readme_figures")
    parser.add_argument("--reports", type=Path, default=ROOT / "outputs" / "figures")
    parser.add_argument("--groups", type=Path)
    chosen = parser.parse_args()
    before = json.loads(FIGURES.read_text(encoding="utf-8"))["figures"]
    figures = measured(chosen.reports, chosen.groups, before)
    content = json.dumps({"commands": COMMANDS, "figures": figures}, indent=1)
    FIGURES.write_text(content + "\n", encoding="utf-8")
    write_tables(figures)
    draw_image()
    print(readme_table(figures))


if __name__ == "__main__":
    main()
