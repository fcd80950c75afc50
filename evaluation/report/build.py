"""The whole report, step by step: tune, measure, compute, write."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.errors import FactoryError
from ...factory.files import check_writable, write_atomically
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskPool
from .. import tuning
from ..methods import NOISY, Method, baselines_of, methods_of, networks_of
from ..pairs import Item, config_hash_of, drawn_of, given_methods, items_of, names_of, pair_images
from ..runner import SECONDS, Measured, Subject, run
from ..settings import EvaluationSettings
from . import tables
from .content import best_forms, content_of, shown_rows, verdict
from .document import Example, Section, write_report
from .tables import Content

PAGE_NAME = "report.html"
REPORT_NAME = "report.json"
RESULTS_NAME = "results.csv"

_CHUNK = 4  # pairs in a task
_SHOWN = 10  # methods beside noisy and clean in the viewer


def build(settings: EvaluationSettings) -> dict[str, Any]:
    """Make the report in `settings.folder` and print its leaderboard; returns its content.

    Raises FactoryError for anything that is not readable, and before the work when the folder
    cannot be written to.
    """
    out = settings.folder
    baselines = baselines_of(settings.baselines)
    networks = networks_of(settings)
    items = items_of(Path(settings.dataset.dir), settings.split, settings.limit)
    given_rows = given_methods(settings.pictures, [names_of(item) for item in items])
    check_writable(out, "out")
    with TaskPool(settings.workers) as pool:
        if settings.tuning.auto and baselines:
            try:
                print(*tuning.tune(settings, baselines, pool), sep="\n")
            except FactoryError as error:
                # Without pairs to tune on there are still the rows by default.
                print(f"not tuned: {error}")
        tuned = tuning.load_tuned(settings.tuned_file)
        named = [NOISY, *methods_of(baselines, tuned), *networks, *given_rows]
        methods = list({method.label: method for method in named}.values())
        measured = measure(settings, items, methods, pool)
        content = content_of(methods, measured, items, settings, tuned)
        content["facts"]["image"] = "x".join(map(str, pair_images(items[0].place).clean.shape))
        content["facts"]["config_hash"] = config_hash_of(items[0])
        labels = shown_rows(content["rows"], _SHOWN)
        write_results(out / RESULTS_NAME, measured, items)
        shown = [method for label in labels for method in methods if method.label == label]
        examples = _examples(settings, items, measured, shown, pool)
    facts = content["facts"]
    about = (
        f"{facts['pairs']} pairs of {facts['frames']} frames in {len(facts['scenes'])} scene(s) "
        f"({facts['image']}; config {facts['config_hash'] or 'unknown'})."
    )
    sections = sections_of(content)
    title = f"Report: {facts['dataset']}, {facts['split']} split"
    write_report(out, "report", title, about, sections, facts=content, examples=examples)
    print("", tables.as_markdown(sections[0].tables[0]), *filter(None, sections[0].text),
          sep="\n\n")  # fmt: skip
    print(f"report: {out / PAGE_NAME}")
    return content


def measure(
    settings: EvaluationSettings,
    items: Sequence[Item],
    methods: Sequence[Method],
    pool: TaskPool,
    *,
    keep: bool = False,
) -> Measured:
    """The figures of methods on pairs.  keep: whether the images come back.

    Raises FactoryError for a dataset that cannot be read.
    """
    pair_images.cache_clear()  # files may have changed since the last report of this process
    pairs: dict[int, Subject] = dict(enumerate(items))
    with progress_bar(total=len(methods) * len(items), unit="image", desc="measuring") as bar:
        return run(
            methods,
            [pairs],
            pool,
            device=settings.device,
            timeout_s=settings.image_timeout_s,
            chunk=_CHUNK,
            keep=lambda _: keep,
            tick=bar.update,
        )


def write_results(path: Path, measured: Measured, items: Sequence[Item]) -> None:
    """results.csv: a line for each row of the report and pair, with what was drawn for it."""
    import pandas as pd

    own = ("location", "scene", "frame", "variant")
    pairs = pd.DataFrame(
        [(i.shard, i.place[1], i.key, i.location, i.scene, i.frame, i.variant) for i in items],
        columns=["shard", "index", "pair", *own],
    )
    more = drawn_of(items)
    more = more[[name for name in more if name not in pairs]]
    table = measured.table().drop(columns=SECONDS)
    figures = list(table)[2:]
    whole = table.join(pairs, on="picture").join(more, on="picture")
    text = whole[["method", *pairs, *figures, *more]].to_csv(index=False, lineterminator="\n")
    write_atomically(path, text.encode(), key="out")


def sections_of(content: Content) -> list[Section]:
    """The report for people."""
    facts = content["facts"]
    rows = content["rows"]
    best = best_forms(rows)
    more = len(rows) - len(best)
    note = f"Of each method its best form here; {more} more in report.md." if more else ""
    said = (note, verdict(content))
    sections = [Section("Leaderboard", [tables.leaderboard(best)], said)]
    if more:
        sections.append(Section(f"All {len(rows)} forms", [tables.leaderboard(rows)], folded=True))
    for number in (2, 3):
        if lines := content[f"table_{number}"]:
            title = f"The paper's Table {number}"
            sections.append(Section(title, [tables.beside_paper(lines)]))
    return [
        *sections,
        Section("More metrics", [tables.more_metrics(rows)]),
        Section("How it was measured", text=facts["rules"]),
    ]


def _examples(
    settings: EvaluationSettings,
    items: Sequence[Item],
    measured: Measured,
    methods: Sequence[Method],
    pool: TaskPool,
) -> list[Example]:
    """Pairs from the worst to the best by the PSNR of the noisy image, evenly between."""
    count = min(settings.examples, len(items))
    if not count:
        return []
    noisy = measured.wide()["psnr"][NOISY.label].to_numpy()
    places = np.unique(np.linspace(0, len(items) - 1, count).round().astype(int))
    chosen = [items[number] for number in np.argsort(noisy, kind="stable")[places]]
    measured_images = measure(settings, chosen, methods, pool, keep=True)
    examples = []
    for number, item in enumerate(chosen):
        # A method that fails is left out.
        labels = [
            method.label for method in methods if (method.label, number) in measured_images.images
        ]
        images = {label: measured_images.images[label, number] for label in labels}
        psnr = {label: measured_images.figures[label][number]["psnr"] for label in labels}
        title = f"{item.scene} {item.frame}" + (f" #{item.variant}" if item.variant else "")
        images["clean"] = pair_images(item.place).clean
        examples.append(Example(title, images, psnr, truth="clean"))
    return examples
