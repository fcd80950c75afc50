"""Libraries that write to the process's stderr by themselves."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator

_REDIRECT = threading.Lock()


@contextlib.contextmanager
def quiet_stderr() -> Iterator[None]:
    """Drop what C code writes straight to file 2.

    The lock keeps two threads from saving each other's redirection as the original.
    """
    with _REDIRECT:
        if sys.stderr is not None:
            sys.stderr.flush()
        try:
            saved = os.dup(2)
        except OSError:  # the process has no stderr: nothing to silence
            yield
            return
        try:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 2)
            os.close(null)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
