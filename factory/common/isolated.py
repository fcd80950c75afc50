"""A separate process for untrusted files, whose library may crash, hang or take all memory.

It is started as a command and not by multiprocessing, which would import the caller's main module
again: a five-line script that reads a dataset has no `if __name__ == "__main__"`.  Calls and
answers are lines of JSON, never a pickle: a library that a file has taken over can send back wrong
values and nothing that runs.
"""

from __future__ import annotations

import atexit
import base64
import json
import os
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import IO, Any

from .errors import FactoryError
from .small_files import MOST_BYTES

LIMIT_S = 60.0
_LATE = int(getattr(signal, "SIGALRM", signal.SIGTERM))
"""The signal that ends a process that is late; on Windows its exit code."""

# Memory beyond what the process has after its imports; an image has 64 MB at most.
_MEMORY_BYTES = 800 << 20


def call_isolated(
    path: Path, function: Callable[..., Any], *arguments: Any, limit_s: float = LIMIT_S
) -> Any:
    """Run a function that reads a possibly untrusted file in a process that is kept.

    path: the file that errors name.  function: a function of a module, importable.
    Arguments and answer are what JSON can hold; a path arrives as text.
    Raises FactoryError when the function does, when the process dies of the file, or when it takes
    longer than `limit_s` or more memory than a sound file needs.
    """
    try:
        return LASTING.call(function, *arguments, limit_s=limit_s)
    except FactoryError as error:
        raise FactoryError(f"{path}: {str(error).removeprefix(f'{path}: ')}") from error


class IsolatedProcess:
    """Runs importable functions in another process, which is started again when one kills it.

    A thread waits for another's call; after a fork there is a new process.
    memory_bytes: beyond what the process has after its imports; other libraries need more.
    """

    def __init__(self, memory_bytes: int = _MEMORY_BYTES) -> None:
        self._memory_bytes = memory_bytes
        self._forget()
        atexit.register(self.close)
        if hasattr(os, "register_at_fork"):  # Windows has no forks
            os.register_at_fork(after_in_child=self._forget)

    def _forget(self) -> None:
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None

    def call(self, function: Callable[..., Any], *arguments: Any, limit_s: float = LIMIT_S) -> Any:
        """`function(*arguments)`; see `call_isolated`.  Its FactoryError names no file.

        Raises RuntimeError with the traceback for any other error of the function.
        """
        name = f"{function.__module__}:{function.__qualname__}"
        request = _encode((name, limit_s, os.getcwd(), arguments))
        with self._lock:
            kind, result = self._answer(request, limit_s)
        if kind == "answer":
            return result
        raise FactoryError(str(result)) if kind == "refused" else RuntimeError(result)

    def _answer(self, request: bytes, limit_s: float) -> tuple[str, Any]:
        """Send a request and wait for the answer: its kind and its value.

        Raises FactoryError where the process crashes or takes longer than the limit, and ends it.
        """
        child = self._child = self._child or _start(self._memory_bytes)
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            child.stdin.write(request)
            child.stdin.flush()
            kind, result = _decode(child.stdout)
            return kind, result
        except (EOFError, BrokenPipeError, ValueError, TypeError) as error:
            # It closes its pipes a moment before its exit code can be had.
            if self.close(1) in (-_LATE, _LATE):
                raise FactoryError(f"not read within {limit_s:g} s; made to hang?") from error
            raise FactoryError("crashes the library that reads it; it is damaged") from error
        except BaseException:
            self.close()
            raise

    def close(self, patience_s: float = 0) -> int | None:
        """Kill the process unless it ends within the time; returns its exit code.

        The next call starts another one.
        """
        child = self._child
        self._child = None
        if child is None:
            return None
        with suppress(subprocess.TimeoutExpired):
            child.wait(patience_s)
        child.kill()
        with suppress(OSError), child:  # what could not be flushed to a dead process
            pass
        return child.wait()


LASTING = IsolatedProcess()
"""The process of `call_isolated`."""


def _encode(value: Any) -> bytes:
    """A line of JSON; bytes and paths are tagged.  Raises TypeError for what it cannot hold."""

    def tagged(item: Any) -> Any:
        if isinstance(item, bytes):
            return {"__bytes__": base64.b64encode(item).decode()}
        return {"__path__": os.fspath(item)}

    return json.dumps(value, default=tagged).encode() + b"\n"


def _decode(file: IO[bytes]) -> Any:
    """The next line of a pipe.  Raises EOFError at its end, ValueError for what is no JSON."""

    def untagged(item: dict[str, Any]) -> Any:
        if "__path__" in item:
            return Path(item["__path__"])
        return base64.b64decode(item["__bytes__"]) if "__bytes__" in item else item

    line = file.readline(MOST_BYTES)
    if not line.endswith(b"\n"):
        raise EOFError
    return json.loads(line, object_hook=untagged)


def _start(memory_bytes: int) -> subprocess.Popen[bytes]:
    # Modules are to be found as this process finds them, wherever it was started.
    # Blender puts folders of its own on the path, where half of bpy hides the whole.
    bpy = getattr(sys.modules.get("bpy"), "__file__", None)
    blender = (f"{Path(bpy).parents[2]}{os.sep}",) if bpy else ()
    paths = [path or os.getcwd() for path in sys.path if not path.startswith(blender)]
    # Threads of numerical libraries reserve address space, and nothing is computed there.
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", f"from {__name__} import serve; serve({memory_bytes})"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), **one_thread},
    )


def serve(memory_bytes: int) -> None:
    """Answer the calls that come on standard input until it ends."""
    import h5py  # noqa: F401  (counts as what the process has)

    # Ctrl-C is for the parent, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    # What libraries print must not get between the answers.
    os.dup2(2, 1)
    _limit_memory(memory_bytes)
    while True:
        try:
            name, limit_s, folder, arguments = _decode(sys.stdin.buffer)
        except EOFError:
            return
        os.chdir(folder)  # relative paths mean what they mean to who asks
        end = _deadline(limit_s)
        try:
            content = _encode(("answer", resolve_name(name)(*arguments)))
        except FactoryError as error:
            content = _encode(("refused", str(error)))
        except MemoryError:
            content = _encode(("refused", "asks for more memory than a sound file needs"))
        except Exception:
            content = _encode(("error", traceback.format_exc()))
        end()
        answers.write(content)
        answers.flush()


def _limit_memory(memory_bytes: int) -> None:
    """Let this process take so much beyond what it has.  Windows knows no such limit."""
    try:
        import resource
    except ImportError:
        return
    # What this process has reserved; systems without /proc do not say it.
    reserved = Path("/proc/self/statm")
    pages = int(reserved.read_text().split()[0]) if reserved.exists() else 0
    most = pages * resource.getpagesize() + memory_bytes
    _, allowed = resource.getrlimit(resource.RLIMIT_AS)
    most = most if allowed == resource.RLIM_INFINITY else min(most, allowed)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    # A core file of an expected crash is of no use.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _deadline(limit_s: float) -> Callable[[], object]:
    """End this process after so long; the result calls that off."""
    if hasattr(signal, "setitimer"):
        # Not caught: it ends the process even where C code never comes back.
        signal.setitimer(signal.ITIMER_REAL, limit_s)
        return partial(signal.setitimer, signal.ITIMER_REAL, 0)
    timer = threading.Timer(limit_s, os._exit, (_LATE,))
    timer.daemon = True
    timer.start()
    return timer.cancel
