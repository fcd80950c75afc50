"""Shards that lie far away, each of which is fetched once: in order, or samples in random order.

Samples of all shards at random would fetch a whole shard for each.  So shards come in random order,
some at a time (a window), and the samples of a window in random order; the next window's shards
are fetched meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

from simnfnd.factory.dataset.read.reader import bring
from simnfnd.factory.errors import FactoryError

WINDOW = 16
_THREADS = 4


class Windows:
    """The order of one round over samples after another, and what to fetch while it goes on.

    places: the shard of each sample.  window: shards whose samples are mixed.
    """

    def __init__(self, places: Sequence[Path], window: int = WINDOW) -> None:
        if window < 1:
            raise FactoryError(f"window={window}: must be at least 1 shard")
        self._paths = list(dict.fromkeys(places))
        numbers = {path: number for number, path in enumerate(self._paths)}
        self._shard = np.array([numbers[path] for path in places], np.int64)
        self._window = window
        self._starts: dict[int, list[Path]] = {}
        self._threads: ThreadPoolExecutor | None = None

    def order(self, rng: np.random.Generator) -> npt.NDArray[np.int64]:
        """(N,) every sample once; the same generator gives the same order."""
        shards = rng.permutation(len(self._paths))
        rank = np.empty(len(shards), np.int64)
        rank[shards] = np.arange(len(shards))
        windows = rank[self._shard] // self._window
        # Random within each window: a key of its own for every sample.
        order: npt.NDArray[np.int64] = np.lexsort((rng.random(len(windows)), windows))
        first = np.searchsorted(windows[order], np.arange(windows.max(initial=-1) + 2))
        groups = [
            [self._paths[number] for number in shards[k : k + self._window]]
            for k in range(0, len(shards), self._window)
        ]
        # Those of the first window at once, of any other when the one before it begins.
        self._starts = {0: [path for group in groups[:2] for path in group]}
        for k, group in enumerate(groups[2:], 1):
            self._starts[int(first[k])] = group
        return order

    def reach(self, position: int) -> None:
        """Say that the sample at this position of the order is about to be read."""
        for path in self._starts.pop(position, ()):
            if self._threads is None:
                self._threads = ThreadPoolExecutor(_THREADS, "fetch")
            self._threads.submit(_bring, path)

    def close(self) -> None:
        """Fetch no more."""
        if self._threads is not None:
            self._threads.shutdown(wait=False, cancel_futures=True)
            self._threads = None


def fetched_ahead(paths: Sequence[Path]) -> Iterator[Path]:
    """The paths in order, while those that follow are fetched."""
    with ThreadPoolExecutor(_THREADS, "fetch") as threads:
        try:
            for number, path in enumerate(paths):
                if number % WINDOW == 0:
                    last = number + 2 * WINDOW
                    for later in paths[number + WINDOW if number else 1 : last]:
                        threads.submit(_bring, later)
                yield path
        finally:
            threads.shutdown(wait=False, cancel_futures=True)


def _bring(path: Path) -> None:
    with suppress(FactoryError):  # whoever reads it says so
        bring(path)
