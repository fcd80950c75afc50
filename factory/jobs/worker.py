"""What a worker process does: make one shard, frame by frame, or prepare one frame."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from simnfnd.factory.dataset.format.manifest import ShardInfo
from simnfnd.factory.dataset.format.sample import Axis, Column, Pair, PairSource, Preparer
from simnfnd.factory.dataset.format.schema import Provenance, check_pair
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.failures import Failure, FailureKind
from simnfnd.factory.dataset.write.folder import WORK_NAME
from simnfnd.factory.dataset.write.writer import write_shard
from simnfnd.factory.errors import FactoryError, FrameError, NotRendered
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.jobs.journal import Journal, open_journal
from simnfnd.factory.jobs.plan import Item, ShardTask

T = TypeVar("T")


@dataclass(frozen=True)
class Recipe:
    """How every shard of a dataset is made; the same for all tasks of a run.

    source: builds the pair source from `config`; an importable function or class, because each
        worker process calls it for itself.
    preparer: likewise builds what prepares the frames, in the workers that render; None when
        nothing is to be prepared.
    work: name of the folder of this run's own files, below the dataset's.
    """

    directory: Path
    source: Callable[[Any], PairSource]
    config: Any
    provenance: Provenance
    dataset: DatasetSettings
    frame_timeout_s: float
    preparer: Callable[[Any], Preparer] | None = None
    work: str = WORK_NAME

    @property
    def work_folder(self) -> Path:
        """Where workers tell their progress, and leave what only this run needs."""
        return self.directory / self.work


@dataclass(frozen=True)
class ShardJob:
    """One attempt at one shard.

    journal: file that the worker tells its progress in.
    given_up: frames that killed their workers; recorded as failures without another try.
    lacking: frames that the finished shard on disk lacks.  While all of them still fail, that
        shard is good as it is and kept.
    """

    task: ShardTask
    recipe: Recipe
    journal: Path
    given_up: tuple[Failure, ...] = ()
    lacking: tuple[str, ...] = ()


@dataclass(frozen=True)
class ShardResult:
    """What came of a job: `info` is None when no frame gave a sample, or when `kept`.

    missing: frames that have to be prepared first; then there is nothing else.
    """

    info: ShardInfo | None
    failures: tuple[Failure, ...]
    kept: bool = False
    missing: tuple[FrameRef, ...] = ()


@dataclass(frozen=True)
class PrepareJob:
    """One attempt at preparing one frame."""

    ref: FrameRef
    recipe: Recipe
    journal: Path


@dataclass(frozen=True)
class PrepareResult:
    """What came of it.  hit: nothing had to be done.  bytes: that were added to the cache."""

    failure: Failure | None
    hit: bool = False
    bytes: int = 0


# Built once a process: a preparer holds the renderer and its scene, which are slow to build.
_built: dict[str, tuple[tuple[Any, ...], Any]] = {}


def run_job(pickled: bytes) -> ShardResult:
    """`make_shard` as a pool calls it: job in and errors out survive any transport.

    The job comes pickled, so that a source that cannot be imported is an error of this call and
    not the death of a worker that could not read its task.  Errors are raised as plain
    FactoryError or RuntimeError (with the traceback as text), which every process can unpickle.
    """
    return _carried(make_shard, pickled)


def run_prepare(pickled: bytes) -> PrepareResult:
    """`prepare_frame` as a pool calls it; see `run_job`."""
    return _carried(prepare_frame, pickled)


def _carried(function: Callable[[Any], T], pickled: bytes) -> T:
    try:
        return function(pickle.loads(pickled))
    except FactoryError as error:
        raise FactoryError(_one_line(str(error))) from None
    except Exception:
        raise RuntimeError(traceback.format_exc()) from None


def prepare_frame(job: PrepareJob) -> PrepareResult:
    """Prepare the job's frame, or tell why it cannot be.

    Raises FactoryError for what no other frame can do better: a missing renderer, a full disk.
    """
    recipe, ref = job.recipe, job.ref
    assert recipe.preparer is not None
    with open_journal(job.journal, recipe.frame_timeout_s) as journal:
        with journal.watched():
            preparer: Preparer = _build(recipe.preparer, recipe)
        journal.start(0)
        try:
            with journal.watched():
                made = preparer.prepare(ref)
            return PrepareResult(None, made.hit, made.bytes)
        except FrameError as error:
            return PrepareResult(Failure(ref, "frame", _one_line(str(error)), ""))
        except FactoryError:
            raise
        except Exception as error:
            return PrepareResult(Failure(ref, "error", _defect(ref, error), ""))


def make_shard(job: ShardJob) -> ShardResult:
    """Make the job's shard; a frame that fails is recorded and the rest goes on.

    Raises FactoryError for what no other frame can do better: a missing renderer, a full disk.
    """
    recipe = job.recipe
    with open_journal(job.journal, recipe.frame_timeout_s) as journal:
        with journal.watched():
            source: PairSource = _build(recipe.source, recipe)
            frames = _Frames(job, source, journal, source.axes(), source.columns())
        lacking = [item for item in enumerate(job.task.items) if item[1][0].name in job.lacking]
        try:
            return _made(job, source, frames, lacking)
        except NotRendered as error:
            gone = tuple(ref for ref, _ in job.task.items if ref.name == error.frame)
            return ShardResult(None, (), missing=gone)


def _made(
    job: ShardJob, source: PairSource, frames: _Frames, lacking: list[tuple[int, Item]]
) -> ShardResult:
    recipe = job.recipe
    given_up = {failure.ref.name for failure in job.given_up}

    def missing(items: Iterable[Item]) -> ShardResult | None:
        gone = [ref for ref, _ in items if ref.name not in given_up and not source.ready(ref)]
        return ShardResult(None, (), missing=tuple(gone)) if gone else None

    if lacking:
        if result := missing(item for _, item in lacking):
            return result
        failures = [frames.attempt(index, item)[1] for index, item in lacking]
        if all(failures):
            return ShardResult(None, tuple(f for f in failures if f), kept=True)
    if result := missing(job.task.items):
        return result
    info = write_shard(
        recipe.directory,
        job.task.path,
        frames.pairs(),
        frames.axes,
        frames.columns,
        recipe.provenance,
        recipe.dataset,
    )
    if info is not None:
        failed = tuple(failure.ref.name for failure in frames.failures)
        info = replace(
            info,
            plan=job.task.digest,
            failed=failed,
            config_hash=recipe.provenance.config_hash,
        )
    return ShardResult(info, tuple(frames.failures))


def _build(maker: Callable[[Any], T], recipe: Recipe) -> T:
    """The source or preparer of this process, built at its first job."""
    key = (maker, recipe.provenance.config_hash, recipe.config)
    name = f"{maker.__module__}.{maker.__qualname__}"
    if name not in _built or _built[name][0] != key:
        _built.pop(name, None)
        _built[name] = (key, maker(recipe.config))
    made: T = _built[name][1]
    return made


class _Frames:
    """Goes through the frames of one job, telling the journal."""

    def __init__(
        self,
        job: ShardJob,
        source: PairSource,
        journal: Journal,
        axes: tuple[Axis, Axis],
        columns: tuple[Column, ...],
    ) -> None:
        self.axes, self.columns = axes, columns
        self.failures: list[Failure] = []
        self._job, self._source, self._journal = job, source, journal
        self._given_up = {failure.ref.name: failure for failure in job.given_up}

    def pairs(self) -> Iterator[Pair]:
        """The pairs of all frames in order; frames without go to `failures`."""
        for index, item in enumerate(self._job.task.items):
            pairs, failure = self.attempt(index, item)
            if failure:
                self.failures.append(failure)
                self._journal.failed(index)
            else:
                self._journal.done(index, len(pairs))
            yield from pairs

    def attempt(self, index: int, item: Item) -> tuple[list[Pair], Failure | None]:
        """The checked pairs of one frame, or what kept it from giving them."""
        ref, variants = item
        if ref.name in self._given_up:
            return [], self._given_up[ref.name]
        self._journal.start(index)
        try:
            with self._journal.watched():
                pairs = self._source.pairs(ref, variants)
            if len(pairs) != len(variants):
                raise FrameError(f"{ref.name}: {len(pairs)} pairs for {len(variants)} variants")
            for pair in pairs:
                check_pair(pair, self.axes, self.columns, ref.name)
            return pairs, None
        except FrameError as error:
            return [], self._failure(ref, "frame", str(error))
        except FactoryError:
            raise
        except Exception as error:
            # A defect of ours in one frame must not cost the others; where it is gets recorded.
            return [], self._failure(ref, "error", _defect(ref, error))

    def _failure(self, ref: FrameRef, kind: FailureKind, reason: str) -> Failure:
        return Failure(ref, kind, _one_line(reason), self._job.task.path)


def _defect(ref: FrameRef, error: Exception) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    return _one_line(f"{ref.name}: {type(error).__name__}: {error} ({place})")


def _one_line(text: str) -> str:
    return " ".join(text.split())
