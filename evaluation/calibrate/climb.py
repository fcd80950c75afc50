"""A local search: every proposal is the best settings so far with a few of them changed.

For a recipe that is good already and has many keys: there most of what a global search proposes is
worse than what one begins with.  After the (1+1) evolution strategy with a step that grows with
success and shrinks without (Rechenberg 1973), on one to four keys at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
)
from optuna.samplers import BaseSampler, RandomSampler
from optuna.trial import FrozenTrial, TrialState

_FIRST, _LEAST, _MOST = 0.15, 0.05, 0.25
"""Step, as a part of the limits: at first, at least and at most."""
_SUCCESS, _FAILURE = 1.1, 0.985
_KEYS = 4
"""Most keys that a proposal changes."""

Search = Mapping[str, BaseDistribution]


class Climb(BaseSampler):
    """Proposes for one trial; what it proposes depends on the seed and on the trials before it."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._random = RandomSampler(seed=seed)

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """The keys of the best trial so far; none before there is one."""
        return dict(study.best_trial.distributions) if _finished(study) else {}

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The best values with some of them changed."""
        if not search_space:
            return {}
        values = dict(study.best_trial.params)
        step = step_after([one.value or 0.0 for one in _finished(study)])
        names = sorted(search_space)
        count = int(self._rng.integers(1, min(_KEYS, len(names)) + 1))
        for place in self._rng.permutation(len(names))[:count]:
            name = names[int(place)]
            values[name] = self._moved(values[name], search_space[name], step)
        return values

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """At random: a key of the first trial of which the recipe says nothing."""
        return self._random.sample_independent(study, trial, param_name, param_distribution)

    def _moved(self, value: Any, limits: BaseDistribution, step: float) -> Any:
        if isinstance(limits, CategoricalDistribution):
            others = [choice for choice in limits.choices if choice != value]
            return others[int(self._rng.integers(len(others)))] if others else value
        assert isinstance(limits, FloatDistribution)
        low, high = _ends(limits)
        place = np.log(value) if limits.log else value
        moved = np.clip(place + step * (high - low) * self._rng.standard_normal(), low, high)
        found = float(np.exp(moved)) if limits.log else float(moved)
        return min(max(found, limits.low), limits.high)


def step_after(values: Sequence[float]) -> float:
    """The step after trials with these scores, in their order; lower is better."""
    step, best = _FIRST, np.inf
    for number, value in enumerate(values):
        if value < best:
            best = value
            step = min(step * _SUCCESS, _MOST) if number else step
        else:
            step = max(step * _FAILURE, _LEAST)
    return step


def _ends(limits: FloatDistribution) -> tuple[float, float]:
    if limits.log:
        return float(np.log(limits.low)), float(np.log(limits.high))
    return limits.low, limits.high


def _finished(study: optuna.Study) -> list[FrozenTrial]:
    return study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
