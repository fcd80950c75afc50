"""The report on real images: real.json, real.md, real.html and results.csv."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ...factory.common.files import check_writable
from ...factory.common.workers.tasks import TaskPool
from ..judging.recorded import frame_of, open_input
from ..judging.runner import SECONDS
from ..judging.settings import RealSettings
from ..metrics.measure import METRICS, Metric
from ..report.document import ComparedImages, Section, compared, publish, write_files
from ..report.tables import (
    Content,
    difference_column,
    has,
    mean_column,
    table_of,
    with_interval,
    written,
)
from .groups import MOST, MOST_OTHERS
from .in_time import wide
from .judge import RealOutcome, judge

_RATIOS = ("ratio_mean", "ratio_variance", "ratio_correlation")

TRUTH = (
    f"The truth of a frame is the mean of the other frames of its group (of the {MOST_OTHERS} "
    "nearest in time). PSNR and SSIM: inside the sector, without its rim and moving objects, after "
    "one gain and offset an image; means over groups, with 95 % bootstrap intervals that draw "
    "groups. Filters are tuned on every other group and judged on the others. CPU s: the median."
)
IN_TIME = (
    "Every second frame is input; the reference is the mean of the frames between, so a method may "
    "use a window of any length. static: the frames as they are; moving: a window that travels by "
    "whole pixels; ghost: over them a bright speckled object, judged where it is. Means over "
    "recordings, with 95 % bootstrap intervals that draw recordings. Registered: shifted by whole "
    "pixels to the peak of the phase correlation."
)
RULE = (
    "None of the figures without a truth ranks methods alone: blur raises ENL and CNR, and doing "
    "nothing keeps all edges. Ratio image: recorded / denoised, which should be noise alone: mean "
    "1, and no correlation 4 pixels apart, where structure was taken along."
)


def evaluate(settings: RealSettings) -> None:
    """Measure, print the table and write the report.  Raises FactoryError."""
    stretches, notes = open_input(settings.real, MOST)
    check_writable(settings.folder, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(settings, stretches, pool)
    frame_of.cache_clear()
    write(settings, [*notes, *outcome.notes], outcome)


def write(settings: RealSettings, notes: Sequence[str], outcome: RealOutcome) -> None:
    """Write the files and print the tables.  FactoryError when the folder cannot be written to."""
    warnings = [note for note in notes if note.startswith("warning: ")]
    others = [note for note in notes if note not in warnings]
    judged = f"{len(outcome.shots)} images judged"
    about = " ".join(f"{'; '.join(lines)}." for lines in (warnings, [judged, *others]) if lines)
    rules = (TRUTH, RULE) if outcome.groups else (RULE,)
    best = dict.fromkeys(f"`{label}`" for label in outcome.best.values())
    verdict = f"The best filter (PSNR, SSIM): {', '.join(best)}." if best else ""
    title = "Figures" if outcome.groups else "Figures without a truth"
    sections = [
        Section(title, [table_of(outcome.rows, _columns(outcome.rows))], [verdict], printed=True)
    ]
    in_time = outcome.in_time.table
    if not in_time.empty:
        table = wide(in_time, resamples=settings.bootstrap, seed=settings.seed)
        sections.append(Section("In time", [table], [IN_TIME], printed=True))
    publish(
        settings.folder,
        "real",
        f"Real sonar: {settings.name}",
        about,
        [*sections, Section("How to read them", text=rules)],
        facts={
            "schema": "simnfnd-real/3",
            "name": settings.name,
            "files": [shot.name for shot in outcome.shots],
            "groups": _groups(outcome),
            "best_filter": outcome.best,
            "in_time": in_time.to_dict(orient="records"),
            "notes": notes,
            "rows": outcome.rows,
            "rules": rules,
        },
        examples=_examples(outcome),
    )
    results = outcome.measured.table()
    results.insert(1, "file", [outcome.shots[number].name for number in results["picture"]])
    text = results.drop(columns=["picture"]).to_csv(index=False, lineterminator="\n")
    write_files(settings.folder, {"results.csv": text})


def _columns(rows: Sequence[Content]) -> dict[str, Callable[[Content], str]]:
    """Head -> cell of a row: likeness to the truth where there is one, and figures without it."""
    columns: dict[str, Callable[[Content], str]] = {}
    if has(rows, "psnr"):
        for name in ("psnr", "ssim"):
            columns[METRICS[name].label] = mean_column(name, METRICS[name], bounds=True)
        columns["gain, dB"] = lambda row: written(row["metrics"]["gain_db"]["mean"], 2, True)
        for name, head, digits in (
            ("psnr", "ahead of the best filter, dB", 2),
            ("ssim", "ahead of it, SSIM", 3),
        ):
            columns[head] = difference_column("against_best", name, _margin(digits))
    without_truth = {
        "enl": METRICS["enl"],
        "cnr": Metric("CNR dark ground"),
        "edges_kept": Metric("edges kept"),
        **{name: METRICS[name] for name in _RATIOS},
    }
    columns |= {metric.label: mean_column(name, metric) for name, metric in without_truth.items()}
    columns["CPU s an image"] = lambda row: written(row[SECONDS], 3)
    return columns


def _margin(digits: int) -> Callable[[Mapping[str, Any]], str]:
    return lambda difference: with_interval(difference, digits, True)


def _groups(outcome: RealOutcome) -> list[dict[str, Any]]:
    """The static groups as plain data."""
    return [
        {
            "name": group.name,
            "frames": [shot.name for shot in group.shots],
            "judged": [group.shots[place].name for place in part.judged],
            "fold": part.fold,
            "largest_shift_px": group.largest_px,
            "judged_share_of_sector": group.still,
            "geometry": "unknown" if group.geometry is None else group.geometry.layout,
        }
        for group, part in zip(outcome.groups, outcome.parts, strict=True)
    ]


def _examples(outcome: RealOutcome) -> list[ComparedImages]:
    """What the rows made of some images."""
    examples = []
    for number, judged in sorted(outcome.examples.items()):
        title = judged.shot.name
        if judged.group is not None:
            title = f"{outcome.groups[judged.group].name}: {title}"
        labels = [row["label"] for row in outcome.rows]
        truth = judged.reference
        examples.append(
            compared(outcome.measured, number, title, labels, "mean of the other frames", truth)
        )
    return examples
