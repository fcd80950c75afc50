"""Every method on every judged picture: nearness to the reference, and figures without a truth."""

from __future__ import annotations

import hashlib
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ..filters.base import Gray
from ..methods.apply import denoised
from ..methods.method import Method, reason
from ..methods.networks import network
from ..metrics.edges import edge_preservation
from ..metrics.speckle import contrast_to_noise, enl, m_index, ratio_mean
from .groups import Judged
from .scenes import SIDE, Scene, scene_of
from .score import Score, score

Figures = dict[str, float]

UNCHANGED = 0.5 / 255
"""A picture that differs nowhere by more is the same in 8 bits."""


@dataclass
class RealRow:
    """A method on all pictures.

    methods: by fold; one for all folds where it is tuned on nothing; none for several frames.
    figures: of each picture in order, None where there is none of it.
    images: picture's number -> what is shown of it, or needed later.
    lost: why there are no figures.
    """

    label: str
    methods: tuple[Method, ...]
    figures: list[Figures | None] = field(default_factory=list)
    images: dict[int, Gray] = field(default_factory=dict)
    lost: str | None = None

    def method(self, fold: int) -> Method:
        """The one that judges a group of this fold."""
        return self.methods[fold % len(self.methods)]

    @property
    def is_noisy(self) -> bool:
        """Whether this is the picture as it is."""
        return bool(self.methods) and self.methods[0].is_noisy

    @property
    def sees_several(self) -> bool:
        """Whether it is a network that sees frames beside the judged one; the rest judge it."""
        return self.is_network and self.methods[0].looks

    @property
    def is_network(self) -> bool:
        """Whether trained weights made it."""
        return bool(self.methods) and self.methods[0].weights is not None


@dataclass(frozen=True, eq=False)
class Task:
    """A method on a picture, or a picture that is there already.

    number: of the picture among all that are judged.  looks: (T, H, W), for a method that sees
    several frames, the judged one last.
    """

    label: str
    number: int
    judged: Judged
    method: Method | None
    device: str
    keep: bool
    image: Gray | None = None
    looks: Gray | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """What a task gives; image: where it was to be kept."""

    figures: Figures
    image: Gray | None


def figures_of(image: Gray, shared: Scene) -> Figures:
    """The figures without a truth of (H, W) in 0..1; NaN where one does not exist."""
    dark, bright = (float(np.mean(image[part])) for part in (shared.dark, shared.bright))
    found = {
        "enl": enl(image, shared.zones, side=SIDE),
        "cnr": contrast_to_noise(image, shared.bright, shared.dark),
        "shadow_level": dark / bright if bright > 0 else float("nan"),
        "edges_kept": edge_preservation(shared.noisy, image, data_range=1.0, mask=shared.sector),
        "ratio_mean": ratio_mean(shared.noisy, image, data_range=1.0),
        "m_index": m_index(shared.noisy, image, shared.zones, data_range=1.0, side=SIDE),
    }
    if shared.objects is not None and shared.around is not None:
        found["object_cnr"] = contrast_to_noise(image, shared.objects, shared.around)
    return found


def measure(
    batches: Iterable[tuple[int, Sequence[Judged]]],
    rows: Sequence[RealRow],
    pool: TaskPool,
    device: str,
    timeout_s: float,
    kept: Callable[[int], bool],
    tick: Callable[[int], object] = lambda done: None,
) -> dict[int, Judged]:
    """Measure all rows on all pictures, batch after batch, into the rows.

    batches: a fold, and pictures that are judged by its methods.
    kept: whether images of this picture, counted over all batches, are kept in the rows.
    tick: told how many results are in.
    Returns number -> picture of those that are kept.  A method that fails on a picture loses its
    row.  FactoryError when a picture cannot be measured.
    """
    first, shown = 0, {}
    for fold, pictures in batches:
        numbered = list(enumerate(pictures, start=first))
        first += len(numbered)
        shown.update({number: one for number, one in numbered if kept(number)})
        for row in rows:
            row.figures.extend([None] * len(numbered))
        by_label = {row.label: row for row in rows}
        waiting = deque(
            task
            for number, one in numbered
            for row in rows
            if row.lost is None
            and (task := _task(row, fold, number, one, device, kept(number))) is not None
        )
        for task, found in pool.run(_measured, waiting, lambda _: timeout_s):
            row = by_label[task.label]
            if isinstance(found, Result):
                row.figures[task.number] = found.figures
                if found.image is not None:
                    row.images[task.number] = found.image
            else:
                why = found.reason if isinstance(found, TaskLost) else found
                row.lost = row.lost or f"{task.judged.shot.name}: {why}"
            tick(1)
    for row in rows:
        if row.lost is not None:
            row.figures, row.images = [], {}
        elif not any(row.figures):
            row.lost = "too few frames of every group are left for a reference"
    return shown


def multi_frame_rows(count: int) -> list[RealRow]:
    """The rows of so many averaged frames, which no method made."""
    return [RealRow(f"multi-frame {how} ({count})", ()) for how in _SEVERAL]


_SEVERAL = ("mean", "median")


def _task(
    row: RealRow, fold: int, number: int, one: Judged, device: str, keep: bool
) -> Task | None:
    method, several = row.method(fold) if row.methods else None, one.several
    if method is not None and (several is None or not method.looks):
        return Task(row.label, number, replace(one, several=None), method, device, keep)
    if several is None:
        return None
    # What is made of several frames is judged by the others alone.
    bare = replace(one, several=None, reference=several.reference)
    if method is not None:
        return Task(row.label, number, bare, method, device, keep, looks=several.frames)
    image = several.mean if " mean " in row.label else several.median
    return Task(row.label, number, bare, None, device, keep, image)


def _measured(task: Task) -> Result | str:
    judged, method = task.judged, task.method
    shared, before = _shared(_Key.of(judged))
    figures: Figures = {}
    if method is None:
        assert task.image is not None
        image = task.image
    else:
        if method.weights is None and method.looks:
            return "needs several looks at a scene that stands still"
        try:
            image, figures["cpu_s"] = _timed(method, judged, task.device, task.looks)
        except Exception as error:  # a method's own defect must not take the others along
            return reason(error)
    figures["unchanged"] = float(np.abs(image - judged.noisy).max() < UNCHANGED)
    if method is not None and method.levels is not None:
        image = method.levels(image)
    if before is not None:
        assert judged.reference is not None
        near = score(image, judged.reference, judged.where)
        figures["psnr_db"], figures["ssim"] = near.psnr_db, near.ssim
        figures["gain_db"] = near.psnr_db - before.psnr_db
        figures["gain_ssim"] = near.ssim - before.ssim
    return Result({**figures, **figures_of(image, shared)}, image if task.keep else None)


def _timed(method: Method, judged: Judged, device: str, looks: Gray | None) -> tuple[Gray, float]:
    """The method's picture and its seconds: of the CPU, elapsed ones where a GPU works."""
    clock = time.process_time
    if method.weights is not None and network(method.weights, device).on_gpu:
        clock = time.perf_counter
    start = clock()
    given = judged.noisy if looks is None else looks
    image = denoised(method, given, device, None, judged.geometry)
    return image, clock() - start


@dataclass(frozen=True)
class _Key:
    """A picture by its content: what it shares is worked out once for all methods."""

    digest: bytes
    judged: Judged = field(compare=False, repr=False)

    @classmethod
    def of(cls, judged: Judged) -> _Key:
        content = hashlib.blake2b(digest_size=16)
        for array in (judged.noisy, judged.reference, judged.where):
            if array is not None:
                content.update(np.ascontiguousarray(array).tobytes())
        return cls(content.digest(), judged)


@lru_cache(maxsize=3)
def _shared(key: _Key) -> tuple[Scene, Score | None]:
    """What is measured on a picture, and how near it is to its reference as it is."""
    judged = key.judged
    classes = None if judged.shot.mask is None else judged.shot.classes()
    shared = scene_of(judged.noisy, judged.where, classes, str(judged.shot.path))
    if judged.reference is None:
        return shared, None
    return shared, score(judged.noisy, judged.reference, judged.where)
