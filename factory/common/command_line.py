"""The command line that all verbs share: options, one clear line and an exit code for a mistake.

Imports the standard library alone: help must answer at once.
"""

from __future__ import annotations

import argparse
import errno
import io
import os
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from .errors import OS_REMEDIES, FactoryError

EXIT_BAD_INPUT = 2
_OF_THE_MACHINE = {
    *(errno.EACCES, errno.EPERM, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ENOSPC, errno.EROFS),
    *(errno.ELOOP, errno.ENOTDIR, errno.EISDIR, errno.ENAMETOOLONG, errno.ESTALE, errno.ENOMEM),
}

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


def guard(action: Callable[[], Any], *, debug: bool = False) -> int:
    """Run `action`; turn an error that a user can correct into one line and an exit code."""
    for output in (sys.stdout, sys.stderr):
        if isinstance(output, io.TextIOWrapper):
            # Names of files may hold any bytes; they are printed as they are.
            output.reconfigure(errors="surrogateescape")
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
        hint = OS_REMEDIES.get(error.errno, "see that it can be used")
        return say_error(FactoryError(f"{os.fspath(place)}: {error.strerror}; {hint}"))
    except MemoryError:
        if debug:
            raise
        hint = OS_REMEDIES[errno.ENOMEM]
        return say_error(FactoryError(f"memory: not enough of it; {hint}"))
    except KeyboardInterrupt as stopped:
        # Who knows what is kept says so in the exception.
        kept_note = getattr(stopped, "kept", "")
        said = f"interrupted; {kept_note}" if kept_note else "interrupted"
        print(f"error: {getattr(stopped, 'said', said)}", file=sys.stderr)
        # SIGTERM comes as a KeyboardInterrupt that knows its own exit code.
        return int(getattr(stopped, "exit_code", 128 + signal.SIGINT))


def say_error(error: Exception) -> int:
    """Print the one line of a user-facing error and return its exit code."""
    print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
    return EXIT_BAD_INPUT
