"""What a worker process does: make one shard, frame by frame, or prepare one frame."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from ...common.errors import FactoryError, FrameError, NotRendered
from ...common.files import forward_writes, real_path
from ...common.workers import tell
from ...dataset.frame_ref import FrameRef
from ...dataset.manifest import Failure, ShardInfo
from ...dataset.schema import Pair, PairSource, Prepared, Preparer, check_pair
from ...dataset.writer import write_shard
from .plan import FrameVariants, Recipe, ShardTask

T = TypeVar("T")


@dataclass(eq=False)
class ShardAttempt:
    """A shard to make.

    lacking: frames that the finished shard on disk lacks.  While all of them still fail, that
        shard is good as it is and kept.
    given_up: of frames that are not to be tried again, by their names.
    keys: of frames that were prepared for it, by their names; see `schema.Prepared`.
    """

    task: ShardTask
    recipe: Recipe
    lacking: tuple[str, ...] = ()
    given_up: dict[str, Failure] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ShardResult:
    """The outcome of a `ShardAttempt`: `info` is None without any sample, or when `keeps_file`."""

    info: ShardInfo | None
    failures: tuple[Failure, ...]
    keeps_file: bool = False


# Built once a process: a preparer holds the renderer and its scene, which are slow to build.
_built: dict[Callable[[Any], Any], tuple[tuple[str, Any], Any]] = {}


def prepare_frame(attempt: tuple[FrameRef, Recipe]) -> Prepared | Failure:
    """Prepare a frame, or say why it cannot be.

    Raises FactoryError for what no other frame can do better: a missing renderer, a full disk.
    """
    ref, recipe = attempt
    assert recipe.preparer is not None
    preparer: Preparer = _build(recipe.preparer, recipe)
    tell(0, 0, 0)
    try:
        return preparer.prepare(ref)
    except Exception as error:
        return _failure(ref, error, "")


def make_shard(attempt: ShardAttempt) -> ShardResult:
    """Make the attempt's shard; a frame that fails is recorded and the rest goes on.

    It tells (number of the frame in hand or None, samples made, frames failed) as it goes.
    Raises FactoryError for what no other frame can do better: a missing renderer, a full disk.
    """
    recipe = attempt.recipe
    with ExitStack() as resources:
        if (publication := recipe.publication) is not None:
            if publication.is_remote:  # who shares no folder has one of its own
                folder = resources.enter_context(TemporaryDirectory(prefix="simnfnd-shard-"))
                publication = replace(publication, folder=real_path(Path(folder)))
            recipe = replace(recipe, directory=publication.folder)
            resources.enter_context(forward_writes(publication.folder, publication.forward))
        return _Shard(attempt, recipe).result()


def _build(maker: Callable[[Any], T], recipe: Recipe) -> T:
    """The source or preparer of this process, built at its first task."""
    key = recipe.provenance.config_hash, recipe.config
    if maker not in _built or _built[maker][0] != key:
        _built.pop(maker, None)
        _built[maker] = key, maker(recipe.config)
    built: T = _built[maker][1]
    return built


class _Shard:
    """Goes through the frames of one attempt and tells of each."""

    def __init__(self, attempt: ShardAttempt, recipe: Recipe) -> None:
        self._attempt = attempt
        self._task = attempt.task
        self._recipe = recipe
        self._source: PairSource = _build(recipe.source, recipe)
        self._source.set_cache_keys(attempt.keys)
        self._keys = dict(attempt.keys)
        self._axes = self._source.axes()
        self._columns = self._source.columns()
        self._samples = 0
        self._failures: list[Failure] = []

    def result(self) -> ShardResult:
        """Write the shard, or say why it is not to be written."""
        task = self._task
        recipe = self._recipe
        todo = enumerate(task.items)
        requested = self._attempt.lacking
        lacking = [item for item in todo if item[1][0].name in requested]
        failures = [failure for item in lacking if (failure := self._make_frame(*item)[1])]
        if lacking and len(failures) == len(lacking):
            return ShardResult(None, tuple(failures), keeps_file=True)
        shard_description = self._axes, self._columns, recipe.provenance, recipe.dataset
        info = write_shard(recipe.directory, task.path, self._pairs(), *shard_description)
        if info is not None:
            info = replace(
                info,
                plan=task.digest,
                inputs=task.inputs,
                failed=tuple(failure.ref.name for failure in self._failures),
                config_hash=recipe.provenance.config_hash,
            )
        return ShardResult(info, tuple(self._failures))

    def _pairs(self) -> Iterator[Pair]:
        """The pairs of all frames in order; frames without go to the failures."""
        for index, item in enumerate(self._task.items):
            pairs, failure = self._make_frame(index, item)
            self._failures += [failure] if failure else []
            self._samples += len(pairs)
            tell(None, self._samples, len(self._failures))
            yield from pairs

    def _make_frame(self, index: int, item: FrameVariants) -> tuple[list[Pair], Failure | None]:
        """The checked pairs of one frame, or what kept it from giving them."""
        ref, variants = item
        if ref.name in self._attempt.given_up:
            return [], self._attempt.given_up[ref.name]
        tell(index, self._samples, len(self._failures))
        try:
            try:
                pairs = self._source.pairs(ref, variants)
            except NotRendered:  # not prepared yet, damaged, or evicted from the cache
                if self._recipe.preparer is None:
                    raise
                preparer: Preparer = _build(self._recipe.preparer, self._recipe)
                self._keys[ref.name] = preparer.prepare(ref).key
                self._source.set_cache_keys(self._keys)
                pairs = self._source.pairs(ref, variants)
            for pair in pairs:
                check_pair(pair, self._axes, self._columns, ref.name)
            return pairs, None
        except Exception as error:
            return [], _failure(ref, error, self._task.path)


def _failure(ref: FrameRef, error: Exception, shard: str) -> Failure:
    """What kept a frame from giving pairs.  Raises what is no matter of one frame.

    A defect of ours in one frame must not cost the others; where it is gets recorded.
    """
    if isinstance(error, FrameError):
        return Failure(ref, "frame", " ".join(str(error).split()), shard)
    if isinstance(error, FactoryError):
        raise error
    last = traceback.extract_tb(error.__traceback__)[-1]
    line = f"{Path(last.filename).name}:{last.lineno}"
    reason = f"{ref.name}: {type(error).__name__}: {error} ({line})"
    return Failure(ref, "error", " ".join(reason.split()), shard)
