"""`simnfnd evaluate`: how good are the pictures of a dataset, and of methods that denoise them?

simnfnd evaluate dataset=DIR [KEY=VALUE ...]        the report on a dataset's pairs
simnfnd evaluate tune dataset=DIR ...               best parameters of the baselines first
simnfnd evaluate compare A B                        is one report's row better than another's
simnfnd evaluate realism REAL SIM [SIM ...]         how near datasets are to real pictures
simnfnd evaluate real IN                            what methods make of pictures without truth
simnfnd evaluate fit REAL                           noise parameters nearest to real pictures
simnfnd evaluate --help | --cfg job                 every key; VERB --help for a verb
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from simnfnd.evaluation.app import hydra_verb
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.settings import build

if TYPE_CHECKING:
    from simnfnd.evaluation.settings import EvaluationSettings


VERBS = {
    "tune": "simnfnd.evaluation.command:tune",
    "compare": "simnfnd.evaluation.compare:main",
    "realism": "simnfnd.evaluation.realism.command:realism",
    "real": "simnfnd.evaluation.real.command:real",
    "fit": "simnfnd.evaluation.fit.command:fit",
}
"""First word -> "module:function".  The function gets the other words and returns an exit code.

A verb with a configuration of its own calls `app.hydra_verb(task, CONFIG, words)`.
"""


def main(words: Sequence[str]) -> int:
    """Run the verb that `words` begin with, or the report; returns the exit code."""
    if not words or words[0] not in VERBS:
        return report(words)
    module, function = VERBS[words[0]].split(":")
    code: int = getattr(import_module(module), function)(words[1:])
    return code


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
    # Only after the configuration is known: `--help` and typing errors answer at once.
    from simnfnd.evaluation.report import build as builder

    builder.build(settings)


def run_tune(config: DictConfig) -> None:
    """Tune the baselines on validation pairs."""
    settings = settings_of(config)
    from simnfnd.evaluation.methods import tuning
    from simnfnd.evaluation.methods.method import baselines_of
    from simnfnd.factory.workers.tasks import TaskPool

    with TaskPool(settings.workers) as pool:
        print("\n".join(tuning.tune(settings, baselines_of(settings.baselines), pool)))


def settings_of(config: DictConfig) -> EvaluationSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    from simnfnd.evaluation.settings import EvaluationSettings

    if config.dataset.dir is None:
        raise FactoryError("dataset: give the folder that `simnfnd make` made, dataset=DIR")
    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings: EvaluationSettings = build(EvaluationSettings, values)
    for key, folders in (("dataset", [settings.dataset.dir]), ("robustness", settings.robustness)):
        for folder in folders:
            if not Path(folder).is_dir():
                raise FactoryError(
                    f"{key}={folder}: no such folder; give one that `simnfnd make` made"
                )
    return settings
