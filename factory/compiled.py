"""Loops that numba compiles once a machine: declared with their types, kept on disk.

A module with compiled loops is imported inside the functions that need it: importing it loads numba
(half a second), and where no compiled form is on disk yet, compiles it.  Floating-point sums keep
the order that the source says (no fastmath), so the result is the same on every processor.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

# Every module that declares some.
LOOPS = (
    "simnfnd.factory.formation.field.cell_loops",
    "simnfnd.factory.formation.field.kernels",
    "simnfnd.factory.formation.field.placing",
    "simnfnd.factory.formation.field.world_loops",
    "simnfnd.factory.render.albedo",
    "simnfnd.factory.render.joints",
    "simnfnd.factory.render.planes",
    "simnfnd.factory.render.shading",
    "simnfnd.factory.sonar.echo_loops",
    "simnfnd.factory.sonar.fan_loops",
    "simnfnd.factory.sonar.number_loops",
    "simnfnd.factory.sonar.picture_loops",
)


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


def compile_all() -> None:
    """Compile what is not on disk yet: once, before many workers would do it at once."""
    for name in LOOPS:
        importlib.import_module(name)
