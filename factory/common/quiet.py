"""Libraries that write to the process's stdout or stderr by themselves."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from functools import partial

_REDIRECT = threading.Lock()


@contextlib.contextmanager
def quiet(descriptor: int) -> Iterator[None]:
    """Drop what C code writes straight to a file: 1 is stdout, 2 stderr.

    The lock keeps two threads from saving each other's redirection as the original.
    """
    with _REDIRECT:
        if sys.stderr is not None:
            sys.stderr.flush()
        try:
            saved = os.dup(descriptor)
        except OSError:  # the process has no such file: nothing to silence
            yield
            return
        try:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, descriptor)
            os.close(null)
            yield
        finally:
            os.dup2(saved, descriptor)
            os.close(saved)


quiet_stderr = partial(quiet, 2)
