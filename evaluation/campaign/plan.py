"""What a campaign consists of: commands, in order of importance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...models import WEIGHTS_NAME
from .settings import CampaignSettings, Places, RowSettings

EFFECTS = ("range_spreading", "multipath", "azimuth", "background")
"""The paper's four kinds of noise; each has a test set with nothing else."""
_ALL_TEST = "split.test=['*']"


@dataclass(frozen=True)
class Step:
    """One command.

    name: unique, and the name of its record.  verb: the first word of `simnfnd`.  words: the rest.
    row: of a training, whose number of steps comes from its budget; else None.
    start: weights from which a training goes on.
    """

    name: str
    verb: str
    words: tuple[str, ...]
    row: RowSettings | None = None
    start: Path | None = None


@dataclass(frozen=True)
class Folders:
    """Where a campaign keeps what it makes."""

    out: Path

    def data(self, name: str) -> Path:
        """A dataset."""
        return self.out / "data" / name

    def model(self, row: str, seed: int) -> Path:
        """A training."""
        return self.out / "models" / f"{row}-s{seed}"

    def report(self, name: str) -> Path:
        """The report on a test set."""
        return self.out / "reports" / name

    def pack(self, name: str) -> Path:
        """The renders of a dataset in one file."""
        return self.out / f"{name}.pack"

    @property
    def tuned(self) -> Path:
        """The tuned parameters of the classical methods."""
        return self.out / "tuned.json"


def training_name(row: str, seed: int) -> str:
    """The name of the step that trains a row with a seed."""
    return f"train-{row}-s{seed}"


def test_sets(settings: CampaignSettings) -> list[str]:
    """Names of the test sets: the two that count, then those where no picture may get worse."""
    real = ["real"] if settings.data.flsea else []
    return ["procedural", *real, "zero", *(f"only_{effect}" for effect in EFFECTS)]


def data_steps(settings: CampaignSettings) -> Iterator[Step]:
    """Datasets: what trains, what tests, and the tuning of the classical methods."""
    folders, data = Folders(Path(settings.out)), settings.data
    cache = f"cache.dir='{folders.out / 'cache'}'"

    def dataset(name: str, *words: str) -> Step:
        words = (*data.words, *words, f"dataset.dir='{folders.data(name)}'", cache)
        return Step(f"data-{name}", "make", words)

    def places(chosen: Places) -> tuple[str, ...]:
        return (
            "scenes=seabed",
            f"scenes.first_location={chosen.first}",
            f"scenes.locations={chosen.locations}",
            f"scenes.frames_per_location={chosen.frames}",
            f"scenes.width={chosen.width}",
            f"scenes.height={chosen.height}",
        )

    train = ("split.test=[]", "split.test_fraction=0", "dataset.max_train=null")
    test = (_ALL_TEST, "dataset.max_test=null")
    for name, chosen in (("train", data.train), ("sparse", data.sparse), ("wide", data.wide)):
        if chosen is None:
            continue
        step = dataset(name, *places(chosen), *train)
        yield step
        if data.pack is not None:
            small = ("--small",) if data.pack == "small" else ()
            words = ("pack", *step.words, "--out", str(folders.pack(name)), *small)
            yield Step(f"pack-{name}", "cache", words)
    yield dataset("procedural", *places(data.test), *test)
    if data.flsea:
        real = (f"scenes.root='{data.flsea}'", f"frames.variants={data.variants}")
        yield dataset("real", "scenes=flsea", *real, *test)
    yield dataset("zero", *places(data.checks), *test, "noise=none")
    for effect in EFFECTS:
        off = [f"noise.{other}.enabled=false" for other in EFFECTS if other != effect]
        yield dataset(f"only_{effect}", *places(data.checks), *test, *off)
    tune = ("tune", f"dataset.dir='{folders.data('train')}'", f"tuning.file='{folders.tuned}'")
    methods = f"baselines=[{','.join(settings.baselines)}]"
    yield Step("tune", "evaluate", (*tune, methods))


def training_steps(settings: CampaignSettings) -> Iterator[Step]:
    """The trainings, in the order of the list.  OldData is left out where there is no MDD.

    A row that begins from the weights of another comes after all that need fewer before them.
    """
    folders, data = Folders(Path(settings.out)), settings.data
    seeds = {row.name: row.seeds for row in reversed(settings.rows)}
    for row in sorted(settings.rows, key=settings.depth):
        if row.data == "olddata" and data.mdd is None:
            continue
        for seed in row.seeds:
            source: tuple[str, ...]
            if row.data == "olddata":
                source = (
                    "data=olddata",
                    f"data.folder='{data.mdd}/Images'",
                    f"data.geometry='{data.mdd}/fan_geometry.csv'",
                )
            elif row.data == "self_supervised":
                source = ("data=self_supervised", f"data.folder='{folders.data(row.places)}'")
            else:
                renders = f"data.cache='{folders.out / 'cache'}'"
                if data.pack is not None:
                    renders = f"data.pack='{folders.pack(row.places)}'"
                source = ("data=renders", f"dataset.dir='{folders.data(row.places)}'", renders)
            start = None
            if row.start is not None:
                begun = seed if seed in seeds[row.start] else seeds[row.start][0]
                start = folders.model(row.start, begun) / WEIGHTS_NAME
                source = (*source, f"start='{start}'")
            out = f"out='{folders.model(row.name, seed)}'"
            words = (*source, *settings.words, *row.words, f"seed={seed}", out)
            yield Step(training_name(row.name, seed), "train", words, row, start)


def report_steps(settings: CampaignSettings, trained: list[str]) -> Iterator[Step]:
    """Reports on every test set, of the trainings that are there (folders), and the table."""
    folders = Folders(Path(settings.out))
    networks = ",".join(f"'{folder}'" for folder in trained)
    for name in test_sets(settings):
        counts = name in ("procedural", "real")
        methods = ",".join(settings.baselines) if counts else ""
        words = (
            f"dataset.dir='{folders.data(name)}'",
            f"models=[{networks}]",
            f"baselines=[{methods}]",
            f"tuning.file='{folders.tuned}'",
            "tuning.auto=false",
            f"out='{folders.report(name)}'",
            *settings.evaluation,
        )
        yield Step(f"report-{name}", "evaluate", words)
    yield Step("table", "campaign", ("table", str(folders.out)))
