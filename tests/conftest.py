"""What every test shares: how hypothesis searches, and a cache of renders that goes away again."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Test processes share two cores: threads of libraries would only wait for each other.  Before
# anything imports numpy or torch; processes that tests start take it over.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# Tests start Python more than a hundred times; where the environment forbids bytecode, each of
# these processes compiles all modules again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# A shell that starts the tests in the background makes them ignore Ctrl-C, which some of them send.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Shared machines are slow now and then, so no deadline.  In CI the same examples every time: a
# change must not fail on an example that it did not cause; at home the search goes on.
settings.register_profile("simnfnd", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("simnfnd")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Before several processes begin: each of them would compile the same loops."""
    if getattr(session.config.option, "numprocesses", None):
        compile_loops()


def compile_loops() -> None:
    """Compile what has no compiled form on disk, in two processes: a minute of CPU in a clone."""
    from simnfnd.factory.simulation.pairs.compilation import (
        FIELD_LOOPS,
        IMAGE_LOOPS,
        LOOPS,
        SCENE_LOOPS,
    )

    root = Path(__file__).resolve().parents[1]
    denoising_loops = "simnfnd.models.denoise.temporal.kernels"
    every = (*LOOPS, denoising_loops)
    paths = [root / f"{name.removeprefix('simnfnd.').replace('.', '/')}.py" for name in every]
    if all(
        any(
            compiled.stat().st_mtime > path.stat().st_mtime
            for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.nbi")
        )
        for path in paths
    ):
        return
    processes = [
        subprocess.Popen([sys.executable, "-c", "\n".join(f"import {name}" for name in names)])
        for names in ((*IMAGE_LOOPS, *SCENE_LOOPS), (*FIELD_LOOPS, denoising_loops))
    ]
    for process in processes:
        process.wait()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Several processes share the files: those with a slow test and of slower rooms come first.

    A file is tested by one process: begun last, one of a minute keeps the other processes waiting.
    """
    if hasattr(config, "workerinput"):
        slow = {item.path for item in items if item.get_closest_marker("slow")}
        rooms = ("project", "models", "evaluation", "factory")
        items.sort(key=lambda item: (item.path not in slow, rooms.index(item.nodeid.split("/")[1])))


def pytest_collection_finish() -> None:
    """Leave what all modules hold out of every search for garbage: a twentieth of all time."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def cache_of_its_own() -> Iterator[None]:
    """Renders of tests stay out of the user's cache, and those of an older code out of tests."""
    with tempfile.TemporaryDirectory(prefix="simnfnd-cache-") as folder:
        os.environ["SIMNFND_CACHE"] = folder
        yield
        del os.environ["SIMNFND_CACHE"]


@pytest.fixture(scope="session", autouse=True)
def compositions_are_remembered() -> Iterator[None]:
    from tests import remembered_configurations

    with pytest.MonkeyPatch.context() as patch:
        remembered_configurations.remember(patch)
        yield
