"""`simnfnd evaluate realism REAL SIM [SIM ...]`: how near is simulated to real?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from ...factory.errors import FactoryError
from ...factory.settings import build
from ..app import hydra_verb
from ..overrides import named

if TYPE_CHECKING:
    from .pictures import Collection
    from .settings import RealismSettings


def realism(words: Sequence[str]) -> int:
    """`simnfnd evaluate realism REAL SIM [SIM ...] [KEY=VALUE ...]`."""
    return hydra_verb(run, "realism", named(words, "real", "sim"))


def run(config: DictConfig) -> None:
    """Measure, compare, print the table and write the report."""
    from . import report, tables
    from .compare import compare
    from .measure import measure
    from .real import open_real

    settings = settings_of(config)
    real = open_real(settings.real).at_most(settings.limit)
    collections = {"real": real, **_simulations(settings)}
    measured = {name: measure(item, settings.grid) for name, item in collections.items()}
    comparisons = compare(
        measured["real"],
        {name: one for name, one in measured.items() if name != "real"},
        resamples=settings.resamples,
        halves=settings.halves,
        seed=settings.seed,
    )
    first = next(name for name in collections if name != "real")
    out = Path(settings.out or Path("outputs", "realism", first))
    report.write(out, settings, collections, measured, comparisons)
    for note in (note for item in collections.values() for note in item.notes):
        print(note)
    print(tables.table(comparisons))
    print(f"report: {out / 'realism.html'}")


def _simulations(settings: RealismSettings) -> dict[str, Collection]:
    """Name -> pictures; two folders of one name get a number."""
    from .real import open_real
    from .simulated import open_dataset

    found: dict[str, Collection] = {}
    for folder in settings.sim:
        path = Path(folder).expanduser()
        pictures = (path / "geometry.csv").is_file() or (path / "Images").is_dir()
        opened = (
            open_real(path) if pictures else open_dataset(path, settings.sim_split, settings.layer)
        )
        name, number = opened.name, 2
        while name in found or name == "real":
            name, number = f"{opened.name} {number}", number + 1
        found[name] = opened.at_most(settings.limit)
    return found


def settings_of(config: DictConfig) -> RealismSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    from .settings import RealismSettings

    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    usage = "give both folders: simnfnd evaluate realism REAL SIM"
    if not values["real"] or not values["sim"]:
        raise FactoryError(f"{'sim' if values['real'] else 'real'}: {usage}")
    if isinstance(values["sim"], str):
        values["sim"] = [values["sim"]]
    settings: RealismSettings = build(RealismSettings, values)
    return settings
