"""Loops that numba compiles once a machine: declared with their types, kept on disk.

A module with compiled loops is imported inside the functions that need it: importing it loads numba
(half a second), and where no compiled form is on disk yet, compiles it.  Floating-point sums keep
the order that the source says (no fastmath), so the result is the same on every processor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


class NotCompiled(ImportError):
    """A loop that was not to be compiled now has no compiled form on disk."""


class _Mode:
    loading = False


@contextmanager
def only_loaded() -> Iterator[None]:
    """Modules imported in the block load their loops from disk, or raise NotCompiled."""
    _Mode.loading = True
    try:
        yield
    finally:
        _Mode.loading = False


def compiled(*signatures: str) -> Callable[[Function], Function]:
    """Decorator: compile for these argument types (numba's notation), or where called if none.

    The compiled code lies beside the module, or in the user's cache where that cannot be written;
    where neither can, it is compiled anew in every process.
    """

    def decorate(function: Function) -> Function:
        # Nothing calls a loop from C, and the wrapper takes as long to compile as a short loop.
        options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
        made: Any
        try:
            made = numba.njit(cache=True, **options)(function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            made = numba.njit(**options)(function)
        for signature in signatures:
            if _Mode.loading and made._cache.load_overload(signature, made.targetctx) is None:
                raise NotCompiled(function.__name__)
            made.compile(signature)
        if signatures:
            made.disable_compile()
        result: Function = made
        return result

    return decorate
