"""`simnfnd evaluate` and `simnfnd evaluate tune`: the report on a dataset's pairs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from ..factory.cli.extras import Need, require
from ..factory.errors import FactoryError
from ..factory.settings import build
from ..factory.storage.copies import local_folder
from .app import hydra_verb

if TYPE_CHECKING:
    from .settings import EvaluationSettings


def report(words: Sequence[str]) -> int:
    """`simnfnd evaluate dataset=DIR ...`."""
    return hydra_verb(run, "evaluation", words)


def tune(words: Sequence[str]) -> int:
    """`simnfnd evaluate tune dataset=DIR ...`: all baselines, when none is named."""
    named = any(word.startswith("baselines=") for word in words)
    return hydra_verb(run_tune, "evaluation", [*words, *([] if named else ["baselines=[all]"])])


def run(config: DictConfig) -> None:
    """Measure, print the leaderboard and write the files."""
    settings = settings_of(config)
    require(needs_of(settings))
    # Only after the configuration is known: `--help` and typing errors answer at once.
    from .report import build as builder

    builder.build(settings)


def run_tune(config: DictConfig) -> None:
    """Tune the baselines on validation pairs."""
    settings = settings_of(config)
    from ..factory.scheduler.workers.tasks import TaskPool
    from . import tuning
    from .methods.method import baselines_of

    with TaskPool(settings.workers) as pool:
        print("\n".join(tuning.tune(settings, baselines_of(settings.baselines), pool)))


def needs_of(settings: EvaluationSettings) -> Iterator[Need]:
    """What the networks of a report need beyond what every report does."""
    # The ones that ship are left out where there is nothing to run them.
    named = () if settings.models == "auto" else settings.models
    networks = {"models": named, "ablation": vars(settings.ablation).values()}
    for key, given in networks.items():
        if any(given):
            yield from (Need(f"{key}=", module) for module in ("torch", "safetensors"))


def settings_of(config: DictConfig) -> EvaluationSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    from .settings import EvaluationSettings

    if config.dataset.dir is None:
        raise FactoryError("dataset: give the folder that `simnfnd make` made, dataset=DIR")
    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings: EvaluationSettings = build(EvaluationSettings, values)
    folder = str(local_folder(settings.dataset.dir))
    settings = replace(settings, dataset=replace(settings.dataset, dir=folder))
    for key, folders in (("dataset", [settings.dataset.dir]), ("robustness", settings.robustness)):
        for folder in folders:
            if not Path(folder).is_dir():
                raise FactoryError(
                    f"{key}={folder}: no such folder; give one that `simnfnd make` made"
                )
    return settings
