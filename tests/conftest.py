"""What every test shares: how hypothesis searches, and a cache of renders that goes away again."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator

import pytest
from hypothesis import settings

# Two test processes share two cores: threads of libraries would only wait for each other.  Before
# anything imports numpy or torch; processes that tests start take it over.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# Shared machines are slow now and then, so no deadline.  In CI the same examples every time: a
# change must not fail on an example that it did not cause; at home the search goes on.
settings.register_profile("simnfnd", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("simnfnd")

# The log handler of absl, which TensorBoard brings, keeps the sys.stderr of the moment of its
# import and CLOSES it when Hydra sets logging up anew, unless it is the process's own.  Within
# pytest that is the file that collects what tests print: every test after it would break.
with contextlib.suppress(ImportError):
    from absl import logging as absl_logging

    absl_logging.get_absl_handler().python_handler.stream = sys.__stderr__


# From the files that take longest to those that are over soon.
ROOMS = ("project", "models", "evaluation", "factory")


def long_files_first(items: list[pytest.Item]) -> None:
    """Files that hold a slow test, then those of the slower rooms, each in the order it has.

    A file is tested by one process: begun last, one of a minute keeps the other processes waiting.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    place = {room: number for number, room in enumerate(ROOMS)}
    items.sort(key=lambda item: (item.path not in slow, place[item.nodeid.split("/")[1]]))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Several processes share the tests: begin with what takes long."""
    if hasattr(config, "workerinput"):
        long_files_first(items)


@pytest.fixture(scope="session", autouse=True)
def cache_of_its_own() -> Iterator[None]:
    """Renders of tests stay out of the user's cache, and those of an older code out of tests."""
    with tempfile.TemporaryDirectory(prefix="simnfnd-cache-") as folder:
        os.environ["SIMNFND_CACHE"] = folder
        yield
        del os.environ["SIMNFND_CACHE"]
