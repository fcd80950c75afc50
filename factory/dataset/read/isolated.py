"""A process of its own for what may crash, hang or take all memory.

Started as a command, not by multiprocessing: that would import the caller's main module again,
and a five-line script that reads a dataset has no `if __name__ == "__main__"`.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from ...errors import FactoryError

T = TypeVar("T")

# Beyond what the process has after its imports; a picture has 64 MB at most.
_MEMORY_BYTES = 800 << 20


class IsolatedProcess:
    """Runs importable functions in another process, which is started again when one kills it."""

    def __init__(self) -> None:
        self._child: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> IsolatedProcess:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._child:
            self._child.kill()
        self._end()

    def call(self, function: Callable[..., T], *arguments: Any, limit_s: float) -> T:
        """`function(*arguments)` with its result or its error; both must pickle.

        Raises FactoryError (without a name) when the process dies of it, or it takes longer than
        `limit_s` or more memory than any sound file needs.
        """
        child = self._child = self._child or _start()
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            pickle.dump((limit_s, function, arguments), child.stdin)
            child.stdin.flush()
            good, result = pickle.load(child.stdout)
        except (EOFError, BrokenPipeError, pickle.UnpicklingError) as error:
            code = self._end()
            if code == -signal.SIGALRM:
                raise FactoryError(f"not read within {limit_s:g} s; made to hang?") from error
            raise FactoryError("crashes the HDF5 library; it is damaged") from error
        except BaseException:
            child.kill()
            self._end()
            raise
        if good:
            answer: T = result
            return answer
        if isinstance(result, MemoryError):
            raise FactoryError("asks for more memory than a sound file needs") from result
        if isinstance(result, Exception):
            raise result
        raise RuntimeError(result)

    def _end(self) -> int | None:
        """Stop the process; returns the exit code of one that ended by itself."""
        child, self._child = self._child, None
        if child is None:
            return None
        try:
            # It closes its pipes a moment before its exit code can be had.
            return child.wait(timeout=1)
        except subprocess.TimeoutExpired:
            child.kill()
            return child.wait()
        finally:
            for pipe in (child.stdin, child.stdout):
                with suppress(OSError):  # what could not be flushed to a dead process
                    if pipe:
                        pipe.close()


def _start() -> subprocess.Popen[bytes]:
    environment = dict(os.environ)
    # Modules are to be found as this process finds them, wherever it was started.
    environment["PYTHONPATH"] = os.pathsep.join(path or os.getcwd() for path in sys.path)
    # Threads of numerical libraries reserve address space, and nothing is computed there.
    environment["OMP_NUM_THREADS"] = environment["OPENBLAS_NUM_THREADS"] = "1"
    return subprocess.Popen(
        [sys.executable, "-c", "from simnfnd.factory.dataset.read.isolated import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
    )


def _answer(requests: BinaryIO, answers: BinaryIO) -> None:
    _limit_memory()
    while True:
        try:
            limit_s, function, arguments = pickle.load(requests)
        except EOFError:
            return
        # Not caught: it ends the process even where C code never comes back.
        signal.setitimer(signal.ITIMER_REAL, limit_s)
        try:
            content = pickle.dumps((True, function(*arguments)))
        except (FactoryError, MemoryError) as error:
            content = pickle.dumps((False, error))
        except Exception:
            content = pickle.dumps((False, traceback.format_exc()))
        signal.setitimer(signal.ITIMER_REAL, 0)
        answers.write(content)
        answers.flush()


def _limit_memory() -> None:
    import resource

    # Its imports count as what the process has.
    from . import reader  # noqa: F401

    most = _address_space_bytes() + _MEMORY_BYTES
    _, allowed = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY:
        most = min(most, allowed)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    # A core file of an expected crash is of no use.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _address_space_bytes() -> int:
    """What this process has reserved; 0 where the system does not say (and knows no limit)."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def serve() -> None:
    """Answer the calls that come on standard input until it ends."""
    # Ctrl-C is for the parent, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    # What libraries print must not get between the answers.
    os.dup2(2, 1)
    _answer(sys.stdin.buffer, answers)
