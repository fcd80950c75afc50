"""`simnfnd evaluate fit REAL`: the noise that brings simulated pictures closest to real."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from ...factory.errors import FactoryError
from ...factory.settings import build
from ..app import hydra_verb
from ..overrides import listed, named
from .settings import FitSettings, flattened


def fit(words: Sequence[str]) -> int:
    """`simnfnd evaluate fit REAL [KEY=VALUE ...] [-- WORDS OF simnfnd make]`."""
    own, recipe = list(words), []
    if "--" in own:
        place = own.index("--")
        own, recipe = own[:place], [f"recipe={listed(own[place + 1 :])}"]
    return hydra_verb(run, "fit", [*named(own, "real"), *recipe])


def run(config: DictConfig) -> None:
    """Search, write the configuration that was found and say how to use it."""
    from hydra.core.global_hydra import GlobalHydra

    from . import files as fit_files
    from . import search as fit_search

    settings = settings_of(config)
    # The recipe is composed as `simnfnd make` would, by a Hydra of its own.
    GlobalHydra.instance().clear()
    result = fit_search.search(settings)
    print(fit_files.table(result))
    for path in fit_files.write(settings, result):
        print(f"written: {path}")
    print(
        f"use it: simnfnd make --config-dir {settings.folder} "
        f"{fit_files.usage(settings)}, or copy the files into conf/"
    )


def settings_of(config: DictConfig) -> FitSettings:
    """The checked settings.  FactoryError names the key that is wrong."""
    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    if not values["real"]:
        raise FactoryError("real: give a folder of real pictures: simnfnd evaluate fit REAL")
    # A key whose default is not wanted is set to null.
    values["parameters"] = {
        key: value for key, value in flattened(values["parameters"]).items() if value is not None
    }
    settings: FitSettings = build(FitSettings, values)
    return settings
