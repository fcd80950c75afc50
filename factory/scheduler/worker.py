"""What a worker process does: make one shard, frame by frame."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from factory.errors import FactoryError, FrameError
from factory.frame import FrameRef
from factory.sample import Axis, Column, Pair, PairSource
from factory.scheduler.journal import Journal, open_journal
from factory.scheduler.plan import Item, ShardTask
from factory.shards.failures import Failure, FailureKind
from factory.shards.manifest import ShardInfo
from factory.shards.schema import Provenance, check_pair
from factory.shards.settings import DatasetSettings
from factory.shards.writer import write_shard


@dataclass(frozen=True)
class Recipe:
    """How every shard of a dataset is made; the same for all tasks of a run.

    source: builds the pair source from `config`; an importable function or class, because each
        worker process calls it for itself.
    """

    directory: Path
    source: Callable[[Any], PairSource]
    config: Any
    provenance: Provenance
    dataset: DatasetSettings
    frame_timeout_s: float


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
    """What came of a job: `info` is None when no frame gave a sample, or when `kept`."""

    info: ShardInfo | None
    failures: tuple[Failure, ...]
    kept: bool = False


# One source a process: it holds the renderer and its scene, which are slow to build.
_built: tuple[tuple[object, str], PairSource] | None = None


def run_job(pickled: bytes) -> ShardResult:
    """`make_shard` as a pool calls it: job in and errors out survive any transport.

    The job comes pickled, so that a source that cannot be imported is an error of this call and
    not the death of a worker that could not read its task.  Errors are raised as plain
    FactoryError or RuntimeError (with the traceback as text), which every process can unpickle.
    """
    try:
        job: ShardJob = pickle.loads(pickled)
        return make_shard(job)
    except FactoryError as error:
        raise FactoryError(_one_line(str(error))) from None
    except Exception:
        raise RuntimeError(traceback.format_exc()) from None


def make_shard(job: ShardJob) -> ShardResult:
    """Make the job's shard; a frame that fails is recorded and the rest goes on.

    Raises FactoryError for what no other frame can do better: a missing renderer, a full disk.
    """
    recipe = job.recipe
    with open_journal(job.journal, recipe.frame_timeout_s) as journal:
        with journal.watched():
            source = _source(recipe)
            frames = _Frames(job, source, journal, source.axes(), source.columns())
        lacking = [item for item in enumerate(job.task.items) if item[1][0].name in job.lacking]
        if lacking:
            failures = [frames.attempt(index, item)[1] for index, item in lacking]
            if all(failures):
                return ShardResult(None, tuple(f for f in failures if f), kept=True)
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
        info = replace(info, plan=job.task.digest, failed=failed)
    return ShardResult(info, tuple(frames.failures))


def _source(recipe: Recipe) -> PairSource:
    global _built
    key = (recipe.source, recipe.provenance.config_hash)
    if _built is None or _built[0] != key:
        _built = None
        _built = (key, recipe.source(recipe.config))
    return _built[1]


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
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(last.filename).name}:{last.lineno}"
            text = f"{ref.name}: {type(error).__name__}: {error} ({place})"
            return [], self._failure(ref, "error", text)

    def _failure(self, ref: FrameRef, kind: FailureKind, reason: str) -> Failure:
        return Failure(ref, kind, _one_line(reason), self._job.task.path)


def _one_line(text: str) -> str:
    return " ".join(text.split())
