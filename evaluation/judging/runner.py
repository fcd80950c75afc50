"""The engine of every report: methods on images, measured on worker processes.

    methods x subjects -> run() -> Measured: a table of one row for each method and subject

A report brings its images or sequences (`Subject`) with what is measured on them; whatever it then
says is computed from the table.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from ...factory.common.workers.tasks import TaskLost, TaskPool
from ..filters import checked, method_of
from ..metrics.measure import Grey
from .methods import Method, network, reason

if TYPE_CHECKING:
    import pandas as pd

    from ...factory.dataset.fan_geometry import FanGeometry

SECONDS = "cpu_s"
"""Column of the seconds of a method on an image: of the CPU, elapsed ones where a GPU works."""


class Subject(ABC):
    """What methods are judged on, such as an image or a sequence; it travels to the workers.

    fold: which of a method's parameters are used, so that no subject chose them.
    """

    fold: int = 0

    @property
    def images(self) -> int:
        """Number of images in it, for the time limit."""
        return 1

    @abstractmethod
    def load(self) -> None:
        """Read what methods get.  Raises FactoryError, which ends the report, for damaged files."""

    @abstractmethod
    def denoise(self, method: Method, device: str) -> Denoised:
        """Run a method; whatever it raises costs the method its row."""

    @abstractmethod
    def measure(self, image: Any) -> Mapping[str, Any]:
        """The figures of a denoised subject.  Raises FactoryError for a damaged one."""


class ImageSubject(Subject):
    """A single image that methods are judged on."""

    @abstractmethod
    def noisy_image(self) -> Grey:
        """(H, W) in 0..1.  Raises FactoryError for a damaged image."""

    def geometry(self) -> FanGeometry | None:
        """Where range and bearing are; None where nothing says so."""
        return None

    def load(self) -> None:
        """See `Subject`."""
        self.noisy_image()

    def denoise(self, method: Method, device: str) -> Denoised:
        """See `Subject`; seconds are of the CPU, elapsed ones where a GPU works."""
        image = self.noisy_image()
        clock = time.process_time  # what other processes take does not count
        if method.weights is None:
            start = clock()
            result = method_of(method.name)(image, method.parameters_of(self.fold))
            return Denoised(result, clock() - start)
        loaded = network(method.weights, device)  # before the clock runs
        geometry = self.geometry() if loaded.runtime.extras else None
        if loaded.runtime.on_gpu:
            clock = time.perf_counter  # a processor that waits for a GPU seems idle
        start = clock()
        result = loaded(image, geometry)
        seconds = clock() - start
        return Denoised(checked(method.name, result, image), seconds)


class Denoised(NamedTuple):
    """What a method made of a subject, in 0..1, and its seconds; NaN where nobody took them."""

    image: Any
    seconds: float = math.nan


@dataclass(frozen=True, eq=False)
class JudgingTask:
    """Methods that differ in their levels alone on one subject; the unit that travels to a worker.

    number: of the subject.  keep: whether the denoised images come back.
    """

    methods: tuple[Method, ...]
    number: int
    subject: Subject
    device: str
    keep: bool = False


class MethodResult(NamedTuple):
    """The figures of a method on a subject, and its image where that is kept."""

    figures: dict[str, Any]
    image: Grey | None


@dataclass(eq=False)
class Measured:
    """The figures that methods reached on images.

    figures: label -> number of the image -> its figures; an image that a method has none of is
    absent.  lost: label -> why there are none at all.  images: (label, number) -> what was kept.
    """

    figures: dict[str, dict[int, dict[str, Any]]] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    images: dict[tuple[str, int], Grey] = field(default_factory=dict)

    def table(self) -> pd.DataFrame:
        """A row for each method and image, in order: method, number of the image, figures."""
        import pandas as pd

        rows = [
            {"method": label, "picture": number, **figures}
            for label, figures_of_image in self.figures.items()
            if label not in self.lost
            for number, figures in sorted(figures_of_image.items())
        ]
        return pd.DataFrame(rows, columns=None if rows else ["method", "picture"])

    def wide(self, groups: Sequence[int] | None = None) -> dict[str, pd.DataFrame]:
        """Figure -> its values of each image (rows, in order) by each method (columns).

        groups: (images,) number of the group of each image, whose means are taken, infinite values
        left out; None: each image alone.
        """
        table = self.table()
        if groups is not None:
            table["picture"] = [groups[number] for number in table["picture"]]
            finite = table.replace([math.inf, -math.inf], math.nan)
            table = finite.groupby(["picture", "method"], as_index=False).mean()
        table = table.set_index(["picture", "method"])
        return {str(name): table[name].unstack("method") for name in table}

    def median_seconds(self, label: str) -> float:
        """Median time of a method for an image; the first one loads and compiles."""
        return median(float(figures[SECONDS]) for figures in self.figures[label].values())


def run(
    methods: Sequence[Method],
    batches: Iterable[Mapping[int, Subject]],
    pool: TaskPool,
    *,
    device: str,
    timeout_s: float,
    keep: Callable[[int], bool] = lambda number: False,
    tick: Callable[[], object] = lambda: None,
) -> Measured:
    """Every method on every image.

    methods: of different labels.  batches: number -> image; of a batch all are in memory.
    timeout_s: for one method on one image.
    keep: whether the denoised images of an image come back.
    tick: called for each result of a method on an image.

    A method that fails on an image, or whose worker dies, loses its row.  Raises
    FactoryError for an image that cannot be read.
    """
    measured = Measured({method.label: {} for method in methods})
    forms: dict[str, list[Method]] = {}
    for method in methods:
        forms.setdefault(method.output, []).append(method)

    def limit_s(task: JudgingTask) -> float:
        return timeout_s * task.subject.images

    for batch in batches:
        waiting: deque[JudgingTask] = deque()
        for number, subject in batch.items():
            for alike in forms.values():
                if alike[0].label not in measured.lost:
                    waiting.append(JudgingTask(tuple(alike), number, subject, device, keep(number)))
        for task, results in pool.run(measure_task, waiting, limit_s):
            for _ in task.methods:
                tick()
            labels = [method.label for method in task.methods]
            if isinstance(results, TaskLost | str):
                loss = results if isinstance(results, str) else results.reason
                measured.lost |= dict.fromkeys(labels, loss)
                # The pool takes tasks from the queue meanwhile.
                for other in [other for other in waiting if other.methods == task.methods]:
                    waiting.remove(other)
                continue
            for label, result in zip(labels, results, strict=True):
                measured.figures[label][task.number] = result.figures
                if result.image is not None:
                    measured.images[label, task.number] = result.image
    for label in measured.lost:
        measured.figures[label].clear()
    return measured


def measure_task(task: JudgingTask) -> list[MethodResult] | str:
    """Run methods and measure what they give, in their order; or why they failed.

    Raises FactoryError for a damaged image.
    """
    task.subject.load()
    try:
        denoised = task.subject.denoise(task.methods[0], task.device)
    except Exception as error:  # a method that crashes loses its row, not the report
        return reason(error)
    results = []
    for method in task.methods:
        image = denoised.image if method.levels is None else method.levels(denoised.image)
        figures = {**task.subject.measure(image), SECONDS: denoised.seconds}
        results.append(MethodResult(figures, image if task.keep else None))
    return results
