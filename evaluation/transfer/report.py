"""The report on transfer: transfer.json, transfer.md, transfer.html, curves.svg and sheet.png."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...factory.common.array_types import Int64s
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable
from ...factory.common.plots import Curve, Plot, draw_plots
from ...models.detection.detector import detect_in
from ...models.detection.runtime import DetectorRuntime
from ...models.detection.training import DETECTOR_NAME
from ..judging.settings import TransferReportSettings
from ..metrics.statistics import FigureEstimate
from ..report.document import Drawing, Section, publish
from ..report.tables import as_table, figure, plain, written
from .arms import BLOB, SIMULATION, Arm, Comparison, open_comparison, open_training
from .coco import RealImage, RealImages, read_coco
from .scores import (
    CURVE_ALARMS,
    Figures,
    Matches,
    difference,
    figures_of,
    group_draws,
    recall_at,
    threshold_at,
)
from .sheet import detection_sheet

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = "simnfnd-transfer/1"

HOW = (
    "AP50 and AP at IoU .3: average precision of pycocotools at one overlap of boxes. Recall at "
    "one false alarm: part of the objects found (IoU .5) at the threshold that lets one false "
    "detection per image pass. All objects count as one class, except in the table of classes. "
    "Detections on a box of an ignored class (IoU .3, or more than half of their area inside) do "
    "not count.",
    "Intervals: 95 % bootstrap that draws groups of images. Arms with real labels are "
    "cross-validated: a group is never split, and a detector never saw images of the groups it is "
    "judged on. The detector is a network of at most one million parameters, the same in all arms; "
    "it looks at each image in three sizes, mirrored and not.",
)


@dataclass(frozen=True, eq=False)
class JudgedArm:
    """An arm with its figures.

    matches: of all objects at IoU .5.  by_class: name -> figures; empty where an arm names no
    classes.  recall_of: name -> recall of its objects at one false alarm, whatever class is named.
    """

    arm: Arm
    figures: Figures
    matches: Matches
    by_class: Mapping[str, Figures]
    recall_of: Mapping[str, float]


def evaluate(settings: TransferReportSettings) -> None:
    """Train, judge, print the table and write the report.  Raises FactoryError.

    Without real images a detector is trained and judged on the test images of the dataset.
    """
    if settings.real is None and (settings.dataset.dir is None or not settings.classes):
        raise FactoryError(
            "real: give a folder of real images with boxes, or dataset=DIR and classes=[...] to "
            "train a detector alone (see `simnfnd evaluate transfer --help`)"
        )
    settings = settings.quickened()
    if settings.real is None:
        _train_alone(settings)
        return
    real = read_coco(
        settings.real,
        annotations=settings.annotations,
        ignore=settings.ignore,
        names=settings.class_names or {},
    )
    check_writable(settings.folder, "out")
    comparison = open_comparison(settings, real)
    groups = [image.labelled.group for image in real.images]
    draws = group_draws(groups, settings.bootstrap, settings.seed)
    judged = [judge_arm(arm, real, draws) for arm in comparison.arms()]
    write(settings, comparison, judged, draws)
    path = settings.folder / "simulation" / DETECTOR_NAME
    if path.is_file():
        print(f"detector: {path}")


def _train_alone(settings: TransferReportSettings) -> None:
    comparison = open_training(settings)
    check_writable(settings.folder, "out")
    comparison.trained = comparison.train_simulated()
    text = _simulated_text(_simulated_figures(comparison))
    if text:
        print(text)
    print(f"detector: {settings.folder / 'simulation' / DETECTOR_NAME}")


def judge_arm(arm: Arm, real: RealImages, draws: Int64s) -> JudgedArm:
    """The figures of an arm, for all objects and for each class."""
    images = real.images
    figures, matches = figures_of(images, arm.detections, None, draws)
    by_class: dict[str, Figures] = {}
    recall_of: dict[str, float] = {}
    threshold = threshold_at(matches, 1.0)
    for label, name in enumerate(real.classes):
        if not any((image.labelled.labels == label).any() for image in images):
            continue
        recall_of[name] = _class_recall(images, arm, label, threshold)
        if arm.has_classes:
            by_class[name], _ = figures_of(images, arm.detections, label, draws[:0])
    return JudgedArm(arm, figures, matches, by_class, recall_of)


def _class_recall(images: Sequence[RealImage], arm: Arm, label: int, threshold: float) -> float:
    """Part of the objects of a class that a detection above the threshold overlaps enough."""
    from .sheet import match_greedily

    found_count = 0
    object_count = 0
    for image, detections in zip(images, arm.detections, strict=True):
        is_class = image.labelled.labels == label
        object_count += int(is_class.sum())
        shown = detections.boxes[detections.scores > threshold]
        found_count += sum(
            bool(is_class[number]) for _, number in match_greedily(shown, image.labelled.boxes)
        )
    return found_count / object_count


def write(
    settings: TransferReportSettings,
    comparison: Comparison,
    judged: Sequence[JudgedArm],
    draws: Int64s,
) -> None:
    """Write the files and print the table."""
    real = comparison.real
    object_count = sum(len(image.labelled.boxes) for image in real.images)
    group_count = len({image.labelled.group for image in real.images})
    about = (
        f"{real.name}: {len(real.images)} real images of {group_count} groups with "
        f"{object_count} objects of {len(real.classes)} classes. "
    )
    if not real.has_groups:
        about += "The file names no groups: neighbouring images may make intervals too narrow. "
    if settings.quick:
        about += "A quick run: trainings are far too short for these figures to mean anything. "
    table = overall_table(judged, draws)
    shown = _shown_on_sheet(judged)
    sheet = (
        detection_sheet(
            real.images,
            shown.arm.detections,
            threshold_at(shown.matches, 1.0),
            settings.examples,
        )
        if settings.examples
        else None
    )
    drawings = [Drawing("curves.svg", "What each arm finds", draw_plots(_plots(judged)))]
    if sheet is not None:
        caption = (
            f"{shown.arm.label}, at one false alarm per image: found (green), missed (red), false "
            "alarms (yellow), ignored (grey)"
        )
        drawings.append(Drawing("sheet.png", caption, sheet))
    simulated = _simulated_figures(comparison)
    sections = [
        Section("All objects as one class", [table], [_simulated_text(simulated)], printed=True),
        Section("Each class: recall at one false alarm", [recall_table(judged)]),
        Section("Each class: AP50 with the class that is named", class_tables(judged)),
        Section("Curves and images", drawings=drawings),
        Section("How it was measured", text=HOW),
    ]
    publish(
        settings.folder,
        "transfer",
        f"Detection in {real.name}",
        about.strip(),
        sections,
        facts=_facts(settings, comparison, judged, simulated),
    )


def overall_table(judged: Sequence[JudgedArm], draws: Int64s) -> pd.DataFrame:
    """The figures of all arms; the lead over the blob detector is paired."""
    head = [
        "detector", "learned from", "AP50", "AP at IoU .3", "recall at one false alarm",
        "AP50 against blobs",
    ]  # fmt: skip
    blob = next((row for row in judged if row.arm.label == BLOB), None)
    lines = []
    for row in judged:
        lead = ""
        if blob is not None and row is not blob:
            lead = figure(difference(row.matches, blob.matches, draws), sign=True)
        figures = row.figures
        cells = [figure(figures.ap50), figure(figures.ap30), figure(figures.recall), lead]
        lines.append([row.arm.label, row.arm.learns_from, *cells])
    return as_table(head, lines)


def recall_table(judged: Sequence[JudgedArm]) -> pd.DataFrame:
    """Which part of the objects of each class an arm finds, whatever class it names."""
    names = list(judged[0].recall_of)
    lines = [
        [row.arm.label, *(written(row.recall_of[name], 2) for name in names)] for row in judged
    ]
    return as_table(["detector", *names], lines)


def class_tables(judged: Sequence[JudgedArm]) -> list[pd.DataFrame]:
    """AP50 of each class; only arms that name classes."""
    rows = [row for row in judged if row.by_class]
    if not rows:
        return []
    names = list(rows[0].by_class)
    lines = []
    for row in rows:
        values = [row.by_class[name].ap50.value for name in names]
        mean = float(np.mean(values))
        lines.append([row.arm.label, *(written(value, 2) for value in values), written(mean, 3)])
    return [as_table(["detector", *names, "mean"], lines)]


def _shown_on_sheet(judged: Sequence[JudgedArm]) -> JudgedArm:
    """Simulation alone or the given detector; else the last arm."""
    for row in judged:
        if row.arm.label == SIMULATION:
            return row
    return judged[-1]


def _plots(judged: Sequence[JudgedArm]) -> list[Plot]:
    """Recall over false alarms, and precision over recall."""
    return [
        Plot(
            title="All objects, IoU .5",
            x_label="false alarms per image",
            y_label="objects found",
            curves={
                row.arm.label: Curve(CURVE_ALARMS, recall_at(row.matches, CURVE_ALARMS))
                for row in judged
            },
            ticks=(0.05, 0.1, 0.3, 1, 3, 10),
            is_logarithmic=True,
            y_limits=(0, 1),
        ),
        Plot(
            title="Precision over recall",
            x_label="objects found",
            y_label="detections that are objects",
            curves={
                row.arm.label: Curve(_RECALL_STEPS, _precision_at(row.matches)) for row in judged
            },
            y_limits=(0, 1),
        ),
    ]


_RECALL_STEPS = tuple(float(value) for value in np.linspace(0, 1, 51))


def _precision_at(matches: Matches) -> list[float]:
    """Precision, made monotone, at each step of recall; 0 beyond the last detection."""
    order = np.argsort(-matches.score, kind="mergesort")
    hits = np.cumsum(matches.is_hit[order])
    if not len(hits):
        return [0.0] * len(_RECALL_STEPS)
    precision = hits / np.arange(1, len(hits) + 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    recall = hits / max(1, int(matches.object_counts.sum()))
    places = np.searchsorted(recall, _RECALL_STEPS)
    return [float(precision[place]) if place < len(precision) else 0.0 for place in places]


def _simulated_figures(comparison: Comparison) -> Figures | None:
    """Figures of simulation alone on simulated images that it did not learn from."""
    if comparison.trained is None or not comparison.held_out:
        return None
    held_out = [
        RealImage(working.labelled, working.labelled.boxes[:0]) for working in comparison.held_out
    ]
    detector = DetectorRuntime(comparison.trained.path)
    detections = detect_in(detector, [image.labelled.image for image in held_out])
    figures, _ = figures_of(held_out, detections, None, np.zeros((0, len(held_out)), np.int64))
    return figures


def _simulated_text(figures: Figures | None) -> str:
    if figures is None:
        return ""
    return (
        "On simulated images that it did not learn from, simulation alone has AP50 "
        f"{written(figures.ap50.value, 3)}, AP at IoU .3 {written(figures.ap30.value, 3)} and a "
        f"recall of {written(figures.recall.value, 3)} at one false alarm."
    )


def _facts(
    settings: TransferReportSettings,
    comparison: Comparison,
    judged: Sequence[JudgedArm],
    simulated: Figures | None,
) -> dict[str, Any]:
    """The content of transfer.json."""
    real = comparison.real
    return {
        "schema": SCHEMA,
        "real": real.name,
        "images": len(real.images),
        "groups": len({image.labelled.group for image in real.images}),
        "classes": list(real.classes),
        "ignored": settings.ignore,
        "quick": settings.quick,
        "steps": settings.steps,
        "real_steps": settings.real_steps,
        "seed": settings.seed,
        "simulated_images": len(comparison.simulated),
        "on_simulated": None if simulated is None else _plain(simulated),
        "rows": [
            {
                "label": row.arm.label,
                "learned_from": row.arm.learns_from,
                **_plain(row.figures),
                "recall_of": dict(row.recall_of),
                "classes": {name: _plain(figures) for name, figures in row.by_class.items()},
                "recall_at_false_alarms": dict(
                    zip(map(str, CURVE_ALARMS), recall_at(row.matches, CURVE_ALARMS), strict=True)
                ),
            }
            for row in judged
        ],
        "rules": HOW,
    }


def _plain(figures: Figures) -> dict[str, Any]:
    entries: dict[str, Any] = {"objects": figures.object_count}
    for name in ("ap50", "ap30", "recall"):
        estimate: FigureEstimate = getattr(figures, name)
        entries[name] = {key: plain(value) for key, value in estimate._asdict().items()}
    return entries
