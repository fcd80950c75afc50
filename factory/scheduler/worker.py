"""What a worker process does: make one shard, frame by frame, or prepare one frame."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import pickle
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from ..dataset.format.manifest import ShardInfo
from ..dataset.format.schema import Axis, Column, Pair, PairSource, Preparer, check_pair
from ..dataset.write.failures import Failure, FailureKind
from ..dataset.write.writer import write_shard
from ..errors import FactoryError, FrameError, NotRendered
from ..files import outlet
from ..frame import FrameRef
from ..ownership import fenced
from ..storage.publish import apart_copy
from .job import Recipe
from .pending import DONE, FAILED, START
from .plan import FrameVariants, ShardTask
from .workers.contract import tell

T = TypeVar("T")


@dataclass(frozen=True)
class ShardAttempt:
    """One attempt at one shard.

    trace: file for the traceback of a crash.
    given_up: frames that killed their workers; recorded as failures without another try.
    lacking: frames that the finished shard on disk lacks.  While all of them still fail, that
        shard is good as it is and kept.
    keys: of frames that were prepared for it, by their names; see `sample.Prepared`.
    """

    task: ShardTask
    recipe: Recipe
    trace: Path
    given_up: tuple[Failure, ...] = ()
    lacking: tuple[str, ...] = ()
    keys: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ShardResult:
    """The outcome of a `ShardAttempt`: `info` is None when no frame gave a sample, or when `kept`.

    missing: frames that have to be prepared first; then there is nothing else.
    """

    info: ShardInfo | None
    failures: tuple[Failure, ...]
    kept: bool = False
    missing: tuple[FrameRef, ...] = ()


@dataclass(frozen=True)
class FrameAttempt:
    """One attempt at preparing one frame."""

    ref: FrameRef
    recipe: Recipe
    trace: Path


@dataclass(frozen=True)
class FrameResult:
    """The outcome of a `FrameAttempt`.

    hit, bytes, key: see `sample.Prepared`.
    """

    failure: Failure | None
    hit: bool = False
    bytes: int = 0
    key: str = ""


class Watch:
    """The clock of one attempt, in its worker.

    A C thread of the interpreter: it also ends native code that never returns.
    """

    def __init__(self, trace: int, frame_timeout_s: float) -> None:
        self._trace, self._frame_timeout_s = trace, frame_timeout_s

    @contextmanager
    def watched(self) -> Iterator[None]:
        """End this process, traceback first, when the block outlasts the frame's time limit."""
        # Only a process of its own may be ended from within.
        if multiprocessing.parent_process() is None:
            yield
            return
        faulthandler.dump_traceback_later(self._frame_timeout_s, exit=True, file=self._trace)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()


@contextmanager
def watch(trace: Path, frame_timeout_s: float) -> Iterator[Watch]:
    """The watch of an attempt; `trace` gets the traceback of a crash, or of a frame that is late.

    Where that file cannot be written there is no traceback, and nothing else is lost.
    """
    with open(os.devnull, "w") as nowhere, ExitStack() as files:
        file = nowhere
        with suppress(OSError):
            trace.parent.mkdir(parents=True, exist_ok=True)
            file = files.enter_context(trace.open("a"))
        if multiprocessing.parent_process() is not None:
            faulthandler.enable(file)
            files.callback(faulthandler.disable)
        yield Watch(file.fileno(), frame_timeout_s)


# Built once a process: a preparer holds the renderer and its scene, which are slow to build.
_built: dict[str, tuple[tuple[Any, ...], Any]] = {}


def run_shard(pickled: bytes) -> ShardResult:
    """`make_shard` as a worker calls it: attempt in and errors out survive any transport.

    The attempt comes pickled, so that a source that cannot be imported is an error of this call and
    not the death of a worker that could not unpickle its task.  Errors are raised as plain
    FactoryError or RuntimeError (with the traceback as text), which every process can unpickle.
    """
    return _call_pickled(make_shard, pickled)


def run_frame(pickled: bytes) -> FrameResult:
    """`prepare_frame` as a worker calls it; see `run_shard`."""
    return _call_pickled(prepare_frame, pickled)


def _call_pickled(function: Callable[[Any], T], pickled: bytes) -> T:
    try:
        return function(pickle.loads(pickled))
    except FactoryError as error:
        raise FactoryError(_one_line(str(error))) from None
    except Exception:
        raise RuntimeError(traceback.format_exc()) from None


def prepare_frame(attempt: FrameAttempt) -> FrameResult:
    """Prepare the attempt's frame, or say why it cannot be.

    Raises FactoryError for what no other frame can do better: a missing renderer, a full disk.
    """
    recipe, ref = attempt.recipe, attempt.ref
    assert recipe.preparer is not None
    with watch(attempt.trace, recipe.frame_timeout_s) as clock:
        with clock.watched():
            preparer: Preparer = _build(recipe.preparer, recipe)
        tell(START, 0)
        try:
            with clock.watched():
                made = preparer.prepare(ref)
            return FrameResult(None, made.hit, made.bytes, made.key)
        except FrameError as error:
            return FrameResult(Failure(ref, "frame", _one_line(str(error)), ""))
        except FactoryError:
            raise
        except Exception as error:
            return FrameResult(Failure(ref, "error", _defect(ref, error), ""))


def make_shard(attempt: ShardAttempt) -> ShardResult:
    """Make the attempt's shard; a frame that fails is recorded and the rest goes on.

    Raises FactoryError for what no other frame can do better: a missing renderer, a full disk.
    """
    with ExitStack() as here:
        attempt = _at_hand(attempt, here)
        recipe = attempt.recipe
        clock = here.enter_context(watch(attempt.trace, recipe.frame_timeout_s))
        with clock.watched():
            source: PairSource = _build(recipe.source, recipe)
            source.expect(attempt.keys)
            preparer = None
            if recipe.apart and recipe.preparer:
                preparer = _build(recipe.preparer, recipe)
            frames = _Frames(attempt, source, clock, source.axes(), source.columns(), preparer)
        lacking = [
            item for item in enumerate(attempt.task.items) if item[1][0].name in attempt.lacking
        ]
        try:
            return _made(attempt, source, frames, lacking)
        except NotRendered as error:
            gone = tuple(ref for ref, _ in attempt.task.items if ref.name == error.frame)
            return ShardResult(None, (), missing=gone)


def _at_hand(attempt: ShardAttempt, here: ExitStack) -> ShardAttempt:
    """The attempt as this process can work on it: who shares no folder has one of its own."""
    publication = attempt.recipe.publication
    if publication is None or not attempt.recipe.apart:
        here.enter_context(fenced(attempt.recipe.fence))
        here.enter_context(outlet(publication))
        return attempt
    publication = here.enter_context(apart_copy(publication))
    recipe = replace(attempt.recipe, directory=publication.folder, publication=publication)
    return replace(attempt, recipe=recipe, trace=publication.folder / attempt.trace.name)


def _made(
    attempt: ShardAttempt,
    source: PairSource,
    frames: _Frames,
    lacking: list[tuple[int, FrameVariants]],
) -> ShardResult:
    recipe = attempt.recipe
    given_up = {failure.ref.name for failure in attempt.given_up}

    def missing(items: Iterable[FrameVariants]) -> ShardResult | None:
        if frames.prepares:
            return None
        gone = [ref for ref, _ in items if ref.name not in given_up and not source.ready(ref)]
        return ShardResult(None, (), missing=tuple(gone)) if gone else None

    if lacking:
        if result := missing(item for _, item in lacking):
            return result
        failures = [frames.attempt(index, item)[1] for index, item in lacking]
        if all(failures):
            return ShardResult(None, tuple(f for f in failures if f), kept=True)
    if result := missing(attempt.task.items):
        return result
    info = write_shard(
        recipe.directory,
        attempt.task.path,
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
            plan=attempt.task.digest,
            failed=failed,
            config_hash=recipe.provenance.config_hash,
        )
    return ShardResult(info, tuple(frames.failures))


def _build(maker: Callable[[Any], T], recipe: Recipe) -> T:
    """The source or preparer of this process, built at its first task."""
    key = (maker, recipe.provenance.config_hash, recipe.config)
    name = f"{maker.__module__}.{maker.__qualname__}"
    if name not in _built or _built[name][0] != key:
        _built.pop(name, None)
        _built[name] = (key, maker(recipe.config))
    made: T = _built[name][1]
    return made


class _Frames:
    """Goes through the frames of one attempt and tells of each."""

    def __init__(
        self,
        attempt: ShardAttempt,
        source: PairSource,
        clock: Watch,
        axes: tuple[Axis, Axis],
        columns: tuple[Column, ...],
        preparer: Preparer | None = None,
    ) -> None:
        self._preparer = preparer
        self.axes, self.columns = axes, columns
        self.failures: list[Failure] = []
        self._attempt, self._source, self._clock = attempt, source, clock
        self._given_up = {failure.ref.name: failure for failure in attempt.given_up}

    @property
    def prepares(self) -> bool:
        """Whether what a frame needs is made here, too."""
        return self._preparer is not None

    def pairs(self) -> Iterator[Pair]:
        """The pairs of all frames in order; frames without go to `failures`."""
        for index, item in enumerate(self._attempt.task.items):
            pairs, failure = self.attempt(index, item)
            if failure:
                self.failures.append(failure)
                tell(FAILED, index)
            else:
                tell(DONE, len(pairs))
            yield from pairs

    def attempt(self, index: int, item: FrameVariants) -> tuple[list[Pair], Failure | None]:
        """The checked pairs of one frame, or what kept it from giving them."""
        ref, variants = item
        if ref.name in self._given_up:
            return [], self._given_up[ref.name]
        tell(START, index)
        try:
            if self._preparer is not None:
                with self._clock.watched():
                    self._preparer.prepare(ref)
            with self._clock.watched():
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
        return Failure(ref, kind, _one_line(reason), self._attempt.task.path)


def _defect(ref: FrameRef, error: Exception) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    return _one_line(f"{ref.name}: {type(error).__name__}: {error} ({place})")


def _one_line(text: str) -> str:
    return " ".join(text.split())
