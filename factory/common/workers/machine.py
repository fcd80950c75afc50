"""What this machine has for workers: cores, memory, and the limits of a shell (`ulimit`)."""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from pathlib import Path

from ..errors import FactoryError
from ..progress import stage

# Measured with 48 workers: files that each costs the process that starts it, and that a run opens
# beside them.
_FILES_A_WORKER = 8
_OTHER_FILES = 40
# Options of `mallopt` in malloc.h of the GNU C library.
_TRIM_THRESHOLD = -1
_MMAP_THRESHOLD = -3
_KEPT_BYTES = 1 << 28


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def available_memory_bytes() -> int:
    """Memory that can be had without swapping, under a container's limit when there is one."""
    import psutil  # 20 ms, which a command for one image can do without

    available = int(psutil.virtual_memory().available)
    group = Path("/sys/fs/cgroup")
    with suppress(OSError, ValueError):  # no control group, or no limit
        limit, used = (int((group / f"memory.{name}").read_text()) for name in ("max", "current"))
        return min(available, max(0, limit - used))
    return available


def keep_freed_memory() -> None:
    """Let the C library keep what arrays free for the next pair, instead of giving it back.

    Every pair needs the same few arrays of some megabytes.  Asking the system for their pages again
    and again costs a third of the time of a pair (docs/speed.md).  What is kept is at most what one
    pair needed.  Other C libraries have no such option.
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            mallopt = ctypes.CDLL(None).mallopt
            mallopt(_MMAP_THRESHOLD, _KEPT_BYTES)
            mallopt(_TRIM_THRESHOLD, _KEPT_BYTES)


def workers_that_fit(wanted: int) -> int:
    """As many workers as `ulimit -n` allows; reports when these are fewer.

    Raises FactoryError when not even one fits.
    """
    import resource

    import psutil

    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        return wanted
    fitting = (files - psutil.Process().num_fds() - _OTHER_FILES) // _FILES_A_WORKER
    if fitting >= wanted:
        return wanted
    limit = f"ulimit -n is {files}"
    if fitting < 1:
        raise FactoryError(f"scheduler.workers: {limit}, in which no worker fits; raise it")
    stage(f"{limit}: {fitting} of {wanted} workers fit and are used; raise it for more")
    return fitting
