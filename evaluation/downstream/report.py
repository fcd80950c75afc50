"""The tables of a downstream run: figures with intervals, and what denoising adds to them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.dataset.describe import markdown
from ...factory.files import write_atomically
from ...factory.labels import CLASSES
from ..methods.method import NOISY
from ..report.content import plain
from ..report.names import written
from .counts import Counts
from .figures import (
    AP_CLASSES,
    AP_OBJECTS,
    MIOU,
    OBJECTS,
    Draws,
    Interval,
    Values,
    drawn_figures,
    interval,
)
from .pictures import Labelled
from .settings import DownstreamSettings
from .trainings import Training

TABLE_NAME, DATA_NAME = "downstream.md", "downstream.json"

Row = tuple[str, float | None]
Drawn = Mapping[str, tuple[Values, Values]]

COLUMNS = {
    MIOU: "mIoU",
    OBJECTS: "IoU, objects",
    AP_OBJECTS: "AP50, objects",
    AP_CLASSES: "AP50, classes",
}
# Of classes that the factory's pictures do not have, nothing can be learned there.
_OF_SIMULATED = (OBJECTS, AP_OBJECTS)


def about_components(component: npt.NDArray[np.int64], alike: float) -> str:
    """How many there are, and how large, in one line."""
    sizes = Counter(np.bincount(component).tolist())
    told = [
        f"{size}" if count == 1 else f"{size} ({count} times)"
        for size, count in sorted(sizes.items(), reverse=True)
    ]
    return (
        f"{len(component)} pictures in {component.max() + 1} components of similarity "
        f"(alike={alike:g}), of {', '.join(told)} pictures"
    )


def counted_classes(
    masks: Sequence[npt.NDArray[np.uint8]], component: npt.NDArray[np.int64], least: int
) -> dict[int, tuple[int, int]]:
    """Class that is there -> in how many pictures and components it is; `least` of these at least.

    Background first; a class of fewer components is never both learned and tested.
    """
    pictures, groups = Counter[int](), dict[int, set[int]]()
    for mask, group in zip(masks, component.tolist(), strict=True):
        for one in np.unique(mask).tolist():
            pictures[one] += 1
            groups.setdefault(one, set()).add(group)
    return {
        one: (pictures[one], len(groups[one]))
        for one in sorted(groups)
        if len(groups[one]) >= least
    }


def write(
    settings: DownstreamSettings,
    pictures: tuple[Labelled, Labelled | None],
    component: npt.NDArray[np.int64],
    rows: Mapping[Row, Sequence[Sequence[Counts]]],
    plan: Sequence[Training],
) -> str:
    """Write both files; returns the tables of figures and differences.

    rows: a seed each, with the counts of every picture.
    FactoryError when they cannot be written.
    """
    real, simulated = pictures
    every = counted_classes(real.masks, component, 1)
    counted = counted_classes(real.masks, component, settings.folds)
    draws = Draws.of(component, settings.seeds, settings.bootstrap, settings.seed)
    drawn = {row: drawn_figures(runs, list(counted), draws) for row, runs in rows.items()}
    found = [_line(row, _intervals(one), plan) for row, one in drawn.items()]
    against = [
        _line(row, _intervals(_less(one, drawn[NOISY.label, row[1]])), plan)
        for row, one in drawn.items()
        if row[0] != NOISY.label
    ]
    facts = {
        "schema": "simnfnd-downstream/1",
        "name": Path(settings.real).expanduser().resolve().name,
        "pictures": len(real.names),
        "simulated": 0 if simulated is None else len(simulated.names),
        "components": np.bincount(component).tolist(),
        **{
            name: getattr(settings, name)
            for name in ("split", "alike", "folds", "seeds", "shrink", "steps", "batch", "seed")
        },
        "classes": [
            {"name": CLASSES[n], "pictures": p, "components": c, "counted": n in counted}
            for n, (p, c) in every.items()
        ],
        "rows": found,
        "less_noisy": against,
    }
    tables = [_table(found, False)]
    if against:
        tables.append("Denoised less raw, the same pictures drawn for both:")
        tables += [_table(against, True), _verdict(against)]
    text = [
        "# Segmentation and detection",
        about_components(component, settings.alike) + ".",
        _about(settings, every, counted),
        *tables,
        "## IoU of each class",
        _of_classes(found, every, counted),
        "",
    ]
    content = json.dumps(facts, indent=1, allow_nan=False).encode()
    write_atomically(settings.folder / DATA_NAME, content, durable=False, key="out")
    page = "\n\n".join(text).encode()
    write_atomically(settings.folder / TABLE_NAME, page, durable=False, key="out")
    return "\n\n".join(tables)


def _about(
    settings: DownstreamSettings,
    every: Mapping[int, tuple[int, int]],
    counted: Mapping[int, tuple[int, int]],
) -> str:
    kept = "kept whole" if settings.split == "components" else "TORN APART (split=pictures: leaks)"
    parts = [
        f"{settings.folds} folds, components {kept}; {settings.seeds} seeds; each training "
        f"{settings.steps} steps of {settings.batch} pictures, shrunk {settings.shrink} times. "
        "In brackets 95 % intervals over draws of components and seeds."
    ]
    rare = [CLASSES[one] for one in every if one not in counted]
    if rare:
        parts.append(
            f"Left out of the means, because fewer than {settings.folds} components show them: "
            f"{', '.join(rare)}."
        )
    return " ".join(parts)


def _less(one: Drawn, other: Drawn) -> dict[str, tuple[Values, Values]]:
    return {name: (one[name][0] - other[name][0], one[name][1] - other[name][1]) for name in one}


def _intervals(drawn: Drawn) -> dict[str, Interval]:
    return {name: interval(*values) for name, values in drawn.items()}


def _line(row: Row, figures: Mapping[str, Interval], plan: Sequence[Training]) -> dict[str, Any]:
    method, percent = row
    learned = [len(one.learned) for one in plan if (one.method, one.percent) == row]
    return {
        "method": "raw" if method == NOISY.label else method,
        "labels_percent": percent,
        "learned": round(float(np.mean(learned))),
        "figures": {
            name: {
                "value": plain(one.value),
                "interval": [plain(one.low), plain(one.high)],
                "seeds": [plain(value) for value in one.seeds],
            }
            for name, one in figures.items()
        },
    }


def _table(lines: Sequence[Mapping[str, Any]], signed: bool) -> str:
    head = ("learned from", "pictures" + (", less raw" if signed else ""), *COLUMNS.values())
    rows = [
        (
            _source(line),
            line["method"],
            *(_cell(line, name, signed) for name in COLUMNS),
        )
        for line in lines
    ]
    return markdown.table(head, rows, align="llr")


def _source(line: Mapping[str, Any]) -> str:
    if line["labels_percent"] is None:
        return f"the factory's {line['learned']}"
    return f"{line['labels_percent']:g} % of the labels ({line['learned']})"


def _cell(line: Mapping[str, Any], name: str, signed: bool) -> str:
    if line["labels_percent"] is None and name not in _OF_SIMULATED:
        return "-"
    figure = line["figures"][name]
    low, high = (written(one, 3, signed) for one in figure["interval"])
    return f"{written(figure['value'], 3, signed)} ({low} .. {high})"


def _verdict(lines: Sequence[Mapping[str, Any]]) -> str:
    """Where the interval of a difference excludes zero, in words."""
    better: list[str] = []
    worse: list[str] = []
    count = 0
    for line in lines:
        for name in _OF_SIMULATED if line["labels_percent"] is None else COLUMNS:
            low, high = line["figures"][name]["interval"]
            if low is None:
                continue
            count += 1
            if low > 0 or high < 0:
                what = f"{COLUMNS[name]} of `{line['method']}` with {_source(line)}"
                (better if low > 0 else worse).append(what)
    parts = [
        f"{word}: {'; '.join(told)}."
        for word, told in (("Better than raw", better), ("Worse than raw", worse))
        if told
    ]
    rest = count - len(better) - len(worse)
    parts.append(f"In {rest} of {count} differences the interval holds zero.")
    return " ".join(parts)


def _of_classes(
    lines: Sequence[Mapping[str, Any]],
    every: Mapping[int, tuple[int, int]],
    counted: Mapping[int, tuple[int, int]],
) -> str:
    told = [line for line in lines if line["labels_percent"] is not None]
    head = [
        "class (pictures, components)",
        *(f"{line['method']}, {line['labels_percent']:g} %" for line in told),
    ]
    rows = []
    for one, (pictures, groups) in every.items():
        name = f"{CLASSES[one]} ({pictures}, {groups})" + ("" if one in counted else ", left out")
        cells = [line["figures"][f"iou_{one}"] for line in told]
        rows.append([name, *(written(cell["value"], 3) for cell in cells)])
    return markdown.table(head, rows)
