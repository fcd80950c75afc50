"""The verbs of `simnfnd evaluate` as Hydra applications: words -> checked settings -> work.

What does the work is imported only after the configuration is known, so that `--help` and typing
errors answer at once.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from ..factory.common.errors import FactoryError
from ..factory.common.extras import Need, require
from ..factory.common.settings import build
from ..factory.common.words import quote
from ..factory.dataset.storage import local_folder
from ..factory.simulation.config.application import run_app
from ..models import WEIGHTS_NAME

if TYPE_CHECKING:
    from .judging.settings import EvaluationSettings


def report(words: Sequence[str]) -> int:
    """`simnfnd evaluate dataset=DIR ...`."""
    from .judging.settings import EvaluationSettings

    return run_app(_report, "evaluation", words, EvaluationSettings)


def tune(words: Sequence[str]) -> int:
    """`simnfnd evaluate tune dataset=DIR ...`: all baselines, when none is named."""
    from .judging.settings import EvaluationSettings

    if not any(word.startswith("baselines=") for word in words):
        words = [*words, "baselines=[all]"]
    return run_app(_tune, "evaluation", words, EvaluationSettings)


def real(words: Sequence[str]) -> int:
    """`simnfnd evaluate real IN [KEY=VALUE ...]`."""
    overrides = _named(words, "real")
    return _run("real", overrides, "RealSettings", real="images or a recording")


def targets(words: Sequence[str]) -> int:
    """`simnfnd evaluate targets RECORDING... [KEY=VALUE ...]`."""
    overrides = _named(words, None, "recordings")
    hint = "a static recording or several"
    return _run("targets", overrides, "TargetsSettings", recordings=hint)


def transfer(words: Sequence[str]) -> int:
    """`simnfnd evaluate transfer [DATASET] REAL [--quick] [KEY=VALUE ...]`."""
    return _run("transfer", _transfer_words(words), "TransferReportSettings")


def realism(words: Sequence[str]) -> int:
    """`simnfnd evaluate realism REAL SIM [SIM ...] [KEY=VALUE ...]`."""
    hint = "both folders"
    return _run("realism", _named(words, "real", "sim"), "RealismSettings", real=hint, sim=hint)


def fit(words: Sequence[str]) -> int:
    """`simnfnd evaluate fit REAL [KEY=VALUE ...] [-- WORDS OF simnfnd make]`."""
    split = list(words).index("--") if "--" in words else len(words)
    overrides = _named(words[:split], "real")
    if recipe := words[split + 1 :]:
        overrides.append(f"recipe={_listed(recipe)}")
    return _run(
        "fit", overrides, "FitSettings", "realism.calibrate", real="a folder of real images"
    )


def _run(name: str, words: Sequence[str], settings: str, module: str = "", **required: str) -> int:
    """Run `evaluate` of a module on the settings of conf/<name>.yaml.

    settings: name of their class.  module: that of the report by default.
    required: key that must be given -> what to give.
    """
    kind = getattr(import_module(".judging.settings", __package__), settings)

    def task(config: DictConfig) -> None:
        values = _values(config)
        for key, hint in required.items():
            if not values[key]:
                raise FactoryError(f"{key}: give {hint} (see `simnfnd evaluate --help`)")
        checked = build(kind, values)
        require(_needs("models=", getattr(checked, "models", ())))
        import_module(f".{module or f'{name}.report'}", __package__).evaluate(checked)

    return run_app(task, name, words, kind)


def _named(words: Sequence[str], first_key: str | None, rest_key: str | None = None) -> list[str]:
    """Paths as overrides: the first one of `first`, the others a list of `rest`."""
    paths = _paths(words)
    overrides = [word for word in words if word not in paths]
    if paths and first_key is not None:
        overrides.append(f"{first_key}={quote(paths.pop(0))}")
    if paths:
        if rest_key is None:
            raise FactoryError(f"{paths[0]}: unexpected; only one folder is taken here")
        overrides.append(f"{rest_key}={_listed(paths)}")
    return overrides


def _paths(words: Sequence[str]) -> list[str]:
    """The words that are paths; one with `=` is one when a file or folder has that name."""
    return [
        word
        for word in words
        if not word.startswith("-") and ("=" not in word or os.path.exists(word))
    ]


def _transfer_words(words: Sequence[str]) -> list[str]:
    """DATASET and REAL as keys; one folder alone is judged with the detector that ships."""
    folders = _paths(words)
    overrides = [word for word in words if word not in folders and word != "--quick"]
    if "--quick" in words:
        overrides.append("quick=true")
    if len(folders) > 2:
        raise FactoryError(f"{folders[2]}: unexpected; give DATASET and REAL alone")
    keys = ("dataset", "real")[-len(folders) :] if folders else ()
    keys_in_words = {word.partition("=")[0] for word in words}
    if keys == ("real",) and not keys_in_words & {"detector", "dataset"}:
        overrides.append("detector=simnfnd")
    return [*overrides, *(f"{key}={quote(word)}" for key, word in zip(keys, folders, strict=True))]


def _listed(words: Sequence[str]) -> str:
    """Words as a list in Hydra's grammar."""
    return f"[{','.join(map(quote, words))}]"


def settings_of(config: DictConfig) -> EvaluationSettings:
    """The checked settings of a report.  FactoryError names the key that is wrong."""
    from .judging.settings import EvaluationSettings

    if config.dataset.dir is None:
        raise FactoryError("dataset: give the folder that `simnfnd make` made, dataset=DIR")
    settings: EvaluationSettings = build(EvaluationSettings, _values(config))
    folder = str(local_folder(settings.dataset.dir))
    if not Path(folder).is_dir():
        raise FactoryError(f"dataset={folder}: no such folder; give one that `simnfnd make` made")
    return replace(settings, dataset=replace(settings.dataset, dir=folder))


def _needs(key: str, models: Iterable[str | None]) -> Iterator[Need]:
    """The modules that networks need: onnxruntime where there is a graph of them, else torch.

    models: weights files, folders of trainings or names of weights that ship.  Raises FactoryError
    for a file that holds no network.
    """
    for model in filter(None, models):
        yield Need(key, "safetensors")
        yield Need(key, _runtime_of(model))


def _runtime_of(model: str) -> str:
    """`torch` or `onnxruntime`."""
    path = Path(model).expanduser()
    weights = path / WEIGHTS_NAME if path.is_dir() else path
    if not weights.is_file() or find_spec("safetensors") is None:
        # A name of weights that ship, or an error that is reported when the file is opened.
        return "onnxruntime"
    from ..models.denoise.runtime import find_graph

    return "torch" if find_graph(weights) is None else "onnxruntime"


def _report(config: DictConfig) -> None:
    settings = settings_of(config)
    # The networks that ship are left out where there is nothing to run them.
    require(_needs("models=", [] if settings.models == "auto" else settings.models))
    require(_needs("ablation=", settings.ablation.values()))
    from .report.build import build as build_report

    build_report(settings)


def _tune(config: DictConfig) -> None:
    settings = settings_of(config)
    from ..factory.common.workers.tasks import TaskPool
    from .judging import tuning
    from .judging.methods import baselines_of

    with TaskPool(settings.workers) as pool:
        print("\n".join(tuning.tune(settings, baselines_of(settings.baselines), pool)))


def _values(config: DictConfig) -> dict[str, Any]:
    return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
