"""The search over the parameters, by Optuna: one study file that resumes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter

from ...factory.errors import FactoryError
from ...factory.files import explain_os_errors
from ...factory.progress import progress_bar
from ...factory.seeds import spawn_key
from ..realism.compare import compare, ratios
from ..realism.measure import Measured, measure
from ..realism.pictures import open_real
from .settings import FitSettings, Parameter
from .simulate import Simulation

if TYPE_CHECKING:
    import optuna
    import pandas as pd

    from ...factory.config import FactoryConfig

SIM = "sim"
"""What comparisons call the simulated pictures."""
_BLOCKS = 12
_SPREAD = "~spread"
_BAD = 1e3


@dataclass(frozen=True, eq=False)
class Result:
    """What a search found.

    values: key -> value as a config writes it.  config: the recipe with them.
    trials: how many were tried; best: number of the best.  simulated: how many pictures.
    parts: what real pictures -> comparison with the recipe as it is, and as found.
    """

    values: dict[str, Any]
    config: FactoryConfig
    trials: int
    best: int
    simulated: int
    parts: dict[str, tuple[pd.DataFrame, pd.DataFrame]]


def search(settings: FitSettings) -> Result:
    """Try `trials` settings, or what is left of them, and compare the best with the recipe.

    The same settings give the same result, interrupted or not: every trial's proposal depends on
    the trials before it and on the seed.  Raises FactoryError.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    simulation = Simulation(settings.recipe, settings.frames, settings.grid)
    for key, parameter in settings.parameters.items():
        simulation.current(key)
        middle = parameter.choices[0] if parameter.choices else sum(parameter.limits) / 2
        simulation.configured({key: written(parameter, middle, parameter.spreads[1])})
    real = _parts(measure(open_real(settings.real), settings.grid), settings.hold_out)
    searched = next(iter(real.values()))
    study = _study(settings)
    base = simulation.measured({})

    def judge(part: Measured, made: Measured, resamples: int) -> pd.DataFrame:
        return compare(
            part,
            {SIM: made},
            resamples=resamples,
            halves="random",
            seed=settings.seed,
            progress=False,
        )

    finished = optuna.trial.TrialState.COMPLETE
    done = len(study.get_trials(deepcopy=False, states=(finished,)))
    with progress_bar(total=settings.trials, initial=done, unit="trial", desc=settings.name) as bar:
        while done < settings.trials:
            if done == 0 and not study.get_trials(deepcopy=False):
                study.enqueue_trial(_start(settings.parameters, simulation))
            study.sampler = _sampler(settings, done)
            trial = study.ask()
            made = simulation.measured(_values(settings.parameters, trial))
            study.tell(trial, _score(judge(searched, made, settings.resamples)))
            done += 1
            bar.update()
            bar.set_postfix(best=f"{study.best_value:.2f}")
    best = study.best_trial
    values = _values(settings.parameters, optuna.trial.FixedTrial(best.params))
    made = simulation.measured(values)
    parts = {name: (judge(part, base, 100), judge(part, made, 100)) for name, part in real.items()}
    config, simulated = simulation.configured(values), len(simulation.refs)
    return Result(values, config, done, best.number, simulated, parts)


def _score(compared: pd.DataFrame) -> float:
    """Geometric mean of the ratios, each at least 1; what cannot be measured is far away."""
    found = ratios(compared, SIM).to_numpy(float)
    return float(np.exp(np.log(np.clip(np.nan_to_num(found, nan=_BAD), 1, _BAD)).mean()))


def _parts(every: Measured, hold_out: bool) -> dict[str, Measured]:
    """The real pictures of the search, first, and those held out: alternate blocks."""
    count = len(every["amplitude"])
    block = np.arange(count) * _BLOCKS // count % 2
    odds = {"of the search": 0, "kept from it": 1} if hold_out else {"of the search": block}
    found: dict[str, Measured] = {}
    for what, odd in odds.items():
        rows = block == odd
        found[f"{int(rows.sum())} real pictures {what}"] = {
            name: values[rows] for name, values in every.items()
        }
    return found


def _study(settings: FitSettings) -> optuna.Study:
    import optuna
    from optuna.storages.journal import JournalFileBackend

    folder = settings.folder
    values = TypeAdapter(FitSettings).dump_python(settings, mode="json")
    # More trials continue the same search, wherever it is kept.
    identity = {k: v for k, v in values.items() if k not in ("trials", "out", "name", "debug")}
    text = json.dumps(identity, sort_keys=True)
    digest = hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
    with explain_os_errors(folder, "out"):
        folder.mkdir(parents=True, exist_ok=True)
    journal = folder / "study.journal"
    storage = optuna.storages.JournalStorage(JournalFileBackend(str(journal)))
    names = [study.study_name for study in storage.get_all_studies()]
    if names and names != [digest]:
        raise FactoryError(
            f"out={folder}: holds a search with other settings; remove {journal} or choose "
            "another out="
        )
    return optuna.create_study(
        study_name=digest, storage=storage, direction="minimize", load_if_exists=True
    )


def _sampler(settings: FitSettings, number: int) -> optuna.samplers.BaseSampler:
    """A sampler for one trial alone: what it proposes does not depend on when the search began."""
    import optuna

    seed = spawn_key(settings.seed, "fit", number)[0]
    if number < settings.startup:
        return optuna.samplers.RandomSampler(seed=seed)
    return optuna.samplers.TPESampler(
        seed=seed, multivariate=True, n_startup_trials=1, n_ei_candidates=64
    )


def _values(parameters: Mapping[str, Parameter], trial: Any) -> dict[str, Any]:
    """The trial's proposal as values of a config."""
    values: dict[str, Any] = {}
    for key, parameter in parameters.items():
        if parameter.choices is not None:
            values[key] = trial.suggest_categorical(key, list(parameter.choices))
            continue
        value = trial.suggest_float(key, *parameter.limits, log=parameter.log)
        low, high = parameter.spreads
        spread = trial.suggest_float(key + _SPREAD, low, high) if high > low else low
        values[key] = written(parameter, value, spread)
    return values


def _start(parameters: Mapping[str, Parameter], simulation: Simulation) -> dict[str, Any]:
    """What the recipe says, as far as the limits allow: the first trial."""
    start: dict[str, Any] = {}
    for key, parameter in parameters.items():
        current = simulation.current(key)
        if isinstance(current, dict):
            kind, numbers = next(iter(current.items()))
            current = numbers[0] if kind == "normal" else (min(numbers) + max(numbers)) / 2
        if parameter.choices is not None:
            start |= {key: current} if current in parameter.choices else {}
        elif isinstance(current, int | float) and not isinstance(current, bool):
            low, high = parameter.limits
            start[key] = min(max(float(current), low), high)
            low, high = parameter.spreads
            start |= {key + _SPREAD: low} if high > low else {}
    return start


def written(parameter: Parameter, value: Any, spread: float = 0.0) -> Any:
    """A value and its spread as a config writes them, four digits."""
    if parameter.choices is not None:
        return value
    if spread <= 0:
        return _short(value)
    least, most = parameter.limits
    if parameter.log:
        low, high = value / (1 + spread), value * (1 + spread)
    else:
        width = spread * (most - least)
        low, high = value - width, value + width
    return {"uniform": [_short(max(low, least)), _short(min(high, most))]}


def _short(value: float) -> float:
    return float(f"{value:.4g}")
