"""Loops that numba compiles once a machine: declared with their types, kept on disk.

A module with compiled loops is imported inside the functions that need it: importing it loads numba
(half a second), and where no compiled form is on disk yet, compiles it.  Floating-point sums keep
the order that the source says (no fastmath), so the result is the same on every processor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(*signatures: str) -> Callable[[Function], Function]:
    """Decorator: compile for these argument types (numba's notation), or where called if none.

    The compiled code lies beside the module, or in the user's cache where that cannot be written;
    where neither can, it is compiled anew in every process.
    """

    def decorate(function: Function) -> Function:
        given: Any = list(signatures) or None
        options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
        made: Any
        try:
            made = numba.njit(given, cache=True, **options)(function)
        except RuntimeError as error:
            if "cannot cache" not in str(error):
                raise
            made = numba.njit(given, **options)(function)
        result: Function = made
        return result

    return decorate
