"""Read by Dask workers when they start (`--preload simnfnd.factory.workers.dask_preload`)."""

from __future__ import annotations

import signal
from contextlib import suppress
from typing import Any


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C, which goes to every process of a terminal, to the process that was started."""
    with suppress(ValueError):  # not in the main thread: nothing would be delivered here
        signal.signal(signal.SIGINT, signal.SIG_IGN)
