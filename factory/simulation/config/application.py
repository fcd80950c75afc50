"""Runs a verb as a Hydra application: words or a sweep in, an exit code out."""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from ...common.command_line import guard
from ...common.errors import FactoryError

if TYPE_CHECKING:
    from omegaconf import DictConfig

_INTERRUPTED = (128 + signal.SIGINT, 128 + signal.SIGTERM)


class _Stopped(BaseException):
    """A point of a sweep was interrupted, and has said so."""


def run_app(
    task: Callable[[DictConfig], Any], config_name: str, words: Sequence[str], settings: type
) -> int:
    """Run `task` as a Hydra application (`words` or a sweep, `-m`) and return the exit code.

    `task` gets the composed config and returns None or an int exit code.
    settings: the class of the whole configuration, whose types say which keys hold names and paths.

    FactoryError and every mistake in the configuration become one line on stderr and exit code 2; a
    traceback is shown only with `debug=true`.  In a sweep a point that fails does not stop the
    others, Ctrl-C does; the largest exit code is returned.
    """
    # Hydra imports antlr and plugins; `factory` as a library must not pay for it.
    import hydra
    from hydra.errors import HydraException
    from omegaconf.errors import OmegaConfBaseException

    from .compose import config_line, hydra_words, sweep_points
    from .hydra_loader import load, register_search_path

    register_search_path()
    # Without this Hydra prints its own multi-line text and exits with 1.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    debug = any(word.replace(" ", "") in ("debug=true", "debug=True") for word in words)
    if config_name != "factory":
        # Hydra takes `dataset=DIR` for a choice of the group of that name, which `make` has.
        words = [re.sub("^dataset=", "dataset.dir=", word) for word in words]
    words = hydra_words(words, config_name, settings)
    sweeping = bool({"-m", "--multirun"} & set(words))
    # Hydra reads the command line, and refuses a flag between overrides.
    sys.argv[1:] = sorted(words, key=lambda word: word not in ("-m", "--multirun"))
    codes: list[int] = []

    def point(config: DictConfig) -> int:
        code = guard(lambda: task(config), debug=debug)
        codes.append(code)
        if code in _INTERRUPTED:
            # Hydra would go on with the next point of a sweep.
            raise _Stopped
        return code

    start = hydra.main("pkg://simnfnd.conf", config_name, version_base="1.3")

    def everything() -> int:
        try:
            if sweeping:
                # A mistyped key would fail at every point, and leave a report of none.
                overrides = [word for word in words if not word.startswith("-")]
                load(config_name, sweep_points(overrides, {})[0])
            start(point)()
        except _Stopped:
            pass
        except (HydraException, OmegaConfBaseException) as error:
            if debug:
                raise
            raise FactoryError(config_line(error, config_name)) from error
        except RuntimeError as error:
            if debug or '"srun"' not in str(error):
                raise
            raise FactoryError(
                "hydra/launcher=submitit_slurm: no srun here; give the command on a machine of "
                "the Slurm cluster, or hydra/launcher=submitit_local"
            ) from error
        finally:
            # Writes the table of a sweep; the module is loaded only where one was begun.
            if sweep := sys.modules.get("simnfnd.factory.production.cli.sweep"):
                sweep.write_table()
        return max(codes, default=0)

    return guard(everything, debug=debug)
