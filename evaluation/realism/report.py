"""`simnfnd evaluate realism`: the distances as Markdown, as JSON and as a page."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from ..recorded import GEOMETRY_FILE
from ..report.document import Example, Section, write_report
from ..report.tables import as_markdown, as_table, plain, written
from ..settings import RealismSettings
from .compare import REAL, RESAMPLES, described, distances
from .features import FEATURES
from .pictures import Collection, open_dataset, real_pictures

_EXAMPLES = 8


def evaluate(settings: RealismSettings) -> None:
    """Measure, compare, print the table and write the report.  Raises FactoryError."""
    real = real_pictures(settings.real).at_most(settings.limit)
    collections = {REAL: real, **_simulations(settings)}
    measured = {name: described(one, settings.grid) for name, one in collections.items()}
    table, overall = distances(measured.pop(REAL), measured, settings.seed)
    out = Path(settings.out or Path("outputs", "realism", next(iter(measured))))
    rows = [
        [FEATURES[str(name)], *(written(value, 2) for value in row)]
        for name, row in zip(table.index, table.to_numpy(), strict=True)
    ]
    rows.append(["overall", "1", *(f"{value:.1f}" for value in overall.values())])
    shown = as_table(["real against", *table], rows)
    counts = {name: len(one.sources) for name, one in collections.items()}
    notes = [note for one in collections.values() for note in one.notes]
    grid = settings.grid
    rule = (
        "Kolmogorov-Smirnov distances of the images' features, 0 to 1. `real` is that of two "
        "halves of the real images, which a perfect simulation would reach. Overall: geometric "
        "mean of the earth mover's distances over those of the halves, each at least 1. All sets "
        "have one size "
        f"({min(counts.values()) // 2}); means of {RESAMPLES} draws. Measured on polar images "
        f"({grid.range_bins} range bins, {grid.beams} beams), on the grey values as they are shown."
    )
    about = ", ".join(f"{count} images of {name}" for name, count in counts.items())
    pictures = {name: one.at_most(_EXAMPLES).sources for name, one in collections.items()}
    examples = [
        # Far range on top.
        Example(
            f"images {number + 1}",
            {name: found[number].polar(grid)[::-1] for name, found in pictures.items()},
        )
        for number in range(min(map(len, pictures.values())))
    ]
    facts = {
        "schema": "simnfnd-realism/2",
        "real": real.name,
        "images": counts,
        "notes": notes,
        "grid": asdict(grid),
        "layer": settings.layer,
        "seed": settings.seed,
        "overall": overall,
        "distances": {
            name: {key: plain(value) for key, value in column.items()}
            for name, column in table.to_dict().items()
        },
    }
    sections = [Section("Distances", [shown], [rule, *notes])]
    title = f"Simulated against real: {real.name}"
    write_report(out, "realism", title, f"{about}.", sections, facts=facts, examples=examples)
    print(*notes, as_markdown(shown), f"report: {out / 'realism.html'}", sep="\n")


def _simulations(settings: RealismSettings) -> dict[str, Collection]:
    """Name -> pictures; two folders of one name get a number."""
    found: dict[str, Collection] = {}
    for folder in settings.sim:
        path = Path(folder).expanduser()
        if (path / GEOMETRY_FILE).is_file():
            opened = real_pictures(path)
        else:
            opened = open_dataset(path, settings.sim_split, settings.layer)
        name, number = opened.name, 2
        while name in found or name == REAL:
            name, number = f"{opened.name} {number}", number + 1
        found[name] = opened.at_most(settings.limit)
    return found
