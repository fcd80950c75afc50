"""The engine of every report: methods on pictures, measured on worker processes, resumed.

    methods x pictures -> run() -> Measured: a table of one row for each method and picture

A report brings its pictures (`Subject`) with what is measured on them; whatever it then says is
computed from the table.
"""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..factory.errors import FactoryError
from ..factory.files import explain_os_errors
from ..factory.scheduler.workers.tasks import TaskLost, TaskPool
from .filters import REGISTRY
from .filters.base import Gray
from .fingerprint import network_digest, program_digest
from .methods.method import Method, reason
from .methods.networks import network
from .metrics.measure import Figures

if TYPE_CHECKING:
    import pandas as pd

    from ..factory.sonar.geometry import FanGeometry

STORE_NAME = "measured.jsonl"
SECONDS = "cpu_s"
"""Column of the seconds of a method on a picture: of the CPU, elapsed ones where a GPU works."""

_TRIES = 2
"""A method whose worker died is tried once more, alone; then it has lost its row."""


class MethodFailed(Exception):
    """A method gave no picture: it loses its row, for the reason that this says."""


class Subject(Protocol):
    """A picture that methods are judged on; it travels to the workers."""

    def key(self, method: Method) -> str:
        """Changes with everything that a method sees of it and is measured by."""
        ...

    def seen(self, method: Method) -> Gray | None:
        """(H, W) in 0..1, or (T, H, W) for a method of several looks; None: nothing for it.

        Raises FactoryError for a damaged picture, MethodFailed for a method that needs more.
        """
        ...

    def geometry(self) -> FanGeometry | None:
        """Where range and bearing are; None where nothing says so."""
        ...

    def given(self, method: Method) -> Gray | None:
        """What a method that is no function made of it; None where there is none."""
        ...

    def measure(self, image: Gray, method: Method) -> Figures:
        """The figures of a denoised picture.  Raises FactoryError for a damaged subject."""
        ...


@dataclass(frozen=True, eq=False)
class Task:
    """Some methods on some pictures, by their numbers; the unit that travels to a worker.

    keep: numbers of the pictures whose denoised images come back.
    """

    methods: tuple[Method, ...]
    subjects: Mapping[int, Subject]
    device: str
    keep: frozenset[int] = frozenset()
    tries: int = 0


@dataclass(frozen=True, eq=False)
class Result:
    """What a method gave: figures and images by number of the picture, or why it failed."""

    figures: dict[int, Figures] = field(default_factory=dict)
    images: dict[int, Gray] = field(default_factory=dict)
    lost: str | None = None


@dataclass(eq=False)
class Measured:
    """What was measured.

    figures: label -> number of the picture -> its figures; a picture that a method has none of is
    absent.  lost: label -> why there are none at all.  images: (label, number) -> what was kept.
    """

    figures: dict[str, dict[int, Figures]] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    images: dict[tuple[str, int], Gray] = field(default_factory=dict)

    def table(self) -> pd.DataFrame:
        """A row for each method and picture, in order: method, picture, and its figures."""
        import pandas as pd

        rows = [
            {"method": label, "picture": number, **figures}
            for label, found in self.figures.items()
            if label not in self.lost
            for number, figures in sorted(found.items())
        ]
        return pd.DataFrame(rows, columns=None if rows else ["method", "picture"])


def run(
    methods: Sequence[Method],
    batches: Iterable[Mapping[int, Subject]],
    pool: TaskPool,
    *,
    device: str,
    timeout_s: float,
    store: FigureStore | None = None,
    chunk: int = 1,
    keep: Callable[[int], bool] = lambda number: False,
    tick: Callable[[int], object] = lambda done: None,
) -> Measured:
    """Every method on every picture.

    methods: of different labels.  batches: number -> picture; of a batch all are in memory.
    timeout_s: for one method on one picture.  store: what it knows is not measured again.
    chunk: pictures in a task.  keep: whether the images of a picture come back.
    tick: called with the number of results that are in.

    A method that fails on a picture, or whose worker dies twice, loses its row.  Raises
    FactoryError for a picture that cannot be read.
    """
    found = Measured({method.label: {} for method in methods})
    for batch in batches:
        bench = _Bench(found, methods, device, store, tick)
        waiting = deque(bench.tasks(batch, chunk, keep))
        for task, results in pool.run(
            measure_task, waiting, lambda task: timeout_s * len(task.subjects) * _outputs(task)
        ):
            if isinstance(results, TaskLost):
                waiting.extendleft(bench.died(task, results.reason))
                continue
            bench.take(task, results)
            if found.lost:
                alive = [
                    replace(one, methods=left)
                    for one in waiting
                    if (left := tuple(m for m in one.methods if m.label not in found.lost))
                ]
                waiting.clear()
                waiting.extend(alive)
    return found


def measure_task(task: Task) -> list[Result]:
    """Run the methods and measure what they give; a result for each, in their order.

    Raises FactoryError for a damaged picture.
    """
    results = []
    outputs: dict[str, tuple[dict[int, Gray], dict[int, float]] | str] = {}
    for method in task.methods:
        if method.output not in outputs:
            outputs[method.output] = _applied(method, task)
        output = outputs[method.output]
        if isinstance(output, str):
            results.append(Result(lost=output))
            continue
        result = Result()
        for number, image in output[0].items():
            if method.levels is not None:
                image = method.levels(image)
            measured = task.subjects[number].measure(image, method)
            result.figures[number] = {**measured, SECONDS: output[1][number]}
            if number in task.keep:
                result.images[number] = image
        results.append(result)
    return results


def denoised(method: Method, subject: Subject, device: str) -> tuple[Gray | None, float]:
    """The method's picture without levels, (H, W) in 0..1, and its seconds (NaN: unknown).

    None where there is no picture of it.  Raises MethodFailed, and FactoryError for a damaged
    subject.
    """
    if not method.is_function:
        try:
            return subject.given(method), math.nan
        except FactoryError as error:
            raise MethodFailed(str(error)) from error
    image = subject.seen(method)
    if image is None:
        return None, math.nan
    geometry = subject.geometry() if method.uses_geometry else None
    try:
        return _timed(method, image, geometry, device)
    except Exception as error:  # a method that crashes loses its row, not the report
        raise MethodFailed(reason(error)) from error


def _timed(
    method: Method, image: Gray, geometry: FanGeometry | None, device: str
) -> tuple[Gray, float]:
    clock = time.process_time  # what other processes take does not count
    if method.weights is None:
        start = clock()
        result = REGISTRY[method.name](image, method.parameters, geometry)
        return result, clock() - start
    loaded = network(method.weights, device)  # before the clock runs
    if loaded.on_gpu:
        clock = time.perf_counter  # a processor that waits for a GPU seems idle
    start = clock()
    result = loaded(image, geometry)
    seconds = clock() - start
    if result.shape != image.shape or not np.isfinite(result).all():
        raise ValueError(f"gave {result.shape} or NaN for a picture of {image.shape}")
    return np.clip(result, 0, 1).astype(np.float32), seconds


def _applied(method: Method, task: Task) -> tuple[dict[int, Gray], dict[int, float]] | str:
    """The method's picture of each subject that has one, and its seconds; or why it failed."""
    images: dict[int, Gray] = {}
    seconds: dict[int, float] = {}
    for number, subject in task.subjects.items():
        try:
            image, took = denoised(method, subject, task.device)
        except MethodFailed as error:
            return str(error)
        if image is not None:
            images[number], seconds[number] = image, took
    return images, seconds


def _outputs(task: Task) -> int:
    return len({method.output for method in task.methods})


@dataclass(eq=False)
class _Bench:
    """A batch: what is known of it, and what its tasks bring."""

    found: Measured
    methods: Sequence[Method]
    device: str
    store: FigureStore | None
    tick: Callable[[int], object]

    def tasks(
        self, batch: Mapping[int, Subject], chunk: int, keep: Callable[[int], bool]
    ) -> Iterator[Task]:
        """The work that the store does not save."""
        every = list(batch.items())
        for first in range(0, len(every), chunk):
            some = dict(every[first : first + chunk])
            todo = tuple(
                method
                for method in self.methods
                if method.label not in self.found.lost and not self._known(method, some)
            )
            if todo:
                kept = frozenset(number for number in some if keep(number))
                yield Task(todo, some, self.device, kept)

    def take(self, task: Task, results: Sequence[Result]) -> None:
        """Take over what a worker measured."""
        for method, result in zip(task.methods, results, strict=True):
            self.tick(len(task.subjects))
            if method.label in self.found.lost:
                continue
            if result.lost is not None:
                self.found.lost[method.label] = result.lost
                continue
            self.found.figures[method.label] |= result.figures
            for number, image in result.images.items():
                self.found.images[method.label, number] = image
            if self.store is not None and result.figures:
                keys = [task.subjects[number].key(method) for number in result.figures]
                key = self._key(method)
                self.store.add(key, keys, list(result.figures.values()))

    def died(self, task: Task, why: str) -> list[Task]:
        """What to try again after a worker died with this task."""
        groups: dict[str, list[Method]] = {}
        for method in task.methods:
            groups.setdefault(method.output, []).append(method)
        if len(groups) > 1:
            # Which method was it?  Each alone.
            return [replace(task, methods=tuple(group), tries=1) for group in groups.values()]
        if task.tries + 1 < _TRIES:
            return [replace(task, tries=task.tries + 1)]
        for method in task.methods:
            self.found.lost.setdefault(method.label, why)
        return []

    def _known(self, method: Method, some: Mapping[int, Subject]) -> bool:
        """Whether the store has a method on all of these pictures; takes them over."""
        if self.store is None:
            return False
        key = self._key(method)
        known = {n: self.store.get(key, subject.key(method)) for n, subject in some.items()}
        whole = {number: figures for number, figures in known.items() if figures is not None}
        if len(whole) < len(some):
            return False
        self.found.figures[method.label] |= whole
        return True

    def _key(self, method: Method) -> str:
        key = f"{method.key}-{program_digest()}"
        return f"{key}-{self._network_digest}" if method.weights else key

    @cached_property
    def _network_digest(self) -> str:
        return network_digest(self.device)


class FigureStore:
    """Figures by (method key, picture key), appended line by line to a file as they are measured.

    The keys cover everything that decides the figures (see `fingerprint`), so figures of other
    code, another picture or other parameters are never found.  A line that a crash cut off is
    measured again.
    """

    def __init__(self, folder: Path) -> None:
        """Open, or begin, the file in a folder; FactoryError for a folder that is no use."""
        self._known: dict[tuple[str, str], Figures] = {}
        self._path = folder / STORE_NAME
        with explain_os_errors(folder, "out"):
            folder.mkdir(parents=True, exist_ok=True)
            # Opened now, so that a folder that cannot be written to ends the run before its work.
            self._file = self._path.open("a+b")
        self._file.seek(0)
        content = self._file.read()
        if content and not content.endswith(b"\n"):
            self._file.write(b"\n")
        for line in content.splitlines():
            try:
                self._keep(json.loads(line))
            except (ValueError, KeyError, TypeError):
                continue  # cut off, or not ours

    def get(self, method: str, picture: str) -> Figures | None:
        """The figures of a method on a picture, None when they have not been measured."""
        return self._known.get((method, picture))

    def add(self, method: str, pictures: Sequence[str], figures: Sequence[Figures]) -> None:
        """Keep the figures of a method on these pictures; written at once."""
        names = list(figures[0])
        line = {
            "method": method,
            "pictures": list(pictures),
            "names": names,
            "figures": [[one[name] for name in names] for one in figures],
        }
        with explain_os_errors(self._path, "out"):
            self._file.write(json.dumps(line).encode() + b"\n")
            self._file.flush()
        self._keep(line)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _keep(self, line: dict[str, Any]) -> None:
        for picture, values in zip(line["pictures"], line["figures"], strict=True):
            self._known[line["method"], picture] = dict(zip(line["names"], values, strict=True))
