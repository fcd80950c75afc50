"""Every method on every pair, in parallel, resumed: figures first, then what they say together."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ..data.pairs import Item, picture
from ..methods.method import NOISY, Method
from ..metrics import fidelity as metrics
from ..settings import EvaluationSettings
from .fingerprint import network_digest, program_digest
from .store import Figures, FigureStore
from .task import Task, measure_task

Values = npt.NDArray[np.float64]

_CHUNK = 4
_TRIES = 2
"""A method whose worker died is tried once more, alone; then it has lost its row."""


@dataclass(frozen=True)
class Row:
    """A measured method.  lost: why there are no figures.

    values: metric -> (N,) figures in the order of the items, NaN where it does not exist.
    """

    method: Method
    values: dict[str, Values] = field(default_factory=dict)
    milliseconds: float = math.nan
    lost: str | None = None


class _Bench:
    """The state of one measurement: what is known, what is lost, what waits."""

    def __init__(
        self, settings: EvaluationSettings, items: Sequence[Item], store: FigureStore
    ) -> None:
        self.settings, self.items, self.store = settings, items, store
        self.lost: dict[str, str] = {}  # label of a method -> why
        self.waiting: deque[Task] = deque()
        texture = "texture" if settings.texture else "plain"
        self._suffix = f"{program_digest()}-{texture}-{settings.shadow_threshold:g}"

    def known(self, method: Method, item: Item) -> Figures | None:
        return self.store.get(self._method_key(method), _picture_key(method, item))

    def plan(self, methods: Sequence[Method]) -> None:
        for first in range(0, len(self.items), _CHUNK):
            chunk = tuple(self.items[first : first + _CHUNK])
            todo = tuple(m for m in methods if any(self.known(m, item) is None for item in chunk))
            if todo:
                self.waiting.append(self._task(todo, chunk))

    def _task(self, methods: tuple[Method, ...], items: tuple[Item, ...]) -> Task:
        s = self.settings
        return Task(methods, items, s.shadow_threshold, s.texture, s.device)

    def _method_key(self, method: Method) -> str:
        key = f"{method.key}-{self._suffix}"
        return f"{key}-{self._network_digest}" if method.weights else key

    @cached_property
    def _network_digest(self) -> str:
        return network_digest(self.settings.device)

    def timeout_s(self, task: Task) -> float:
        """How long a worker may take for a task."""
        outputs = len({method.output for method in task.methods})
        return self.settings.image_timeout_s * len(task.items) * outputs

    def keep(self, task: Task, found: Any) -> None:
        """Take over what a worker measured."""
        for method, (error, figures) in zip(task.methods, found, strict=True):
            if error is not None:
                self._lose(method, error)
            elif method.label not in self.lost:
                pictures = [_picture_key(method, item) for item in task.items]
                self.store.add(self._method_key(method), pictures, figures)

    def died(self, task: Task, why: str) -> list[Task]:
        """What to try again after a worker died with this task."""
        groups: dict[str, list[Method]] = {}
        for method in task.methods:
            groups.setdefault(method.output, []).append(method)
        if len(groups) > 1:
            # Which method was it?  Each alone.
            return [replace(task, methods=tuple(group), tries=1) for group in groups.values()]
        if task.tries < _TRIES:
            return [replace(task, tries=task.tries + 1)]
        for method in task.methods:
            self._lose(method, why)
        return []

    def _lose(self, method: Method, why: str) -> None:
        if method.label not in self.lost:
            self.lost[method.label] = why
            still = [
                replace(task, methods=tuple(m for m in task.methods if m != method))
                for task in self.waiting
            ]
            self.waiting.clear()
            self.waiting.extend(task for task in still if task.methods)

    def row(self, method: Method) -> Row:
        if method.label in self.lost:
            return Row(method, lost=self.lost[method.label])
        figures = [self.known(method, item) for item in self.items]
        whole = [one for one in figures if one is not None]
        names = [name for name in whole[0] if name != "milliseconds"]
        values = {name: np.array([one[name] for one in whole], dtype=float) for name in names}
        for name in values:
            if name.startswith("psnr"):
                values[name] = np.minimum(values[name], metrics.PSNR_CAP_DB)
        return Row(method, values, float(np.median([one["milliseconds"] for one in whole])))


def measure_rows(
    settings: EvaluationSettings,
    items: Sequence[Item],
    methods: Sequence[Method],
    store: FigureStore,
    pool: TaskPool,
    *,
    title: str = "measuring",
) -> list[Row]:
    """The rows of the methods, the noisy images' first; what the store has is not done again.

    A method that fails on a picture, or whose worker dies twice, loses its row, which says why.
    Raises FactoryError for a dataset that cannot be read.
    """
    every = list({method.label: method for method in (NOISY, *methods)}.values())
    picture.cache_clear()  # files may have changed since the last report of this process
    bench = _Bench(settings, items, store)
    bench.plan(every)
    total = len(every) * len(items)
    left = sum(len(task.methods) * len(task.items) for task in bench.waiting)
    with progress_bar(total=total, initial=total - left, unit="image", desc=title) as bar:
        for task, found in pool.run(measure_task, bench.waiting, bench.timeout_s):
            if isinstance(found, TaskLost):
                bench.waiting.extendleft(bench.died(task, found.reason))
                continue
            bench.keep(task, found)
            bar.update(len(task.methods) * len(task.items))
            bar.set_postfix_str(f"{len(bench.lost)} lost" if bench.lost else "")
    return [bench.row(method) for method in every]


def _picture_key(method: Method, item: Item) -> str:
    return f"{item.key}+{len(item.looks)}" if method.looks else item.key
