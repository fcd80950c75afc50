"""The whole report, step by step: tune, measure, compute, write."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from ...factory.dataset.read.reader import open_shard
from ...factory.errors import FactoryError
from ...factory.files import check_writable
from ...factory.scheduler.workers.tasks import TaskPool
from .. import tuning
from ..methods import baselines_of, costs_of, methods_of, networks_of
from ..pairs import Item, drawn_of, given_methods, items_of, picture
from ..settings import EvaluationSettings
from ..store import FigureStore
from . import page
from .breakdown import breakdown_of
from .content import content_of, facts_of, shown_rows, verdict
from .measure import examples_of, measured_rows


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
    with TaskPool(settings.workers) as pool, contextlib.closing(FigureStore(out)) as store:
        if settings.tuning.auto and baselines:
            try:
                print(*tuning.tune(settings, baselines, pool), sep="\n")
            except FactoryError as error:
                # Without pairs to tune on there are still the rows by default.
                print(f"not tuned: {error}")
        tuned = tuning.load_tuned(settings.tuned_file)
        methods = [*methods_of(baselines, tuned), *networks, *given]
        rows = measured_rows(settings, items, methods, store, pool)
        shape = picture(items[0].place).clean.shape
        facts = facts_of(settings, items, rows[0], shape, _config_hash(items[0]))
        costs = costs_of([row.method for row in rows if row.method.weights])
        content = content_of(rows, items, settings, facts, tuned, costs)
        labels = shown_rows(content["rows"], settings.page.methods)
        drawn = drawn_of(items)
        page.write_results(out / page.RESULTS_NAME, rows, items, drawn)
        content["breakdown"] = [
            table.to_dict(orient="split", index=False)
            for table in breakdown_of(rows, items, drawn, labels)
        ]
        by_label = {row.method.label: row.method for row in rows}
        shown = [by_label[label] for label in labels if label != "noisy"]
        page.write(out, content, examples_of(settings, items, rows[0], shown, pool))
    said = (*page.folded(content["rows"]), content["facts"]["few_frames"], verdict(content))
    print("", *filter(None, said), sep="\n\n")
    print(*content["ordering"], *content["ordering_3"], sep="\n")
    print(f"report: {out / page.PAGE_NAME}")
    return content


def _config_hash(item: Item) -> str:
    """Of the dataset that an item is of; '' for a folder of image files."""
    if item.place[1] < 0:
        return ""
    with open_shard(Path(item.place[0])) as file:
        value = file.attrs.get("config_hash", "")
        return value.decode() if isinstance(value, bytes) else str(value)
