"""The configuration that command-line words mean, without running anything."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..errors import FactoryError
from .words import readable

if TYPE_CHECKING:
    from ..config import FactoryConfig


def compose_config(words: Sequence[str], scenes: Mapping[str, Any] | None = None) -> FactoryConfig:
    """The configuration of `simnfnd make WORDS`.  Raises FactoryError for a bad word.

    scenes: values of the group `scenes`, instead of those that the words mean.
    """
    single = [word for word in words if word not in ("-m", "--multirun")]
    ((_, config),) = compose_points(single, scenes)
    return config


def compose_points(
    words: Sequence[str], scenes: Mapping[str, Any] | None = None
) -> list[tuple[tuple[str, ...], FactoryConfig]]:
    """The points of a sweep (one without `-m`): what distinguishes each, and its configuration.

    Raises FactoryError for a bad word.
    """
    # Hydra brings antlr and plugins; those who only look at a folder must not pay for it.
    from hydra import compose, initialize_config_module
    from hydra.core.plugins import Plugins
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from ..config import composed_values, from_mapping
    from ..distribution import as_override
    from . import config_line

    sweep = any(word in ("-m", "--multirun") for word in words)
    overrides = [as_override(word) for word in readable(words) if not word.startswith("-")]
    try:
        with initialize_config_module("simnfnd.conf", version_base="1.3"):
            chosen_by_point = [overrides]
            if sweep:
                Plugins.instance()
                # Those that choose groups: enough to know what an experiment sweeps over.
                recipes = [word for word in overrides if word.startswith("experiment=")]
                root = compose("factory", overrides=recipes, return_hydra_config=True)
                # None in a plain sweep, a mapping where an experiment brings its own.
                chosen_by_point = sweep_points(overrides, dict(root.hydra.sweeper.params or {}))
            points = []
            for chosen in chosen_by_point:
                composed = compose("factory", overrides=chosen)
                if scenes is not None:
                    OmegaConf.set_struct(composed, False)
                    composed.scenes = dict(scenes)
                config = from_mapping(composed_values(composed))
                differs = [
                    word
                    for word, others in zip(chosen, zip(*chosen_by_point, strict=True), strict=True)
                    if len(set(others)) > 1
                ]
                points.append((tuple(differs), config))
            return points
    except (HydraException, OmegaConfBaseException) as error:
        raise FactoryError(config_line(error, "factory")) from error


def sweep_points(overrides: Sequence[str], params: Mapping[str, Any]) -> list[list[str]]:
    """The overrides of every point of a sweep, in Hydra's order: the last axis changes fastest.

    params: what an experiment sweeps over, where the words say nothing else.
    """
    from hydra.core.override_parser.overrides_parser import OverridesParser

    given = {word.split("=")[0] for word in overrides}
    more = [f"{key!s}={value}" for key, value in params.items() if key not in given]
    axes = [
        [f"{one.get_key_element()}={value}" for value in one.sweep_string_iterator()]
        if one.is_sweep_override()
        else [one.input_line or ""]
        for one in OverridesParser.create().parse_overrides([*more, *overrides])
    ]
    return [list(point) for point in itertools.product(*axes)]
