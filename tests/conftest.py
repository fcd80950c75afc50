"""What every test shares: how hypothesis searches, and a cache of renders that goes away again."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections.abc import Iterator

import pytest
from hypothesis import settings

# Two test processes share two cores: threads of libraries would only wait for each other.  Before
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


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Several processes share the files: those with a slow test and of slower rooms come first.

    A file is tested by one process: begun last, one of a minute keeps the other processes waiting.
    """
    if hasattr(config, "workerinput"):
        slow = {item.path for item in items if item.get_closest_marker("slow")}
        rooms = ("project", "models", "evaluation", "factory")
        items.sort(key=lambda item: (item.path not in slow, rooms.index(item.nodeid.split("/")[1])))


@pytest.fixture(scope="session", autouse=True)
def cache_of_its_own() -> Iterator[None]:
    """Renders of tests stay out of the user's cache, and those of an older code out of tests."""
    with tempfile.TemporaryDirectory(prefix="simnfnd-cache-") as folder:
        os.environ["SIMNFND_CACHE"] = folder
        yield
        del os.environ["SIMNFND_CACHE"]
