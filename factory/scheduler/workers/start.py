"""What every worker process does first, whichever backend started it."""

from __future__ import annotations

import signal
from contextlib import suppress

from .memory import keep_freed_memory


def start_worker_process() -> None:
    """Leave Ctrl-C, which goes to every process of a terminal, to the parent; set up malloc."""
    with suppress(ValueError):  # not in the main thread: no signal would be delivered here
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()
