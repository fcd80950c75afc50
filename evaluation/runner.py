"""The engine of every report: methods on pictures, measured on worker processes, resumed.

    methods x pictures -> run() -> Measured: a table of one row for each method and picture

A report brings its pictures (`Subject`) with what is measured on them; whatever it then says is
computed from the table.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..factory.files import explain_os_errors
from ..factory.scheduler.workers.tasks import TaskLost, TaskPool
from .filters import REGISTRY, checked
from .methods import Method, network, reason
from .metrics.measure import Figures, Gray

if TYPE_CHECKING:
    import pandas as pd

    from ..factory.sonar.geometry import FanGeometry

SECONDS = "cpu_s"
"""Column of the seconds of a method on a picture: of the CPU, elapsed ones where a GPU works."""


class Subject:
    """A picture that methods are judged on; it travels to the workers."""

    key: str
    """Changes with all that methods see of it and are measured by; asked where figures are kept."""

    def seen(self) -> Gray:
        """(H, W) in 0..1.  Raises FactoryError for a damaged picture."""
        raise NotImplementedError

    def geometry(self) -> FanGeometry | None:
        """Where range and bearing are; None where nothing says so."""
        return None

    def given(self, method: Method) -> Gray:
        """What another program made of it.  Raises FactoryError where there is nothing."""
        raise NotImplementedError

    def measure(self, image: Gray) -> Figures:
        """The figures of a denoised picture.  Raises FactoryError for a damaged subject."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Task:
    """Some methods on some pictures, by their numbers; the unit that travels to a worker.

    keep: numbers of the pictures whose denoised images come back.  again: a worker died with it.
    """

    methods: tuple[Method, ...]
    subjects: Mapping[int, Subject]
    device: str
    keep: frozenset[int] = frozenset()
    again: bool = False


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

    def wide(self) -> dict[str, pd.DataFrame]:
        """Figure -> its values of each picture (rows, in order) by each method (columns)."""
        table = self.table().set_index(["picture", "method"])
        return {str(name): table[name].unstack("method") for name in table}


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
    keys = {} if store is None else {m.label: f"{m.key}-{program_digest(device)}" for m in methods}
    for batch in batches:
        every = list(batch.items())
        waiting: deque[Task] = deque()
        for first in range(0, len(every), chunk):
            some = dict(every[first : first + chunk])
            todo = []
            for method in methods:
                if method.label in found.lost:
                    continue
                known = {} if store is None else _known(store, keys[method.label], some)
                if len(known) == len(some):
                    found.figures[method.label] |= known
                else:
                    todo.append(method)
            if todo:
                waiting.append(Task(tuple(todo), some, device, frozenset(filter(keep, some))))
        for task, results in pool.run(
            measure_task,
            waiting,
            lambda task: timeout_s * len(task.subjects) * len({m.output for m in task.methods}),
        ):
            if isinstance(results, TaskLost):
                if again := _again(task):
                    waiting.extendleft(again)
                    continue
                results = [Result(lost=results.reason)] * len(task.methods)
            for method, result in zip(task.methods, results, strict=True):
                tick(len(task.subjects))
                if result.lost is not None:
                    found.lost.setdefault(method.label, result.lost)
                if method.label in found.lost:
                    continue
                found.figures[method.label] |= result.figures
                found.images |= {(method.label, n): one for n, one in result.images.items()}
                if store is not None and result.figures:
                    pictures = [task.subjects[number].key for number in result.figures]
                    store.add(keys[method.label], pictures, list(result.figures.values()))
            if found.lost:
                alive = [
                    replace(one, methods=left)
                    for one in waiting
                    if (left := tuple(m for m in one.methods if m.label not in found.lost))
                ]
                waiting.clear()
                waiting.extend(alive)
    return found


def _known(store: FigureStore, key: str, some: Mapping[int, Subject]) -> dict[int, Figures]:
    """What the store has of a method on these pictures."""
    known = {number: store.get(key, subject.key) for number, subject in some.items()}
    return {number: figures for number, figures in known.items() if figures is not None}


def _again(task: Task) -> list[Task]:
    """What to try once more after a worker died with this task: each method alone."""
    if task.again:
        return []
    outputs = dict.fromkeys(method.output for method in task.methods)
    apart = [tuple(m for m in task.methods if m.output == output) for output in outputs]
    return [replace(task, methods=methods, again=True) for methods in apart]


def measure_task(task: Task) -> list[Result]:
    """Run the methods and measure what they give; a result for each, in their order.

    Raises FactoryError for a damaged picture.
    """
    results = []
    outputs: dict[str, dict[int, tuple[Gray, float]] | str] = {}
    for method in task.methods:
        if method.output not in outputs:
            outputs[method.output] = _applied(method, task)
        output = outputs[method.output]
        if isinstance(output, str):
            results.append(Result(lost=output))
            continue
        result = Result()
        for number, (image, seconds) in output.items():
            if method.levels is not None:
                image = method.levels(image)
            result.figures[number] = {**task.subjects[number].measure(image), SECONDS: seconds}
            if number in task.keep:
                result.images[number] = image
        results.append(result)
    return results


def _applied(method: Method, task: Task) -> dict[int, tuple[Gray, float]] | str:
    """The method's picture of each subject without levels, (H, W) in 0..1, and its seconds.

    Seconds are NaN where another program took them.  Or why the method failed.  Raises FactoryError
    for a damaged subject.
    """
    found = {}
    for number, subject in task.subjects.items():
        seen = None if method.given else subject.seen()
        try:
            if seen is None:
                found[number] = subject.given(method), math.nan
            else:
                found[number] = _timed(method, subject, seen, task.device)
        except Exception as error:  # a method that crashes loses its row, not the report
            return reason(error)
    return found


def _timed(method: Method, subject: Subject, image: Gray, device: str) -> tuple[Gray, float]:
    clock = time.process_time  # what other processes take does not count
    if method.weights is None:
        start = clock()
        result = REGISTRY[method.name](image, method.parameters)
        return result, clock() - start
    loaded = network(method.weights, device)  # before the clock runs
    geometry = subject.geometry() if loaded.runtime.extras else None
    if loaded.runtime.on_gpu:
        clock = time.perf_counter  # a processor that waits for a GPU seems idle
    start = clock()
    result = loaded(image, geometry)
    seconds = clock() - start
    return checked(method.name, result, image), seconds


STORE_NAME = "measured.jsonl"

_LIBRARIES = (
    "numpy", "scipy", "opencv-python-headless", "scikit-image", "torch", "onnxruntime",
)  # fmt: skip
_ROOM = Path(__file__).parent
# Wider than need be: a digest that is too narrow would let old figures pass for new ones.
_SOURCES = (
    _ROOM,
    _ROOM.parent / "models",
    _ROOM.parent / "factory" / "dataset",
    _ROOM.parent / "factory" / "sonar",
)


@lru_cache(maxsize=4)
def program_digest(device: str) -> str:
    """Changes with the code, the libraries and the device that decide figures."""
    known = {one.name: one.version for one in metadata.distributions() if one.name in _LIBRARIES}
    parts = [sources_digest(*_SOURCES), *sorted(known.items()), _device_kind(device)]
    return hashlib.blake2b(repr(parts).encode(), digest_size=12).hexdigest()


def sources_digest(*folders: Path) -> str:
    """Changes with every Python file below these folders, and its name."""
    digest = hashlib.blake2b(digest_size=12)
    for folder in folders:
        for file in sorted(folder.resolve().rglob("*.py")):
            digest.update(file.relative_to(folder.resolve()).as_posix().encode() + b"\n")
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _device_kind(device: str) -> str:
    if device == "cpu" or find_spec("torch") is None:
        return device
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"


class FigureStore:
    """Figures by (method key, picture key), appended line by line to a file as they are measured.

    The keys cover everything that decides the figures, so figures of other code, another picture
    or other parameters are never found.  A line that a crash cut off is measured again.
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
        line = {"method": method, "pictures": list(pictures), "figures": list(figures)}
        with explain_os_errors(self._path, "out"):
            self._file.write(json.dumps(line).encode() + b"\n")
            self._file.flush()
        self._keep(line)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _keep(self, line: dict[str, Any]) -> None:
        for picture, figures in zip(line["pictures"], line["figures"], strict=True):
            self._known[line["method"], picture] = dict(figures)
