"""Modules with compiled loops, so that a machine compiles those that a run needs once."""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from .progress import stage_if_slow

PICTURES = ("elementary", "render.kernels", "sonar.kernels")
SEABED = ("scenes.seabed.kernels",)
FIELD = ("imaging.kernels",)
LOOPS = PICTURES + SEABED + FIELD


def compile_needed(*, scenes: str = "", field: bool = False) -> None:
    """Load the loops that a task needs, compiling what is not on disk yet.

    scenes: the kind whose frames it makes.  field: whether it forms pictures by the complex field.
    One process of a machine at a time does it: many workers would compile the same loops at once.
    """
    names: tuple[str, ...] = PICTURES
    if scenes in ("seabed", "mesh"):
        names += SEABED
    if field:
        names += FIELD
    if all(_module(name) in sys.modules for name in names):
        return
    with (
        _alone(),
        stage_if_slow("compiling kernels, once per machine, about 20 s", after_s=2.0),
    ):
        for name in names:
            importlib.import_module(_module(name))


def load_compiled() -> None:
    """Load what has a compiled form on disk, for processes that are forked from this one."""
    from .compiled import NotCompiled, only_loaded

    with only_loaded():
        for name in LOOPS:
            with suppress(NotCompiled):
                importlib.import_module(_module(name))


def _module(name: str) -> str:
    return f"{__package__}.{name}"


@contextmanager
def _alone() -> Iterator[None]:
    try:
        import fcntl
    except ImportError:  # Windows: whoever comes, compiles
        yield
        return
    path = Path(tempfile.gettempdir()) / f"simnfnd-kernels-{os.getuid()}.lock"
    with ExitStack() as open_files:
        with suppress(OSError):  # a full or closed folder keeps nobody from compiling
            fcntl.flock(open_files.enter_context(path.open("a")), fcntl.LOCK_EX)
        yield
