"""Memory of a worker that makes pairs one after another."""

from __future__ import annotations

import ctypes
import sys

# Of malloc.h of the GNU C library.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 1 << 28


def keep_freed_memory() -> bool:
    """Let the C library keep what arrays free for the next pair, instead of giving it back.

    Every pair needs the same few arrays of some megabytes.  Asking the system for their pages again
    and again costs a third of the time of a pair (docs/speed.md).  What is kept is at most what one
    pair needed.  Returns whether there is a GNU C library to tell.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):  # another C library
        return False
    return all([mallopt(_MMAP_THRESHOLD, _KEPT_BYTES), mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)])
