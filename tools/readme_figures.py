"""Measure the figures of README.md anew: `python -m tools.readme_figures`.

It runs the commands that README.md names, keeps what they say in docs/figures.json, writes the
lines of README.md and paper/paper.md between two marks and draws docs/images/in-time.png.
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
import numpy.typing as npt

from simnfnd import denoise
from simnfnd.command import main as simnfnd
from simnfnd.evaluation.filters.windows import registered_mean
from simnfnd.models.recordings.views import frame_image

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "didson" / "lamprey.avi"
FIGURES = ROOT / "docs" / "figures.json"
README = ROOT / "README.md"
PAPER = ROOT / "paper" / "paper.md"
IMAGE = ROOT / "docs" / "images" / "in-time.png"
MARKS = "<!-- figures: python -m tools.readme_figures -->", "<!-- /figures -->"

COMMANDS = {
    "real": "simnfnd evaluate real examples/didson/lamprey.avi models=[simnfnd]",
    "detect": "simnfnd evaluate detect examples/didson/lamprey.avi",
    "groups": "simnfnd evaluate real mdd-groups models=[simnfnd]",
}

_KEPT_DIGITS = 7  # of which the lines show three at most: rounded once, as in the reports

_PROBE_FRAMES = range(11, 26)  # of the example
_PROBED = 18
_AWAY = 3  # frames nearer than this are a denoiser's, not the reference's
_LIT = 8 / 255
_CROPS = (slice(20, 380), slice(20, 380)), (slice(230, 350), slice(120, 240))
_CROP_PX = 240
_GAP_PX = 4
_CAPTION_PX = 24

Frames = npt.NDArray[np.float32]
Figures = dict[str, Any]


def example_frames() -> Frames:
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

    def psnr_db(image: Frames) -> float:
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
        report = reports / name / ("detect.json" if name == "detect" else "real.json")
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


def lines_of(figures: Mapping[str, Any]) -> str:
    """The lines of README.md between its marks."""
    real = figures["real"]
    targets = figures["detect"]
    groups = figures["groups"]
    static = real["static"]
    moving = real["moving"]
    recorded = targets["recorded"]
    gaussian = targets["gaussian (sigma_px=1.5)"]
    single = targets["simnfnd, single frames"]
    in_time = targets["simnfnd, 7 frames"]
    return f"""\
- **Recordings** (`{COMMANDS["real"]}`). On a DIDSON recording that no weights learned from, `simnfnd denoise` reaches {_scores(static["simnfnd: fused and denoised"])} against frames outside its window; the mean of seven frames with tuned total variation {_scores(static["registered mean of 7 + tuned TV"])}, `simnfnd` on single frames {_scores(static["simnfnd: one frame"])}. Under a moving sonar it keeps {_scores(moving["simnfnd: fused and denoised"])}; the mean of seven falls to {moving["mean of 7 + tuned TV"]["psnr_db"]:.1f} dB, and reaches {_scores(moving["registered mean of 7 + tuned TV"])} where whole frames are registered first. The recording was in sight during development. [Recordings](docs/how-to/recordings.md)
- **Moving targets** (`{COMMANDS["detect"]}`). Of the contrast of small and large targets inserted into that recording, `simnfnd denoise` retains {_share(in_time["contrast"])} and single frames (`--frames 1`) {_share(single["contrast"])}; a Gaussian of 1.5 px {_share(gaussian["contrast"])}. A matched filter's AUC is {in_time["auc"]:.3f} and {single["auc"]:.3f} (recorded: {recorded["auc"]:.3f}); at one false alarm per frame {_share(in_time["detection"])} and {_share(single["detection"])} of the targets are detected (recorded: {_share(recorded["detection"])}). [Moving targets](docs/evaluation.md#moving-targets)
- **Single frames** (`{COMMANDS["groups"]}`). On 19 nearly static groups of a real ARIS (Marine Debris Dataset, development data) `simnfnd` reaches {_scores(groups["simnfnd"])}; {groups["best"].split()[0].upper()}, the best filter, tuned on other groups, {_scores(groups[groups["best"]])}. [Evaluation](docs/evaluation.md)
"""  # noqa: E501


def without_links(lines: str) -> str:
    """The lines for a page that stands alone: without the link that ends each."""
    return re.sub(r" \[[^\]]+\]\([^)]+\)$", "", lines, flags=re.MULTILINE)


def with_lines(readme: str, lines: str) -> str:
    """A page with these lines between its marks."""
    first, last = MARKS
    pattern = re.compile(f"{re.escape(first)}\n.*?{re.escape(last)}", re.DOTALL)
    return pattern.sub(lambda _: f"{first}\n{lines}{last}", readme)


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


def _mean_outside(frames: Frames, middle: int) -> Frames:
    """Mean of the frames that no window around one holds."""
    outside = [number for number in range(len(frames)) if abs(number - middle) > _AWAY]
    return np.asarray(frames[outside].mean(axis=0), np.float32)


def _in_time(report: Mapping[str, Any]) -> Figures:
    """Kind of input -> row -> PSNR and SSIM."""
    figures: Figures = {}
    for row in report["in_time"]:
        scores = {name: round(row[name], _KEPT_DIGITS) for name in ("psnr_db", "ssim")}
        figures.setdefault(row["kind"], {})[row["row"]] = scores
    return figures


def _single(report: Mapping[str, Any]) -> Figures:
    """Row -> PSNR and SSIM of the best filter and the network; and which filter is the best."""
    rows = {row["label"]: row["means"] for row in report["rows"] if row["means"]}
    best = report["best_filter"]["psnr_db"]
    return {
        "best": best,
        **{
            label: {name: round(rows[label][name], _KEPT_DIGITS) for name in ("psnr_db", "ssim")}
            for label in (best, "simnfnd")
        },
    }


def _targets(report: Mapping[str, Any]) -> Figures:
    """Row -> AUC, contrast and detection."""
    return {
        row["label"]: {
            name: round(row[name]["value"], _KEPT_DIGITS)
            for name in ("auc", "contrast", "detection")
        }
        for row in report["rows"]
    }


def _scores(scores: Mapping[str, float]) -> str:
    return f"{scores['psnr_db']:.2f} dB / {scores['ssim']:.3f}"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"


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
    readme = README.read_text(encoding="utf-8")
    README.write_text(with_lines(readme, lines_of(figures)), encoding="utf-8")
    paper = PAPER.read_text(encoding="utf-8")
    PAPER.write_text(with_lines(paper, without_links(lines_of(figures))), encoding="utf-8")
    draw_image()
    print(lines_of(figures))


if __name__ == "__main__":
    main()
