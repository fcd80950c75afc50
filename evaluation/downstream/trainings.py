"""All trainings of a run: what each learns from and is tested on; done ones are not done again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..measurement.lines import LineFile
from .counts import Counts, counts_of
from .splits import folds_of, labelled_of

Pictures = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int64]

DONE_NAME = "trainings.jsonl"


@dataclass(frozen=True)
class Training:
    """One network.

    method: label of the row that made the pictures.  percent: of the labels; None: it learns from
    the factory's pictures alone.  learned, tested: numbers of pictures.
    """

    method: str
    percent: float | None
    seed: int
    fold: int
    learned: tuple[int, ...]
    tested: tuple[int, ...]


def planned(
    methods: Sequence[str],
    labels: Sequence[float],
    seeds: Sequence[int],
    component: Indices,
    folds: int,
    simulated: int,
) -> list[Training]:
    """Every training; those that compare the methods on the same pictures stand side by side.

    simulated: how many pictures of the factory there are.
    """
    everything = tuple(range(len(component)))
    found = []
    for seed in seeds:
        fold_of = folds_of(component, folds, seed)
        for percent in labels:
            for fold in range(folds):
                tested = tuple(np.flatnonzero(fold_of == fold).tolist())
                rest = np.flatnonzero(fold_of != fold).tolist()
                learned = tuple(labelled_of(rest, percent, seed, fold))
                found += [Training(one, percent, seed, fold, learned, tested) for one in methods]
        if simulated:
            learned = tuple(range(simulated))
            found += [Training(one, None, seed, 0, learned, everything) for one in methods]
    return found


class Done:
    """Counts of finished trainings in a file, a line each, by a key of all that decides them."""

    def __init__(self, folder: Path) -> None:
        """A line that a crash cut off is left out.  FactoryError for a folder that is no use."""
        self._known: dict[str, dict[int, Counts]] = {}
        self._file = LineFile(folder, DONE_NAME)
        for line in self._file.lines:
            self._read(line)

    def __contains__(self, key: str) -> bool:
        return key in self._known

    def get(self, key: str) -> dict[int, Counts]:
        """Number of a tested picture -> its counts."""
        return self._known[key]

    def add(self, key: str, counts: dict[int, Counts]) -> None:
        """Written at once."""
        line = {"key": key, "counts": {n: one.to_json() for n, one in counts.items()}}
        self._file.add(line)
        self._known[key] = counts

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self, line: bytes) -> None:
        try:
            values = json.loads(line)
            counts = {int(n): Counts.from_json(one) for n, one in values["counts"].items()}
            self._known[values["key"]] = counts
        except (ValueError, KeyError, TypeError, AttributeError):
            return


def key_of(training: Training, *decides: object) -> str:
    """Changes with the training and with whatever else decides its counts."""
    parts = json.dumps([vars(training), *map(str, decides)], sort_keys=True)
    return hashlib.blake2b(parts.encode(), digest_size=16).hexdigest()


def run(
    training: Training,
    inputs: Callable[[str], tuple[Pictures, Pictures | None]],
    targets: tuple[Indices, Indices | None],
    settings: dict[str, Any],
) -> dict[int, Counts]:
    """Train, test, count.

    inputs: label of a method -> what it makes of the real pictures, and of the factory's.
    targets: the classes of both.  settings: for `network.trained`, but the seed.
    """
    from ...factory.seeds import spawn_key
    from .network import probabilities, trained

    real, simulated = inputs(training.method)
    source, truth = (real, targets[0])
    if training.percent is None:
        assert simulated is not None
        assert targets[1] is not None
        source, truth = simulated, targets[1]
    learned = list(training.learned)
    # The same for every method, so that nothing but the pictures differs.
    seed = spawn_key(training.seed, training.fold, str(training.percent))[0]
    network = trained(source[learned], truth[learned], seed=seed, **settings)
    return {n: counts_of(probabilities(network, real[n]), targets[0][n]) for n in training.tested}


def by_seed(
    trainings: Sequence[Training], counts: Callable[[Training], dict[int, Counts]]
) -> Iterator[tuple[tuple[str, float | None], list[list[Counts]]]]:
    """(method, percent) -> a seed each, the counts of all pictures in order."""
    rows: dict[tuple[str, float | None], dict[int, dict[int, Counts]]] = {}
    for one in trainings:
        row = rows.setdefault((one.method, one.percent), {})
        row.setdefault(one.seed, {}).update(counts(one))
    for key, seeds in rows.items():
        yield key, [[found[n] for n in sorted(found)] for _, found in sorted(seeds.items())]
