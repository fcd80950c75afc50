"""The programs of a campaign as processes: what each cost, and all of them stopped at once."""

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
    """How a campaign runs programs; its methods are called from several threads."""

    def __call__(self, program: str, words: Sequence[str], threads: int) -> tuple[int, float]:
        """Run a program to its end: (exit code, negative for a signal; CPU seconds).

        KeyboardInterrupt once `stop` was called.
        """

    def stop(self, *, told: bool) -> None:
        """End what runs, and begin nothing more.  told: it was told already, by Ctrl-C."""


_MODULES = {name: f"simnfnd.{name}" for name in ("factory", "models", "evaluation")}


class Processes:
    """Each program is `python -m program words` in a process of its own; see Programs."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._running: set[int] = set()
        self._stopped = False

    def __call__(self, program: str, words: Sequence[str], threads: int) -> tuple[int, float]:
        """As Programs says; the CPU seconds are of the process and of those it waited for."""
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
        with self._changed:
            if self._stopped:
                raise KeyboardInterrupt
            child = subprocess.Popen(
                [sys.executable, "-m", _MODULES.get(program, program), *words], env=environment
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

    def stop(self, *, told: bool) -> None:
        """As Programs says; a process that does not listen is killed."""
        with self._changed:
            self._stopped = True
            if told and self._ended():
                # A second signal would cut short the tidying up that the first one began.
                return
            for number in (signal.SIGTERM, signal.SIGKILL):
                for pid in self._running:
                    os.kill(pid, number)
                if self._ended():
                    return

    def _ended(self) -> bool:
        return self._changed.wait_for(lambda: not self._running, _PATIENCE_S)
