"""Samples in random order where shards lie far away, each of which is fetched once a round.

Samples of all shards at random would fetch a whole shard for each.  So shards come in random order,
some at a time (a window), and the samples of a window in random order.  Where copies have room for
two windows, the next one's shards are fetched meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ...storage.copies import most_bytes, url_of
from .reader import bring

WINDOW = 16
THREADS = 4


class Windows:
    """The order of one round over samples after another, and what to fetch while it goes on.

    places: the shard of each sample.  window: shards whose samples are mixed.  sizes: bytes of the
    shards; None: there is room.
    """

    def __init__(
        self,
        places: Sequence[Path],
        window: int = WINDOW,
        *,
        sizes: Mapping[Path, int] | None = None,
    ) -> None:
        if window < 1:
            raise FactoryError(f"window={window}: must be at least 1 shard")
        self._paths = list(dict.fromkeys(places))
        numbers = {path: number for number, path in enumerate(self._paths)}
        self._shard = np.array([numbers[path] for path in places], np.int64)
        self._window = window
        two = 2 * window * max((sizes or {}).values(), default=0)
        distant = bool(self._paths) and url_of(self._paths[0].parent.parent) is not None
        self._fetches = distant and two <= most_bytes()
        self._groups: list[list[Path]] = []
        self._first: npt.NDArray[np.int64] = np.empty(0, np.int64)
        self._now = range(0)
        self._threads: ThreadPoolExecutor | None = None

    def order(self, rng: np.random.Generator) -> npt.NDArray[np.int64]:
        """(N,) every sample once; the same generator gives the same order."""
        shards = rng.permutation(len(self._paths))
        rank = np.empty(len(shards), np.int64)
        rank[shards] = np.arange(len(shards))
        windows = rank[self._shard] // self._window
        # Random within each window: a key of its own for every sample.
        order: npt.NDArray[np.int64] = np.lexsort((rng.random(len(windows)), windows))
        self._groups = [
            [self._paths[number] for number in shards[k : k + self._window]]
            for k in range(0, len(shards), self._window)
        ]
        self._first = np.searchsorted(windows[order], np.arange(len(self._groups) + 1))
        self._now = range(0)
        return order

    def reach(self, position: int) -> None:
        """Say that the sample at this position of the order is about to be read."""
        if not self._fetches or position in self._now or not self._groups:
            return
        here = int(np.searchsorted(self._first, position, side="right")) - 1
        self._now = range(int(self._first[here]), int(self._first[here + 1]))
        if self._threads is None:
            self._threads = ThreadPoolExecutor(THREADS, "fetch")
        for path in (one for group in self._groups[here : here + 2] for one in group):
            self._threads.submit(_bring, path)

    def close(self) -> None:
        """Fetch no more."""
        if self._threads is not None:
            self._threads.shutdown(wait=False, cancel_futures=True)
            self._threads = None


def _bring(path: Path) -> None:
    with suppress(FactoryError):  # whoever reads it says so
        bring(path)
