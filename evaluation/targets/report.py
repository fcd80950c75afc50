"""The report on targets: targets.json, targets.md, targets.html, curves.svg and crops.png."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable
from ...factory.common.plots import Curve, Plot, draw_plots
from ...factory.common.workers.tasks import TaskPool
from ..judging.recorded import Stretch, frame_of, open_input
from ..judging.settings import TargetsSettings
from ..metrics.statistics import FigureEstimate
from ..report.document import Drawing, Section, publish
from ..report.tables import figure, plain, table_of, written
from .judge import DetectionOutcome, judge
from .scores import CURVE_ALARMS, CURVE_RATES, ClassFigures, MethodFigures
from .sheet import crop_sheet
from .targets import classes_of

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = "simnfnd-targets/1"

_ALARMS = "false alarms per frame"

HOW = (
    "Targets of known position are inserted into the recording: ellipses of the smoothed scene, "
    "raised by their contrast (in standard deviations of the local grain), with grain from "
    "elsewhere in the same frame. The twin sequence gets the same grain with zero contrast. "
    "Both are denoised.",
    "AUC: a matched filter at the known position, target against twin (1: all information is "
    "left, .5: none). Contrast: part of the recorded contrast that is retained. Detection: part of "
    "the targets found at one false alarm per frame by a common detector (scene mean subtracted, "
    "2 px smoothing, divided by the usual change of each place); real motion is not counted. "
    "False alarms: per frame without targets, at the threshold that gives one in recorded frames.",
    "Ratio correlation: of pixels 4 apart in the image recorded / denoised; structure that was "
    "removed raises it.",
    "Means over classes. 95 % bootstrap intervals that draw tracks, not frames (false alarms: "
    "blocks of frames). Filters called tuned have the best PSNR on these recordings without "
    "targets.",
)


def evaluate(settings: TargetsSettings) -> None:
    """Measure, print the table and write the report.  Raises FactoryError."""
    stretches: list[Stretch] = []
    for path in settings.recordings:
        opened, _ = open_input(path, key="recordings")
        stretches += opened
    if len({stretch.name for stretch in stretches}) < len(stretches):
        raise FactoryError("recordings: two have one name; give each once, in one folder")
    check_writable(settings.folder, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(settings, stretches, pool)
    frame_of.cache_clear()
    write(settings, outcome)


def write(settings: TargetsSettings, outcome: DetectionOutcome) -> None:
    """Write the files and print the table."""
    frame_count = sum(len(twins.with_targets) for twins in outcome.sequences)
    track_count = sum(len(twins.tracks) for twins in outcome.sequences)
    names = ", ".join(dict.fromkeys(twins.name for twins in outcome.sequences))
    about = f"{names}: {frame_count} frames with {track_count} moving targets. "
    about += "".join(f"{note}. " for note in outcome.notes)
    table = overall_table(outcome)
    labels = list(outcome.figures)
    curves = draw_plots(_plots(outcome.figures))
    drawings = [Drawing("curves.svg", "What each method leaves to find", curves)]
    if outcome.examples:
        sheet = crop_sheet(outcome.examples, labels)
        drawings.append(
            Drawing(
                "crops.png",
                "One target of each class; below each image what the target adds to it",
                sheet,
            )
        )
    sections = [
        Section("Targets", [table], printed=True),
        Section("Each class of size and contrast", [class_table(settings, outcome)]),
        Section("Curves and crops", drawings=drawings),
        Section("How it was measured", text=HOW),
    ]
    publish(
        settings.folder,
        "targets",
        f"Targets in {names}",
        about.strip(),
        sections,
        facts=_facts(settings, outcome),
    )


def overall_table(outcome: DetectionOutcome) -> pd.DataFrame:
    """Means over classes with their intervals, a line for each method."""
    return table_of(
        _table_rows(outcome),
        {
            "AUC": lambda row: figure(row["figures"].overall.auc),
            "contrast": lambda row: figure(row["figures"].overall.contrast),
            "detection": lambda row: figure(row["figures"].overall.detection),
            "against recorded": lambda row: figure(
                row["figures"].overall.detection_gain, sign=True
            ),
            _ALARMS: lambda row: figure(row["figures"].false_alarms),
            "ratio correlation": lambda row: written(
                outcome.ratios[row["label"]]["ratio_correlation"], 3
            ),
        },
    )


def class_table(settings: TargetsSettings, outcome: DetectionOutcome) -> pd.DataFrame:
    """AUC / contrast / detection of each class, a line for each method."""

    def cell_of(number: int) -> Callable[[Mapping[str, Any]], str]:
        return lambda row: " / ".join(
            written(estimate.value, 2) for estimate in row["figures"].by_class[number][:3]
        )

    classes = classes_of(settings.sizes, settings.contrasts)
    columns = {target.label: cell_of(number) for number, target in enumerate(classes)}
    columns[_ALARMS] = lambda row: written(row["figures"].false_alarms.value, 2)
    alive = [row for row in _table_rows(outcome) if row["lost"] is None]
    return table_of(alive, columns, "AUC / contrast / detection")


def _table_rows(outcome: DetectionOutcome) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = [
        {"label": label, "parameters": [], "lost": None, "figures": figures}
        for label, figures in outcome.figures.items()
    ]
    lost = [
        {"label": label, "parameters": [], "lost": reason} for label, reason in outcome.lost.items()
    ]
    return [*rows, *lost]


def _plots(figures: dict[str, MethodFigures]) -> Sequence[Plot]:
    """Detections over false alarms, and ROC curves of the matched filter."""
    return (
        Plot(
            title="Detector",
            x_label="false alarms per frame",
            y_label="targets found",
            curves={label: Curve(CURVE_ALARMS, row.curve) for label, row in figures.items()},
            ticks=(0.1, 0.3, 1, 3, 10),
            is_logarithmic=True,
            y_limits=(0, 1),
        ),
        Plot(
            title="Matched filter (ROC)",
            x_label="false-positive rate",
            y_label="true-positive rate",
            curves={label: Curve(CURVE_RATES, row.roc) for label, row in figures.items()},
            y_limits=(0, 1),
        ),
    )


def _facts(settings: TargetsSettings, outcome: DetectionOutcome) -> dict[str, Any]:
    """The content of targets.json."""
    classes = classes_of(settings.sizes, settings.contrasts)
    return {
        "schema": SCHEMA,
        "sequences": [
            {
                "name": twins.name,
                "frames": len(twins.with_targets),
                "tracks": len(twins.tracks),
            }
            for twins in outcome.sequences
        ],
        "classes": [target._asdict() for target in classes],
        "speed_px": settings.speed_px,
        "seed": settings.seed,
        "rows": [
            {
                "label": label,
                **_plain_figures(figures.overall),
                "false_alarms": _plain_estimate(figures.false_alarms),
                **{name: plain(value) for name, value in outcome.ratios[label].items()},
                "classes": {
                    target.label: _plain_figures(of_class)
                    for target, of_class in zip(classes, figures.by_class, strict=True)
                },
                "detection_at_false_alarms": dict(
                    zip(map(str, CURVE_ALARMS), map(plain, figures.curve), strict=True)
                ),
            }
            for label, figures in outcome.figures.items()
        ],
        "lost": outcome.lost,
        "notes": outcome.notes,
        "rules": HOW,
    }


def _plain_figures(figures: ClassFigures) -> dict[str, dict[str, float | None]]:
    return {name: _plain_estimate(estimate) for name, estimate in figures._asdict().items()}


def _plain_estimate(estimate: FigureEstimate) -> dict[str, float | None]:
    return {name: plain(value) for name, value in estimate._asdict().items()}
