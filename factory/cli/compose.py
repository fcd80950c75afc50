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
    # Hydra brings antlr and plugins; those who only look at a folder must not pay for it.
    from hydra import compose, initialize_config_module
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    from ..config import composed_values, from_mapping
    from ..distribution import as_override
    from . import config_line

    overrides = [as_override(word) for word in readable(words) if not word.startswith("-")]
    try:
        with initialize_config_module("simnfnd.conf", version_base="1.3"):
            composed = compose("factory", overrides=overrides)
        if scenes is not None:
            OmegaConf.set_struct(composed, False)
            composed.scenes = dict(scenes)
        return from_mapping(composed_values(composed))
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
