"""The verbs `report` (the plain command) and `tune`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from evaluation.app import hydra_verb
from factory.errors import FactoryError
from factory.settings import build

if TYPE_CHECKING:
    from evaluation.settings import EvaluationSettings


def report(words: Sequence[str]) -> int:
    """`python -m evaluation dataset=DIR ...`."""
    return hydra_verb(run, "evaluation", words)


def tune(words: Sequence[str]) -> int:
    """`python -m evaluation tune dataset=DIR ...`: all baselines, when none is named."""
    named = any(word.startswith("baselines=") for word in words)
    return hydra_verb(run_tune, "evaluation", [*words, *([] if named else ["baselines=[all]"])])


def run(config: DictConfig) -> None:
    """Measure, print the leaderboard and write the files."""
    settings = settings_of(config)
    # Only after the configuration is known: `--help` and typing errors answer at once.
    from evaluation.report import build as builder

    builder.build(settings)


def run_tune(config: DictConfig) -> None:
    """Tune the baselines on validation pairs."""
    settings = settings_of(config)
    from evaluation import tuning
    from evaluation.crew import Team
    from evaluation.methods import baselines_of

    with Team(settings.workers) as team:
        print("\n".join(tuning.tune(settings, baselines_of(settings.baselines), team)))


def settings_of(config: DictConfig) -> EvaluationSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    from evaluation.settings import EvaluationSettings

    if config.dataset.dir is None:
        raise FactoryError("dataset: give the folder that `python -m factory` made, dataset=DIR")
    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings: EvaluationSettings = build(EvaluationSettings, values)
    for key, folders in (("dataset", [settings.dataset.dir]), ("robustness", settings.robustness)):
        for folder in folders:
            if not Path(folder).is_dir():
                raise FactoryError(
                    f"{key}={folder}: no such folder; give one that `python -m factory` made"
                )
    return settings
