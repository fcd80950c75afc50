"""The verbs of `simnfnd evaluate` as Hydra applications: words -> checked settings -> work.

What does the work is imported only after the configuration is known, so that `--help` and typing
errors answer at once.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

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


S = TypeVar("S")


def report(words: Sequence[str]) -> int:
    """`simnfnd evaluate dataset=DIR ...`."""
    from .judging.settings import EvaluationSettings

    return run_app(_report, "evaluation", words, EvaluationSettings)


def tune(words: Sequence[str]) -> int:
    """`simnfnd evaluate tune dataset=DIR ...`: all baselines, when none is named."""
    chosen = any(word.startswith("baselines=") for word in words)
    from .judging.settings import EvaluationSettings

    return run_app(
        _tune, "evaluation", [*words, *([] if chosen else ["baselines=[all]"])], EvaluationSettings
    )


def real(words: Sequence[str]) -> int:
    """`simnfnd evaluate real IN [KEY=VALUE ...]`."""
    from .judging.settings import RealSettings

    return run_app(_real, "real", _named(words, "real"), RealSettings)


def targets(words: Sequence[str]) -> int:
    """`simnfnd evaluate targets RECORDING... [KEY=VALUE ...]`."""
    from .judging.settings import TargetsSettings

    return run_app(
        _targets, "targets", _named(_as_keys(words), None, "recordings"), TargetsSettings
    )


def transfer(words: Sequence[str]) -> int:
    """`simnfnd evaluate transfer [DATASET] REAL [--quick] [KEY=VALUE ...]`."""
    from .judging.settings import TransferReportSettings

    return run_app(_transfer, "transfer", _transfer_words(words), TransferReportSettings)


def realism(words: Sequence[str]) -> int:
    """`simnfnd evaluate realism REAL SIM [SIM ...] [KEY=VALUE ...]`."""
    from .judging.settings import RealismSettings

    return run_app(_realism, "realism", _named(words, "real", "sim"), RealismSettings)


def fit(words: Sequence[str]) -> int:
    """`simnfnd evaluate fit REAL [KEY=VALUE ...] [-- WORDS OF simnfnd make]`."""
    own = list(words)
    recipe = []
    if "--" in own:
        place = own.index("--")
        recipe = [f"recipe={_listed(own[place + 1 :])}"]
        own = own[:place]
    from .judging.settings import FitSettings

    return run_app(_fit, "fit", [*_named(own, "real"), *recipe], FitSettings)


def _named(words: Sequence[str], first_key: str | None, rest_key: str | None = None) -> list[str]:
    """Paths as overrides: the first one of `first`, the others a list of `rest`.

    A word with `=` is one when a file or folder has that name.
    """
    plain = [
        word
        for word in words
        if not word.startswith("-") and ("=" not in word or os.path.exists(word))
    ]
    overrides = [word for word in words if word not in plain]
    if plain and first_key is not None:
        overrides.append(f"{first_key}={quote(plain.pop(0))}")
    if plain:
        if rest_key is None:
            raise FactoryError(f"{plain[0]}: unexpected; only one folder is taken here")
        overrides.append(f"{rest_key}={_listed(plain)}")
    return overrides


def _transfer_words(words: Sequence[str]) -> list[str]:
    """DATASET and REAL as keys; one folder alone is judged with the detector that ships."""
    folders = [
        word
        for word in words
        if not word.startswith("-") and ("=" not in word or os.path.exists(word))
    ]
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


def _as_keys(words: Sequence[str]) -> list[str]:
    """`--weights FILE` and `--frames N` of `simnfnd denoise` as keys of the configuration."""
    keys = {"--weights": "models", "--frames": "frames"}
    keywords: list[str] = []
    left = iter(words)
    for word in left:
        option, _, value = word.partition("=")
        if option not in keys:
            keywords.append(word)
            continue
        value = value or next(left, "")
        if not value:
            raise FactoryError(f"{option}: a value is missing")
        keywords.append(
            f"{keys[option]}={_listed([value]) if option == '--weights' else f'[{value}]'}"
        )
    return keywords


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


def _real(config: DictConfig) -> None:
    from .judging.settings import RealSettings

    settings = _checked(config, RealSettings, real="images or a recording")
    require(_needs("models=", settings.models))
    from .real.report import evaluate

    evaluate(settings)


def _targets(config: DictConfig) -> None:
    from .judging.settings import TargetsSettings

    settings = _checked(config, TargetsSettings, recordings="a static recording or several")
    require(_needs("models=", settings.models))
    from .targets.report import evaluate

    evaluate(settings)


def _transfer(config: DictConfig) -> None:
    from .judging.settings import TransferReportSettings

    settings: TransferReportSettings = build(TransferReportSettings, _values(config))
    if settings.real is None and (settings.dataset.dir is None or not settings.classes):
        raise FactoryError(
            "real: give a folder of real images with boxes, or dataset=DIR and classes=[...] to "
            "train a detector alone (see `simnfnd evaluate transfer --help`)"
        )
    from .transfer.report import evaluate

    evaluate(settings.quickened())


def _realism(config: DictConfig) -> None:
    from .judging.settings import RealismSettings

    settings = _checked(config, RealismSettings, real="both folders", sim="both folders")
    from .realism.report import evaluate

    evaluate(settings)


def _fit(config: DictConfig) -> None:
    from hydra.core.global_hydra import GlobalHydra

    from .judging.settings import FitSettings

    settings = _checked(config, FitSettings, real="a folder of real images")
    from .realism.calibrate import fit as search

    # The recipe is composed as `simnfnd make` would, by a Hydra of its own.
    GlobalHydra.instance().clear()
    search(settings)


def _checked(config: DictConfig, kind: type[S], **required: str) -> S:
    """The settings; required: key that must be given -> what to give."""
    values = _values(config)
    for key, hint in required.items():
        if not values[key]:
            raise FactoryError(f"{key}: give {hint} (see `simnfnd evaluate --help`)")
    settings: S = build(kind, values)
    return settings


def _values(config: DictConfig) -> dict[str, Any]:
    return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
