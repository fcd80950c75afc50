"""How a verb of `simnfnd evaluate` becomes a Hydra application."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

from omegaconf import DictConfig

from ..factory.cli import accept_dataset_folder, run_app


def hydra_verb(task: Callable[[DictConfig], Any], config_name: str, words: Sequence[str]) -> int:
    """Run `task` with conf/<config_name>.yaml and the overrides `words`; returns the exit code.

    `dataset=DIR` means `dataset.dir=DIR`, and -m (a sweep) may stand anywhere.
    """
    flags = [word for word in words if word in ("-m", "--multirun")]
    # Hydra reads the command line itself.
    sys.argv[1:] = flags + [word for word in words if word not in flags]
    accept_dataset_folder()
    return run_app(task, config_name)
