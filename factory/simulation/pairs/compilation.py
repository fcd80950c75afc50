"""Which compiled loops a task needs, and loading them once a machine."""

from __future__ import annotations

import hashlib
import importlib
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock

from ...common.compiled import loading_only
from ...common.progress import stage_if_slow

_FACTORY = __package__.removesuffix(".simulation.pairs")
_SIMULATION = f"{_FACTORY}.simulation"
IMAGE_LOOPS = (
    f"{_FACTORY}.common.elementary",
    f"{_SIMULATION}.render.kernels",
    f"{_SIMULATION}.sonar.kernels",
)
SCENE_LOOPS = (f"{_SIMULATION}.meshes.kernels", f"{_SIMULATION}.scenes.seabed.kernels")
FIELD_LOOPS = (f"{_SIMULATION}.imaging.kernels", f"{_SIMULATION}.imaging.grain_kernels")
LOOPS = (*IMAGE_LOOPS, *SCENE_LOOPS, *FIELD_LOOPS)

_LOADING = "loading kernels; the first time on a machine compiles them, about 20 s"


def compile_needed(*, scenes: str = "", field: bool = False) -> None:
    """Load the loops that a task needs, compiling what is not on disk yet.

    scenes: the kind whose frames it makes.  field: whether it forms images by the complex field.
    One process of a machine at a time does it: many workers would compile the same loops at once.
    """
    names = [*IMAGE_LOOPS]
    if scenes in ("seabed", "mesh"):
        names.extend(SCENE_LOOPS)
    if field:
        names.extend(FIELD_LOOPS)
    if all(name in sys.modules for name in names):
        return
    with _alone(), stage_if_slow(_LOADING, after_s=2.0):
        for name in names:
            importlib.import_module(name)


def load_compiled() -> None:
    """Load what has a compiled form on disk, for processes that are forked from this one."""
    with loading_only():
        for name in LOOPS:
            with suppress(ImportError):
                importlib.import_module(name)


@contextmanager
def _alone() -> Iterator[None]:
    user = getattr(os, "getuid", int)()
    # Two installations compile into folders of their own and need not wait for each other.
    place = hashlib.sha256(str(Path(__file__).parent).encode()).hexdigest()[:8]
    lock = FileLock(Path(tempfile.gettempdir()) / f"simnfnd-kernels-{user}-{place}.lock")
    with suppress(OSError):  # a full or read-only folder does not prevent compiling
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
