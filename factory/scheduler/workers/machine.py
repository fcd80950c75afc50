"""What this machine has for workers: cores, memory, and the limits of a shell (`ulimit`)."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

from ...errors import FactoryError

# Measured of 48: what a worker costs the process that starts it, pipes and threads, and what
# else a run opens or loads.
_FILES_A_WORKER, _OTHER_FILES = 8, 40
_BYTES_A_WORKER, _OTHER_BYTES = 128 << 20, 512 << 20
# Of malloc.h of the GNU C library.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_KEPT_BYTES = 1 << 28


def usable_cores() -> int:
    """Cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def available_memory_bytes() -> int:
    """Memory that can be had without swapping, under a container's limit when there is one."""
    import psutil  # 20 ms, which a command for one picture can do without

    available = int(psutil.virtual_memory().available)
    control_group = Path("/sys/fs/cgroup")
    try:
        limit = int((control_group / "memory.max").read_text())
        used = int((control_group / "memory.current").read_text())
    except (OSError, ValueError):
        return available
    return min(available, max(0, limit - used))


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


def workers_that_fit(wanted: int) -> tuple[int, str]:
    """(how many of them fit, the limit in words; empty when all fit).

    Raises FactoryError when not even one fits.  A limit on open files is raised first, as far as
    the system lets us.
    """
    import psutil

    try:
        import resource
    except ImportError:  # no such limits on this system
        return wanted, ""
    process = psutil.Process()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
            soft = hard
        except (OSError, ValueError):  # macOS has a lower one of its own
            pass
    room = [(wanted, "")]
    if soft != resource.RLIM_INFINITY:
        left = soft - process.num_fds() - _OTHER_FILES
        room.append((left // _FILES_A_WORKER, f"ulimit -n is {soft}"))
    space, _ = resource.getrlimit(resource.RLIMIT_AS)
    if space != resource.RLIM_INFINITY:
        left = space - process.memory_info().vms - _OTHER_BYTES
        room.append((left // _BYTES_A_WORKER, f"ulimit -v is {space // 1024}"))
    fitting, limit = min(room, key=lambda item: item[0])
    if fitting < min(wanted, 1):
        raise FactoryError(f"scheduler.workers: {limit}, in which no worker fits; raise it")
    return fitting, limit
