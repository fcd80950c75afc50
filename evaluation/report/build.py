"""The whole report, step by step: tune, measure, compute, write."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...factory.dataset.read.reader import open_shard
from ...factory.errors import FactoryError
from ...factory.files import check_writable
from ...factory.scheduler.workers.tasks import TaskPool
from .. import tuning
from ..filters.base import Baseline
from ..image_files import given_methods
from ..item import Item
from ..methods import baselines_of, costs_of, methods_of, networks_of
from ..pairs import drawn_of, items_of, picture
from ..settings import EvaluationSettings
from ..store import FigureStore
from . import page
from .content import content_of, facts_of, shown_rows, verdict
from .measure import Row, examples_of, measured_rows
from .sections import breakdown_of, flat_config, robustness_of


def build(settings: EvaluationSettings) -> dict[str, Any]:
    """Make the report in `settings.folder` and print its leaderboard; returns its content.

    Raises FactoryError for anything that is not readable, and before the work when the folder
    cannot be written to.
    """
    out = settings.folder
    baselines = baselines_of(settings.baselines)
    networks = networks_of(settings)
    items = items_of(Path(settings.dataset.dir), settings.split, settings.limit)
    given = given_methods(settings.pictures, items)
    check_writable(out, "out")
    store = FigureStore(out)
    with TaskPool(settings.workers) as pool, contextlib.closing(store):
        for line in _tuned(settings, baselines, pool):
            print(line)
        tuned = tuning.load_tuned(settings.tuned_file)
        methods = [*methods_of(baselines, tuned), *networks, *given]
        rows = measured_rows(settings, items, methods, store, pool)
        content = _content(settings, items, rows, tuned)
        labels = shown_rows(content["rows"], settings.page.methods)
        drawn = drawn_of(items)
        page.write_results(out / page.RESULTS_NAME, rows, items, drawn)
        content["breakdown"] = breakdown_of(rows, items, drawn, labels, settings)
        content["robustness"] = robustness_of(settings, methods, labels, store, pool)
        content["config"] = flat_config(Path(settings.dataset.dir))
        by_label = {row.method.label: row.method for row in rows}
        shown = [by_label[label] for label in labels if label != "noisy"]
        examples = examples_of(settings, items, rows[0], shown, pool)
        page.write(out, content, examples)
    said = (*page.folded(content["rows"]), content["facts"]["few_frames"], verdict(content))
    print("", *filter(None, said), sep="\n\n")
    for line in [*content["ordering"], *content["ordering_3"]]:
        print(line)
    print(f"report: {out / page.PAGE_NAME}")
    return content


def _tuned(
    settings: EvaluationSettings, baselines: Sequence[Baseline], pool: TaskPool
) -> list[str]:
    if not (settings.tuning.auto and baselines):
        return []
    try:
        return tuning.tune(settings, baselines, pool)
    except FactoryError as error:
        # Without pairs to tune on there are still the rows by default.
        return [f"not tuned: {error}"]


def _content(
    settings: EvaluationSettings, items: Sequence[Item], rows: Sequence[Row], tuned: dict[str, Any]
) -> dict[str, Any]:
    first = items[0]
    shape = picture(first.place).clean.shape
    config_hash = ""
    if first.place[1] >= 0:
        with open_shard(Path(first.place[0])) as file:
            value = file.attrs.get("config_hash", "")
            config_hash = value.decode() if isinstance(value, bytes) else str(value)
    facts = facts_of(settings, items, rows[0], shape, config_hash)
    costs = costs_of([row.method for row in rows if row.method.weights])
    return content_of(rows, items, settings, facts, tuned, costs)
