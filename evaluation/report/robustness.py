"""The same methods on further datasets: other levels of noise, and kinds absent from training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...factory.dataset.format.manifest import load_manifest
from ...factory.scheduler.workers.tasks import TaskPool
from ..methods.method import Method
from ..metrics.statistics import estimate, paired
from ..pairs import items_of
from ..runner import FigureStore
from ..settings import DatasetFolder, EvaluationSettings
from .content import Row, as_dict, paired_dict
from .measure import measured_rows

Content = dict[str, Any]

_NOT_NOISE = ("dataset", "scheduler", "cache", "debug", "render.threads")
"""Keys that do not change what a picture shows, or only where it lies."""


def robustness_of(
    settings: EvaluationSettings,
    methods: Sequence[Method],
    labels: Sequence[str],
    store: FigureStore,
    pool: TaskPool,
) -> list[Content]:
    """One entry a dataset of `robustness=[...]`: how it differs, and the rows' PSNR and gain."""
    wanted = [method for method in methods if method.label in labels and method.is_function]
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
