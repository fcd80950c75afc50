"""Loops that numba compiles once a machine: declared with their types, kept on disk.

A module with compiled loops is imported inside the functions that need it: importing it loads numba
(half a second), and where no compiled form is on disk yet, compiles it.  Floating-point sums keep
the order that the source says (no fastmath), so the result is the same on every processor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from .private_apis import has_compiled_form

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
            if _mode["loading"] and not has_compiled_form(dispatcher, signature):
                raise ImportError(f"{function.__name__} is not compiled yet")
            dispatcher.compile(signature)
        if signatures:
            dispatcher.disable_compile()
        result: Function = dispatcher
        return result

    return decorate


@contextmanager
def loading_only() -> Iterator[None]:
    """While it lasts a loop without a compiled form on disk raises ImportError."""
    _mode["loading"] = True
    try:
        yield
    finally:
        _mode["loading"] = False
