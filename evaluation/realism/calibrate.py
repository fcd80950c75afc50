"""`simnfnd evaluate fit`: a search over the factory's keys by Optuna, in one file that resumes."""

from __future__ import annotations

import copy
import hashlib
import json
import shlex
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import TypeAdapter

from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.files import explain_os_errors, real_path
from ...factory.common.progress import Bar
from ...factory.common.seeds import spawn_key
from ...factory.dataset.fan_geometry import FanGeometry
from ...factory.dataset.frame_ref import FrameRef
from ...factory.dataset.pair_dataset import in_unit_range
from ...factory.simulation.config.compose import compose_config
from ...factory.simulation.config.root import FactoryConfig, from_mapping, plain
from ...factory.simulation.pairs.pair_maker import PairMaker
from ...factory.simulation.pairs.views import Views, open_views
from ..judging.settings import FitSettings, Grid, SearchedKey
from ..metrics.features import features_of
from ..metrics.statistics import evenly
from ..report.document import write_files
from .report import described, distances, real_images, to_polar

if TYPE_CHECKING:
    import optuna
    import pandas as pd

_SPREAD = "~spread"
# The groups that form an image.  What the recipe's renders, frames and files are is no part of a
# profile.
_PROFILE = ("sonar", "resample", "acoustics", "water", "noise")
_FORMS = ("uniform", "choice", "normal")


def evaluate(settings: FitSettings) -> None:
    """Run `simnfnd evaluate fit`."""
    from hydra.core.global_hydra import GlobalHydra

    # The recipe is composed as `simnfnd make` would, by a Hydra of its own.
    GlobalHydra.instance().clear()
    fit(settings)


def fit(settings: FitSettings) -> dict[str, Any]:
    """Search, write the best as a configuration and print how to use it; returns its values.

    The same settings give the same result, interrupted or not: every trial's proposal depends on
    the trials before it and on the seed.  Raises FactoryError.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    simulation = Simulation(settings.recipe, settings.frames, settings.grid)
    for key, parameter in settings.parameters.items():
        simulation.configured({key: _middle(parameter)})  # a bad key or limit ends the run here
    real = described(real_images(settings.real), settings.grid)
    study = _study(settings)

    def apart(values: Mapping[str, Any]) -> float:
        _, overall = distances(real, {"": simulation.described(values)}, settings.seed)
        return overall[""]

    before = apart({})
    finished = optuna.trial.TrialState.COMPLETE
    done = len(study.get_trials(deepcopy=False, states=(finished,)))
    with Bar(total=settings.trials, initial=done, unit="trial", desc=settings.name) as bar:
        for number in range(done, settings.trials):
            study.sampler = _sampler(settings, number)
            trial = study.ask()
            study.tell(trial, apart(_values(settings.parameters, trial)))
            bar.update()
            bar.set_postfix(f"best={study.best_value:.2f}")
    best = study.best_trial
    values = _values(settings.parameters, optuna.trial.FixedTrial(best.params))
    said = (
        f"overall distance {before:.2f} before, {study.best_value:.2f} after "
        f"{len(study.get_trials(deepcopy=False, states=(finished,)))} trials (best: {best.number})"
    )
    path = _write(settings, plain(simulation.configured(values)), said)
    print(said, f"written: {path}", sep="\n")
    print(
        f"use it: simnfnd make --config-dir {shlex.quote(str(settings.folder))} {usage(settings)}"
    )
    return values


def usage(settings: FitSettings) -> str:
    """The words that choose the result: those of the recipe that it does not hold itself."""
    fixed = [
        word
        for word in settings.recipe
        if word.lstrip("+~").split("=")[0].split(".")[0] not in ("experiment", *_PROFILE)
    ]
    return " ".join([*map(shlex.quote, fixed), f"experiment={settings.name}"])


def _write(settings: FitSettings, config: Mapping[str, Any], said: str) -> Path:
    """experiment/<name>.yaml in the folder of the fit.  FactoryError where it cannot be written."""
    real = real_path(Path(settings.real)).name
    story = (
        f"# @package _global_\n# simnfnd make {usage(settings)}\n#\n# Fitted to {real}: {said}\n"
        f"# simnfnd evaluate fit {shlex.quote(real)} name={settings.name} "
        f"trials={settings.trials} frames={settings.frames} seed={settings.seed} -- "
        f"{shlex.join(settings.recipe)}\n"
    )
    chosen = {key: _whole(config[key]) for key in _PROFILE if key in config}
    text = yaml.safe_dump(chosen, sort_keys=False, default_flow_style=None, width=100)
    write_files(settings.folder / "experiment", {f"{settings.name}.yaml": story + text})
    return settings.folder / "experiment" / f"{settings.name}.yaml"


def _whole(node: Any) -> Any:
    """Values that replace what they are merged over: a distribution says which forms it is not."""
    if not isinstance(node, dict):
        return node
    if node and set(node) <= set(_FORMS):
        return {**dict.fromkeys(_FORMS), **node}
    return {key: _whole(value) for key, value in node.items()}


def _study(settings: FitSettings) -> optuna.Study:
    """The search of these settings, a new one or the one to continue.

    Raises FactoryError where the folder holds a search with other settings.
    """
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


def _values(parameters: Mapping[str, SearchedKey], trial: Any) -> dict[str, Any]:
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


def _middle(parameter: SearchedKey) -> Any:
    if parameter.choices is not None:
        return parameter.choices[0]
    return written(parameter, sum(parameter.limits) / 2, parameter.spreads[1])


def written(parameter: SearchedKey, value: float, spread: float = 0.0) -> Any:
    """A value and its spread as a config writes them, four digits."""
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


class Simulation:
    """Makes and measures the images of a recipe, with any values of its other keys."""

    def __init__(self, recipe: tuple[str, ...], frames: int, grid: Grid) -> None:
        """Raises FactoryError when the recipe is wrong or no frame of it is rendered."""
        from ...factory.simulation.config.selection import choose_frames
        from ...factory.simulation.scenes import open_reader

        self.config = compose_config(recipe)
        self.grid = grid
        self._plain = plain(self.config)
        views = open_views(self.config)
        refs = choose_frames(open_reader(self.config.scenes).discover().frames, self.config)
        rendered = [ref for ref in refs if views.holds(ref)]
        if len(rendered) < min(8, len(refs)):
            raise FactoryError(
                f"recipe: only {len(rendered)} of its {len(refs)} frames are rendered in "
                f"{self.config.cache.folder}; run `simnfnd make {shlex.join(recipe)}` first"
            )
        spread = evenly(rendered, frames)
        self._views = Views({ref: views.view(ref) for ref in spread})
        maker = PairMaker(self.config, self._views)
        self.refs: list[FrameRef] = []
        for ref in spread:
            with suppress(FrameError):  # the factory leaves out frames that make no image
                maker.pairs(ref, (0,))
                self.refs.append(ref)
        if not self.refs:
            raise FactoryError("recipe: the sonar sees nothing in any of its frames; see sonar.*")

    def configured(self, values: Mapping[str, Any]) -> FactoryConfig:
        """The recipe's configuration with some keys set.  Raises FactoryError for a bad key."""
        tree = copy.deepcopy(self._plain)
        for key, value in values.items():
            *parents, last = key.split(".")
            node: Any = tree
            for part in parents:
                node = node.get(part) if isinstance(node, dict) else None
            if not isinstance(node, dict) or last not in node:
                raise FactoryError(f"parameters.{key}: the factory has no such key")
            node[last] = value
        return from_mapping(tree)

    def described(self, values: Mapping[str, Any]) -> pd.DataFrame:
        """The features of the images that these values make."""
        import pandas as pd

        config = self.configured(values)
        maker = PairMaker(config, self._views)
        rows = []
        for ref in self.refs:
            (pair,) = maker.pairs(ref, (0,))
            geometry = FanGeometry.from_record(config.sonar, pair.record)
            polar = to_polar(in_unit_range(pair.noisy), geometry, self.grid)
            rows.append(features_of(polar, geometry.range_span_m))
        return pd.DataFrame(rows)
