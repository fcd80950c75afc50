"""How many worker processes the limits of a shell (`ulimit`) let one process have."""

from __future__ import annotations

import psutil

from ...errors import FactoryError

# Measured of 48: what a worker costs the process that starts it, pipes and threads, and what
# else a run opens or loads.
_FILES_A_WORKER, _OTHER_FILES = 8, 40
_BYTES_A_WORKER, _OTHER_BYTES = 128 << 20, 512 << 20


def workers_that_fit(wanted: int) -> tuple[int, str]:
    """(how many of them fit, the limit in words; empty when all fit).

    Raises FactoryError when not even one fits.  A limit on open files is raised first, as far as
    the system lets us.
    """
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
