"""The commands of a campaign as processes: what each cost, and all of them stopped at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import Protocol

_PATIENCE_S = 20.0


class Programs(Protocol):
    """How a campaign runs its commands; the methods are called from several threads."""

    def __call__(self, verb: str, words: Sequence[str], threads: int) -> tuple[int, float]:
        """Run `simnfnd VERB WORDS` to its end: (exit code, negative for a signal; CPU seconds).

        KeyboardInterrupt once `stop` was called.
        """

    def stop(self, *, signalled: bool) -> None:
        """End what runs, and begin nothing more.  signalled: Ctrl-C has reached it already."""


class Processes:
    """Each command is `python -m simnfnd VERB WORDS` in a process of its own; see Programs.

    module: what is run instead of simnfnd.
    """

    def __init__(self, module: str = "simnfnd") -> None:
        self._module = module
        self._changed = threading.Condition()
        self._running: set[int] = set()
        self._stopped = False

    def __call__(self, verb: str, words: Sequence[str], threads: int) -> tuple[int, float]:
        """As Programs says; the CPU seconds are of the process and of those it waited for."""
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
        with self._changed:
            if self._stopped:
                raise KeyboardInterrupt
            child = subprocess.Popen(
                [sys.executable, "-m", self._module, verb, *words], env=environment
            )
            self._running.add(child.pid)
        # Left unreaped until the lock is held: `stop` never signals a number that is another's.
        os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
        with self._changed:
            _, status, used = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
            self._running.remove(child.pid)
            self._changed.notify_all()
        return child.returncode, used.ru_utime + used.ru_stime

    def stop(self, *, signalled: bool) -> None:
        """As Programs says; a process that does not listen is killed."""
        with self._changed:
            self._stopped = True
            if signalled and self._ended():
                # A second signal would cut short the tidying up that the first one began.
                return
            for number in (signal.SIGTERM, signal.SIGKILL):
                for pid in self._running:
                    os.kill(pid, number)
                if self._ended():
                    return

    def _ended(self) -> bool:
        return self._changed.wait_for(lambda: not self._running, _PATIENCE_S)
