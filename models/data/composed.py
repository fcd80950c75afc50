"""The factory's configuration of some words, while a training has one of its own."""

from __future__ import annotations

from collections.abc import Sequence

from ...factory.config import FactoryConfig


def composed(words: Sequence[str]) -> FactoryConfig:
    """The configuration of `simnfnd make` with these words.  Raises FactoryError for a bad one."""
    from hydra.core.global_hydra import GlobalHydra

    from ...factory.cli.compose import compose_config

    # Hydra composes one configuration at a time, and that of this training is the one at present.
    state = GlobalHydra.get_state()
    GlobalHydra.instance().clear()
    try:
        return compose_config(words)
    finally:
        GlobalHydra.set_state(state)
