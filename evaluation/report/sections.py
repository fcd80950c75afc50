"""Where a method is good and where not, and the same methods on further datasets.

By place, by noise effect and level, by resampling rate; and with other levels and kinds of noise.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.dataset.format.manifest import load_manifest
from ...factory.scheduler.workers.tasks import TaskPool
from ..item import Item
from ..methods import Method
from ..metrics.statistics import estimate, paired
from ..pairs import items_of
from ..settings import DatasetFolder, EvaluationSettings
from ..store import FigureStore
from .content import as_dict, paired_dict
from .measure import Row, measured_rows

Content = dict[str, Any]
Column = npt.NDArray[Any]

_MOST_PLACES = 12
_PAIRS_A_BIN = 8
_NOT_NOISE = ("dataset", "scheduler", "cache", "debug", "render.threads")
"""Keys that do not change what a picture shows, or only where it lies."""


def breakdown_of(
    rows: Sequence[Row],
    items: Sequence[Item],
    drawn: Mapping[str, Column],
    labels: Sequence[str],
    settings: EvaluationSettings,
) -> list[dict[str, Any]]:
    """One entry a factor that varies: its bins, and the rows' mean PSNR and gain in each.

    drawn: columns of /meta.  labels: the rows to break down, in their order.  A number is cut into
    up to five bins of equally many pairs; an effect that is off in a pair has a bin `off`.
    """
    chosen = {row.method.label: row for row in rows if row.lost is None}
    kept = [label for label in labels if label in chosen]
    noisy = chosen["noisy"]
    options = {"resamples": settings.bootstrap, "seed": settings.seed}
    found = []
    for factor, unit, columns in _factors(noisy, items, drawn):
        bins = _bins(columns)
        if len(bins) < 2:
            continue
        entry: dict[str, Any] = {"factor": factor, "unit": unit, "bins": [], "rows": {}}
        for name, where, centre in bins:
            entry["bins"].append({"label": name, "pairs": int(where.sum()), "centre": centre})
            groups = [items[index].group for index in np.flatnonzero(where)]
            for label in kept:
                values = chosen[label].values["psnr"][where]
                line = as_dict(estimate(values, groups, **options))
                gain = values - noisy.values["psnr"][where]
                line["gain"] = (
                    None if label == "noisy" else as_dict(estimate(gain, groups, **options))
                )
                entry["rows"].setdefault(label, []).append(line)
        found.append(entry)
    return found


def _factors(
    noisy: Row, items: Sequence[Item], drawn: Mapping[str, Column]
) -> list[tuple[str, str, Column]]:
    places = {
        name: np.array([getattr(one, name) for one in items]) for name in ("location", "scene")
    }
    place = "scene" if len(set(places["location"])) < 2 else "location"
    return [
        (place, "", places[place]),
        ("PSNR of the noisy image", "dB", noisy.values["psnr"]),
        *(
            (name, "", column)
            for name, column in drawn.items()
            if name.startswith("noise.") or name == "resample.rate"
        ),
    ]


def _bins(column: Column) -> list[tuple[str, npt.NDArray[np.bool_], float | None]]:
    """(label, (N,) bool, mean of the values) of each bin."""
    if column.dtype.kind in "US":
        names, counts = np.unique(column, return_counts=True)
        most = np.sort(np.argsort(-counts, kind="stable")[:_MOST_PLACES])
        return [(str(name) or "off", column == name, None) for name in names[most]]
    values = column.astype(float)
    known = np.isfinite(values)
    found: list[tuple[str, npt.NDArray[np.bool_], float | None]] = []
    if not known.all():
        found.append(("off", ~known, None))
    distinct = np.unique(values[known])
    if 1 <= distinct.size <= 5:
        found += [(f"{value:.3g}", values == value, float(value)) for value in distinct]
    elif distinct.size:
        count = int(np.clip(known.sum() // _PAIRS_A_BIN, 2, 5))
        edges = np.quantile(values[known], np.linspace(0, 1, count + 1))
        edges[-1] = np.nextafter(edges[-1], np.inf)
        for low, high in itertools.pairwise(edges):
            inside = known & (values >= low) & (values < high)
            if inside.any():
                centre = float(values[inside].mean())
                found.append((f"{low:.3g} .. {high:.3g}", inside, centre))
    return found


def robustness_of(
    settings: EvaluationSettings,
    methods: Sequence[Method],
    labels: Sequence[str],
    store: FigureStore,
    pool: TaskPool,
) -> list[Content]:
    """One entry a dataset of `robustness=[...]`: how it differs, and the rows' PSNR and gain."""
    wanted = [method for method in methods if method.label in labels and not method.given]
    own = flat_config(Path(settings.dataset.dir))
    found = []
    for folder in settings.robustness:
        there = replace(settings, dataset=DatasetFolder(folder))
        items = items_of(Path(folder), settings.split, settings.limit)
        name = Path(folder).resolve().name
        rows = measured_rows(there, items, wanted, store, pool, title=name)
        groups = [item.group for item in items]
        found.append(
            {
                "dataset": name,
                "pairs": len(items),
                "differs": difference(own, flat_config(Path(folder))),
                "rows": {row.method.label: _row(row, rows[0], groups, settings) for row in rows},
            }
        )
    return found


def curve_of(entries: Sequence[Content], own: Mapping[str, Any]) -> tuple[str, list[float]] | None:
    """(key, value of each dataset) when all differ from this one in one and the same number."""
    keys = {key for entry in entries for key in entry["differs"]}
    if len(keys) != 1 or not entries:
        return None
    (key,) = keys
    values = [entry["differs"][key] for entry in entries]
    usable = all(isinstance(value, int | float) for value in [*values, own.get(key)])
    return (key, [float(value) for value in values]) if usable else None


def flat_config(root: Path) -> dict[str, Any]:
    """Dotted key -> value of what made a dataset; empty when its manifest does not say."""
    manifest = load_manifest(root) if root.is_dir() else None
    flat: dict[str, Any] = {}

    def walk(value: Any, prefix: str) -> None:
        if isinstance(value, Mapping):
            for key, inner in value.items():
                walk(inner, f"{prefix}.{key}" if prefix else str(key))
        elif not prefix.startswith(_NOT_NOISE):
            flat[prefix] = value

    walk(dict(manifest.config) if manifest is not None else {}, "")
    return flat


def difference(own: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """The keys whose values differ, with those of the other."""
    return {key: other.get(key) for key in sorted({*own, *other}) if own.get(key) != other.get(key)}


def _row(row: Row, noisy: Row, groups: Sequence[str], settings: EvaluationSettings) -> Content:
    if row.lost is not None:
        return {"lost": row.lost}
    options = {"resamples": settings.bootstrap, "seed": settings.seed}
    result: Content = {"lost": None}
    for name in ("psnr", "ssim", "gmsd"):
        result[name] = as_dict(estimate(row.values[name], groups, **options))
    gain = paired(row.values["psnr"], noisy.values["psnr"], groups, better=1, **options)
    result["gain"] = paired_dict(gain)
    return result
