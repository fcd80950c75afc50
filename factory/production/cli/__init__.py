"""Holds what the verbs share: words in, one clear line and an exit code out."""

from __future__ import annotations

import argparse
import errno
import os
import re
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from ...common.errors import FactoryError

if TYPE_CHECKING:
    from omegaconf import DictConfig

EXIT_BAD_INPUT = 2
# What the workers of `make` are forked with.
PRELOADED = ("simnfnd.factory.production.cli.preloaded",)
_OF_THE_MACHINE = {
    *(errno.EACCES, errno.EPERM, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOSPC, errno.EROFS),
    *(errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ESTALE, errno.ENOMEM),
}
_HINTS = {
    errno.EMFILE: "raise `ulimit -n`, or give fewer scheduler.workers",
    errno.ENOMEM: "raise `ulimit -v`, or give fewer scheduler.workers",
}


_INTERRUPTED = (128 + signal.SIGINT, 128 + signal.SIGTERM)


class _Stopped(BaseException):
    """A point of a sweep was interrupted, and has said so."""


_URL = re.compile(r"[a-z][a-z0-9+.-]+://")


class Parser(argparse.ArgumentParser):
    """Parses the words of verbs with options, and reports mistakes in one line."""

    def error(self, message: str) -> NoReturn:
        """Raise FactoryError, like every other mistake of the user."""
        raise FactoryError(f"{self.prog}: {message} (see `{self.prog} --help`)")

    def _get_value(self, action: argparse.Action, word: str) -> Any:
        if action.type is Path and _URL.match(word):
            raise FactoryError(
                f"{self.prog}: {word}: works on files of this machine; fetch the dataset first, "
                "for example with `aws s3 sync` or `rclone copy`"
            )
        return super()._get_value(action, word)


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

    from .compose import config_line, hydra_words
    from .hydra_loader import register_search_path

    register_search_path()
    # Without this Hydra prints its own multi-line text and exits with 1.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    debug = any(word.replace(" ", "") in ("debug=true", "debug=True") for word in words)
    if config_name != "factory":
        # Hydra takes `dataset=DIR` for a choice of the group of that name, which `make` has.
        words = [re.sub("^dataset=", "dataset.dir=", word) for word in words]
    words = hydra_words(words, config_name, settings)
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


def guard(action: Callable[[], Any], *, debug: bool = False) -> int:
    """Run `action`; turn an error that a user can correct into one line and an exit code."""
    try:
        result = action()
        return result if isinstance(result, int) else 0
    except FactoryError as error:
        if debug:
            raise
        return say_error(error)
    except BrokenPipeError:
        # The reader of our output (a pager, head) went away: not an error of ours.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE
    except OSError as error:
        # Not a defect of ours: a folder that may not be read, too many open files, a dead disk.
        if debug or error.errno not in _OF_THE_MACHINE:
            raise
        place = error.filename if isinstance(error.filename, str | os.PathLike) else "system"
        hint = _HINTS.get(error.errno, "see that it can be used")
        return say_error(FactoryError(f"{os.fspath(place)}: {error.strerror}; {hint}"))
    except MemoryError:
        if debug:
            raise
        hint = _HINTS[errno.ENOMEM]
        return say_error(FactoryError(f"memory: not enough of it; {hint}"))
    except KeyboardInterrupt as stopped:
        # Who knows better what is kept says so in the exception.
        kept_note = getattr(stopped, "kept", "what was finished is kept, run again to go on")
        print(f"error: {getattr(stopped, 'said', f'interrupted; {kept_note}')}", file=sys.stderr)
        # SIGTERM comes as a KeyboardInterrupt that knows its own exit code.
        return int(getattr(stopped, "exit_code", 128 + signal.SIGINT))


def say_error(error: Exception) -> int:
    """Print the one line of a user-facing error and return its exit code."""
    print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
    return EXIT_BAD_INPUT


def markdown(names: list[str], rows: list[list[str]]) -> str:
    """A Markdown table with aligned columns."""
    widths = [max(len(cell) for cell in column) for column in zip(names, *rows, strict=True)]
    lines = [names, ["-" * width for width in widths], *rows]
    return "".join(
        "| "
        + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        + " |\n"
        for line in lines
    )
