"""`simnfnd evaluate real IN`: what methods make of real pictures and recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from ...factory.cli.extras import Need, require
from ...factory.errors import FactoryError
from ...factory.settings import build
from ..app import hydra_verb
from ..overrides import named

if TYPE_CHECKING:
    from .settings import RealSettings


def real(words: Sequence[str]) -> int:
    """`simnfnd evaluate real IN [KEY=VALUE ...]`."""
    return hydra_verb(run, "real", named(words, "real"))


def run(config: DictConfig) -> None:
    """Measure, print the table and write the report."""
    settings = settings_of(config)
    if settings.models:
        require(Need("models=", module) for module in ("torch", "safetensors"))
    from ...factory.files import check_writable
    from ...factory.scheduler.workers.tasks import TaskPool
    from ...models.recordings.fan.pings import close_last
    from ..methods.method import baselines_of, methods_of
    from ..methods.networks import networks_at
    from ..tuning import load_tuned
    from . import report
    from .judging import judge
    from .shots import open_input

    if settings.tuned is not None and not Path(settings.tuned).is_file():
        raise FactoryError(f"tuned={settings.tuned}: no such file; `evaluation tune` writes one")
    tuned = None if settings.tuned is None else load_tuned(Path(settings.tuned))
    baselines = baselines_of(settings.baselines)
    networks = networks_at(settings.models, {})
    stretches, notes = open_input(settings.real, settings.search)
    out = settings.folder
    check_writable(out, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(
            settings,
            stretches,
            baselines,
            methods_of(baselines, tuned or {}) if tuned is not None else [],
            networks,
            pool,
        )
    facts: dict[str, Any] = {
        "schema": "simnfnd-real/2",
        "name": Path(settings.real).expanduser().resolve().name,
        **outcome.facts(),
        "notes": [*notes, *outcome.notes],
    }
    report.write(out, facts, outcome)
    close_last()
    print(report.terminal(out))
    print(f"report: {out / 'real.html'}")


def settings_of(config: DictConfig) -> RealSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    from .settings import RealSettings

    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    if not values["real"]:
        raise FactoryError("real: give pictures or a recording: simnfnd evaluate real IN")
    settings: RealSettings = build(RealSettings, values)
    return settings
