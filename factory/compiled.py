"""Loops that numba compiles once a machine: declared with their types, kept on disk.

A module with compiled loops is imported inside the functions that need it: importing it loads numba
(half a second), and where no compiled form is on disk yet, compiles it.  Floating-point sums keep
the order that the source says (no fastmath), so the result is the same on every processor.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from filelock import FileLock

from .progress import stage_if_slow

IMAGE_LOOPS = tuple(
    f"{__package__}.{name}" for name in ("elementary", "render.kernels", "sonar.kernels")
)
SEABED = f"{__package__}.scenes.seabed.kernels"
FIELD = f"{__package__}.imaging.kernels"
LOOPS = (*IMAGE_LOOPS, SEABED, FIELD)

_LOADING = "loading kernels; the first time on a machine compiles them, about 20 s"

Function = TypeVar("Function", bound=Callable[..., Any])
_mode = {"loading": False}


def compiled(*signatures: str) -> Callable[[Function], Function]:
    """Decorator: compile for these argument types (numba's notation), or where called if none.

    The compiled code lies beside the module, or in the user's cache where that cannot be written.
    """

    def decorate(function: Function) -> Function:
        # Nothing calls a loop from C, and the wrapper takes as long to compile as a short loop.
        options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
        import numba

        dispatcher: Any = numba.njit(cache=True, **options)(function)
        for signature in signatures:
            if (
                _mode["loading"]
                and dispatcher._cache.load_overload(signature, dispatcher.targetctx) is None
            ):
                raise ImportError(f"{function.__name__} is not compiled yet")
            dispatcher.compile(signature)
        if signatures:
            dispatcher.disable_compile()
        result: Function = dispatcher
        return result

    return decorate


def compile_needed(*, scenes: str = "", field: bool = False) -> None:
    """Load the loops that a task needs, compiling what is not on disk yet.

    scenes: the kind whose frames it makes.  field: whether it forms images by the complex field.
    One process of a machine at a time does it: many workers would compile the same loops at once.
    """
    names = [*IMAGE_LOOPS]
    if scenes in ("seabed", "mesh"):
        names.append(SEABED)
    if field:
        names.append(FIELD)
    if all(name in sys.modules for name in names):
        return
    with _alone(), stage_if_slow(_LOADING, after_s=2.0):
        for name in names:
            importlib.import_module(name)


def load_compiled() -> None:
    """Load what has a compiled form on disk, for processes that are forked from this one."""
    _mode["loading"] = True
    for name in LOOPS:
        with suppress(ImportError):
            importlib.import_module(name)
    _mode["loading"] = False


@contextmanager
def _alone() -> Iterator[None]:
    user = getattr(os, "getuid", int)()
    lock = FileLock(Path(tempfile.gettempdir()) / f"simnfnd-kernels-{user}.lock")
    with suppress(OSError):  # a full or read-only folder does not prevent compiling
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
