"""Work that may hang or take all memory: each piece in a new process, timed and weighed."""

from __future__ import annotations

import multiprocessing
import resource
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from typing import Any

from simnfnd.factory.errors import FactoryError


@dataclass(frozen=True)
class Answer:
    """What came of one piece.

    result: what the function returned; None where it raised, died or was ended.
    said: `done`, `refused: ...` for an error of one line, or how else it ended.
    peak_mb: the most resident memory of the process or of one that it started, imports included.
    """

    result: Any = None
    said: str = "done"
    seconds: float = 0.0
    peak_mb: float = 0.0


@dataclass
class _Running:
    process: Any
    answers: Connection
    begun: float = field(default_factory=time.perf_counter)


def answers(
    function: Callable[..., Any],
    pieces: Mapping[str, tuple[Any, ...]],
    limit_s: float,
    at_once: int = 1,
) -> Iterator[tuple[str, Answer]]:
    """Call an importable function with the arguments of every piece; as they end.

    limit_s: a process that takes longer is ended.
    """
    # A new process takes its imports from one that has them already, and nothing else.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([function.__module__])
    left = dict(pieces)
    running: dict[str, _Running] = {}
    while left or running:
        while left and len(running) < at_once:
            name = next(iter(left))
            ours, theirs = context.Pipe(duplex=False)
            process = context.Process(target=_work, args=(theirs, function, left.pop(name)))
            process.start()
            theirs.close()
            running[name] = _Running(process, ours)
        ready = wait([each.answers for each in running.values()], timeout=0.5)
        for name, each in list(running.items()):
            took_s = time.perf_counter() - each.begun
            if each.answers in ready:
                answer = _received(each, took_s)
            elif took_s > limit_s:
                each.process.kill()
                answer = Answer(None, f"not ended after {limit_s:g} s", took_s)
            else:
                continue
            each.process.join()
            each.answers.close()
            del running[name]
            yield name, answer


def _received(each: _Running, took_s: float) -> Answer:
    try:
        answer: Answer = each.answers.recv()
    except EOFError:
        each.process.join()
        return Answer(None, f"ended with exit code {each.process.exitcode}", took_s)
    return answer


def _work(theirs: Connection, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    begun, result, said = time.perf_counter(), None, "done"
    try:
        result = function(*arguments)
    except (FactoryError, ValueError) as error:
        said = f"refused: {error}"
    except BaseException as error:
        said = f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - begun
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    peak_mb = max(usage.ru_maxrss for usage in usages) * 1024 / 1e6
    theirs.send(Answer(result, said, seconds, peak_mb))
