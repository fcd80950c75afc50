"""The whole report, step by step: tune, measure, compute, write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, write_atomically
from ...factory.common.progress import Bar
from ...factory.common.workers.tasks import TaskPool
from ..filters import Baseline
from ..judging import tuning
from ..judging.methods import NOISY, Method, baselines_of, methods_of, networks_of
from ..judging.pairs import (
    JudgedPair,
    config_hash_of,
    drawn_of,
    given_methods,
    items_of,
    names_of,
    pair_images,
)
from ..judging.runner import SECONDS, Measured, Subject, run
from ..judging.settings import EvaluationSettings
from ..metrics.own import refuse_metrics_of_scripts
from ..metrics.statistics import evenly
from . import tables
from .content import best_forms, content_of, shown_rows, verdict
from .document import ComparedImages, Section, compared, publish
from .tables import Content

PAGE_NAME = "report.html"
REPORT_NAME = "report.json"
RESULTS_NAME = "results.csv"


def build(settings: EvaluationSettings) -> dict[str, Any]:
    """Make the report in `settings.folder` and print its leaderboard; returns its content.

    Raises FactoryError for anything that is not readable, and before the work when the folder
    cannot be written to.
    """
    out = settings.folder
    baselines = baselines_of(settings.baselines)
    networks = networks_of(settings)
    items = items_of(Path(settings.dataset.dir), settings.split, settings.limit)
    external_methods = given_methods(settings.pictures, [names_of(item) for item in items])
    check_writable(out, "out")

    with TaskPool(settings.workers) as pool:
        if settings.tuning.auto and baselines:
            _tune(settings, baselines, pool)
        tuned = tuning.load_tuned(settings.tuned_file)
        candidates = [NOISY, *methods_of(baselines, tuned), *networks, *external_methods]
        methods = list({method.label: method for method in candidates}.values())
        shown = set(evenly(range(len(items)), settings.examples))
        measured = measure(settings, items, methods, pool, keep=shown.__contains__)

    content = content_of(methods, measured, items, settings, tuned)
    shape = "x".join(map(str, pair_images(items[0].place).clean.shape))
    content["facts"] |= {"image": shape, "config_hash": config_hash_of(items[0])}
    write_results(out / RESULTS_NAME, measured, items)
    labels = shown_rows(content["rows"])
    examples = [
        compared(measured, number, items[number].title, labels, "clean",
                 pair_images(items[number].place).clean)
        for number in sorted(shown)
    ]  # fmt: skip
    _write(out, content, examples)
    return content


def _tune(settings: EvaluationSettings, baselines: Sequence[Baseline], pool: TaskPool) -> None:
    """Tune what has not been tuned.  Without pairs to tune on, only the default rows remain."""
    try:
        print(*tuning.tune(settings, baselines, pool), sep="\n")
    except FactoryError as error:
        print(f"not tuned: {error}")


def _write(out: Path, content: Content, examples: Sequence[ComparedImages]) -> None:
    """Write the report and print its leaderboard."""
    facts = content["facts"]
    title = f"Report: {facts['dataset']}, {facts['split']} split"
    about = (
        f"{facts['pairs']} pairs of {facts['frames']} frames in {len(facts['scenes'])} scene(s) "
        f"({facts['image']}; config {facts['config_hash'] or 'unknown'})."
    )
    publish(out, "report", title, about, sections_of(content), facts=content, examples=examples)


def measure(
    settings: EvaluationSettings,
    items: Sequence[JudgedPair],
    methods: Sequence[Method],
    pool: TaskPool,
    *,
    keep: Callable[[int], bool] = lambda number: False,
) -> Measured:
    """The figures of methods on pairs.  keep: whether the images of a pair come back.

    Raises FactoryError for a dataset that cannot be read.
    """
    refuse_metrics_of_scripts(settings.workers)
    pair_images.cache_clear()  # files may have changed since the last report of this process
    pairs: dict[int, Subject] = dict(enumerate(items))
    with Bar(total=len(methods) * len(items), unit="image", desc="measuring") as bar:
        return run(
            methods,
            [pairs],
            pool,
            device=settings.device,
            timeout_s=settings.image_timeout_s,
            keep=keep,
            tick=bar.update,
        )


def write_results(path: Path, measured: Measured, items: Sequence[JudgedPair]) -> None:
    """results.csv: a line for each row of the report and pair, with what was drawn for it."""
    import pandas as pd

    pairs = pd.DataFrame(
        {
            "shard": [item.shard for item in items],
            "index": [item.place[1] for item in items],
            "pair": [item.key for item in items],
            "location": [item.location for item in items],
            "scene": [item.scene for item in items],
            "frame": [item.frame for item in items],
            "variant": [item.variant for item in items],
        }
    )
    drawn = drawn_of(items)
    drawn = drawn[[name for name in drawn if name not in pairs]]
    figures = measured.table().drop(columns=SECONDS)
    metrics = list(figures)[2:]

    results = figures.join(pairs, on="picture").join(drawn, on="picture")
    columns = ["method", *pairs, *metrics, *drawn]
    text = results[columns].to_csv(index=False, lineterminator="\n")
    write_atomically(path, text.encode(), key="out")


def sections_of(content: Content) -> list[Section]:
    """The report for people."""
    rows = content["rows"]
    best = best_forms(rows)
    other_count = len(rows) - len(best)

    note = ""
    if other_count:
        note = f"Of each method its best form here; {other_count} more in report.md."
    sections = [
        Section("Leaderboard", [tables.leaderboard(best)], (note, verdict(content)), printed=True)
    ]
    if other_count:
        sections.append(Section(f"All {len(rows)} forms", [tables.leaderboard(rows)], folded=True))
    for number in (2, 3):
        lines = content[f"table_{number}"]
        if lines:
            sections.append(Section(f"The paper's Table {number}", [tables.beside_paper(lines)]))
    sections.append(Section("More metrics", [tables.more_metrics(rows)]))
    sections.append(Section("How it was measured", text=content["facts"]["rules"]))
    return sections
