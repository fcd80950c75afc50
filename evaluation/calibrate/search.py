"""The search over the parameters, by Optuna: one study file that resumes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter

from ...factory.errors import FactoryError
from ...factory.files import explain_os_errors
from ...factory.progress import progress_bar
from ...factory.seeds import spawn_key
from ..realism.compare import STATISTICS, Comparison, Statistic, compare, overall
from ..realism.measure import Measured, measure
from ..realism.pictures import open_real
from .settings import FitSettings, Parameter
from .simulate import Simulation

if TYPE_CHECKING:
    import optuna

    from ...factory.config import FactoryConfig

_BLOCKS = 12
_SPREAD = "~spread"
_BAD = 1e3


@dataclass(frozen=True)
class Result:
    """What a search found.

    values: key -> value as a config writes it.  config: the recipe with them.
    trials: how many were tried; best: number of the best.
    before, after: the real pictures of the search against the recipe as it is and as found.
    held_out: the same two for the real pictures that the search did not see, None without.
    real, simulated: how many pictures.
    """

    values: dict[str, Any]
    config: FactoryConfig
    trials: int
    best: int
    before: list[Comparison]
    after: list[Comparison]
    held_out: tuple[list[Comparison], list[Comparison]] | None
    real: tuple[int, int]
    simulated: int


def search(settings: FitSettings) -> Result:
    """Try `trials` settings, or what is left of them, and compare the best with the recipe.

    The same settings give the same result, interrupted or not: every trial's proposal depends on
    the trials before it and on the seed.  Raises FactoryError.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    statistics = _chosen(settings.statistics)
    simulation = Simulation(settings.recipe, settings.frames, settings.grid)
    for key, parameter in settings.parameters.items():
        simulation.current(key)
        simulation.configured({key: written(parameter, *_middle(parameter))})
    searched, held = _parts(open_real(settings.real), settings)
    study = _study(settings)
    base = simulation.measured({})

    def judge(real: Measured, made: Measured, resamples: int) -> list[Comparison]:
        return compare(
            real,
            {"sim": made},
            resamples=resamples,
            halves="random",
            seed=settings.seed,
            statistics=statistics,
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
    held_out = None
    if held is not None:
        held_out = (judge(held, base, 100), judge(held, made, 100))
    return Result(
        values,
        simulation.configured(values),
        done,
        best.number,
        judge(searched, base, 100),
        judge(searched, made, 100),
        held_out,
        (len(searched), 0 if held is None else len(held)),
        len(simulation.refs),
    )


def _score(comparisons: list[Comparison]) -> float:
    """Geometric mean of the ratios, each at least 1; what cannot be measured is far away."""
    ratios = np.array([item.ratio("sim") for item in comparisons])
    return float(np.exp(np.log(np.clip(np.nan_to_num(ratios, nan=_BAD), 1, _BAD)).mean()))


def score(comparisons: list[Comparison]) -> dict[str, float]:
    """The table in three numbers."""
    return overall(comparisons, "sim")


def _chosen(names: tuple[str, ...] | None) -> Sequence[Statistic]:
    if names is None:
        return STATISTICS
    known = {statistic.name: statistic for statistic in STATISTICS}
    for name in names:
        if name not in known:
            raise FactoryError(f"statistics: no {name}; there are {', '.join(known)}")
    return [known[name] for name in names]


def _parts(real: Any, settings: FitSettings) -> tuple[Measured, Measured | None]:
    """The real pictures of the search and those held out: alternate blocks of neighbours."""
    every = measure(real, settings.grid)
    if not settings.hold_out:
        return every, None
    block = np.arange(len(every)) * _BLOCKS // len(every)
    return _rows(every, block % 2 == 0), _rows(every, block % 2 == 1)


def _rows(measured: Measured, chosen: np.ndarray[Any, Any]) -> Measured:
    names = Measured.__dataclass_fields__
    return Measured(**{name: getattr(measured, name)[chosen] for name in names})


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
        assert parameter.low is not None
        assert parameter.high is not None
        value = trial.suggest_float(key, parameter.low, parameter.high, log=parameter.log)
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
            if current in parameter.choices:
                start[key] = current
            continue
        assert parameter.low is not None
        assert parameter.high is not None
        if isinstance(current, int | float) and not isinstance(current, bool):
            start[key] = min(max(float(current), parameter.low), parameter.high)
            low, high = parameter.spreads
            if high > low:
                start[key + _SPREAD] = low
    return start


def _middle(parameter: Parameter) -> tuple[Any, float]:
    if parameter.choices is not None:
        return parameter.choices[0], 0.0
    assert parameter.low is not None
    assert parameter.high is not None
    return (parameter.low + parameter.high) / 2, parameter.spreads[1]


def written(parameter: Parameter, value: Any, spread: float = 0.0) -> Any:
    """A value and its spread as a config writes them, four digits."""
    if parameter.choices is not None:
        return value
    assert parameter.low is not None
    assert parameter.high is not None
    if spread <= 0:
        return _short(value)
    if parameter.log:
        low, high = value / (1 + spread), value * (1 + spread)
    else:
        width = spread * (parameter.high - parameter.low)
        low, high = value - width, value + width
    return {"uniform": [_short(max(low, parameter.low)), _short(min(high, parameter.high))]}


def _short(value: float) -> float:
    return float(f"{value:.4g}")
