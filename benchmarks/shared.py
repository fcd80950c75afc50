"""What the benchmarks share: their options, tables, and clocks for calls and whole commands."""

from __future__ import annotations

import multiprocessing
import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Cell = str | int | float


@dataclass(frozen=True)
class Options:
    """What the user asks of all benchmarks.

    quick: the smallest amounts that still run every line of the code; the figures mean nothing.
    frame: folder of FLSea VI whose first frame is measured beside the procedural one.
    """

    quick: bool = False
    frame: str = ""

    def amount(self, full: int, quick: int = 1) -> int:
        """`full`, or `quick` where only the code is tried."""
        return quick if self.quick else full


@dataclass(frozen=True)
class Table:
    """One table; the report rounds numbers to three digits, the JSON file keeps them whole."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    title: str = ""
    note: str = ""

    def column(self, name: str) -> list[Cell]:
        """All cells below a heading."""
        index = list(self.columns).index(name)
        return [row[index] for row in self.rows]

    def markdown(self) -> str:
        """The table with its title and note."""
        cells = [self.columns, ["---"] * len(self.columns), *self.rows]
        lines = [
            "| " + " | ".join(shown(cell).replace("|", "\\|") for cell in row) + " |"
            for row in cells
        ]
        parts = [f"### {self.title}" if self.title else "", "\n".join(lines), self.note]
        return "\n\n".join(part for part in parts if part)


@dataclass(frozen=True)
class Section:
    """What one benchmark found.  failed: why its outcome is wrong, where it checks one."""

    tables: Sequence[Table] = ()
    failed: str = ""

    def markdown(self, name: str) -> str:
        """The section under its heading."""
        parts = [f"## {name}", *(table.markdown() for table in self.tables)]
        return "\n\n".join([*parts, *([f"**Failed: {self.failed}**"] if self.failed else [])])


def shown(cell: Cell) -> str:
    """A cell as people read it: three digits of a number that is not whole."""
    if not isinstance(cell, float):
        return str(cell)
    if cell == 0 or 1e-3 <= abs(cell) < 1e6:
        return f"{cell:.0f}" if abs(cell) >= 100 else f"{cell:.3g}"
    return f"{cell:.2g}"


def cpu_seconds(action: Callable[[], Any], repeats: int) -> float:
    """Median CPU time of `action`, all threads, after one run that is not counted."""
    action()
    spent = []
    for _ in range(repeats):
        began = time.process_time()
        action()
        spent.append(time.process_time() - began)
    return statistics.median(spent)


def in_own_process(function: Callable[..., T], *arguments: object) -> T:
    """Call an importable function in a fresh process: no memory, cache or thread of another."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn) as pool:
        return pool.submit(function, *arguments).result()


@dataclass(frozen=True)
class Command:
    """Wall and CPU seconds of a whole command, with its children."""

    wall: float
    cpu: float


def run_command(*words: str, cwd: Path | None = None) -> Command:
    """Run `python -m simnfnd WORDS`; a failure ends the benchmark with what it printed last."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = time.monotonic()
    command = [sys.executable, "-m", "simnfnd", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}\n{done.stderr[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Command(time.monotonic() - began, cpu)


def frame_words(root: str) -> list[str]:
    """Settings for the procedural frame, or with `root` for the first frame of FLSea VI there."""
    if not root:
        return ["scenes=seabed", "scenes.locations=1", "scenes.frames_per_location=1"]
    return ["scenes=flsea", f"scenes.root={root}"]


@contextmanager
def quiet() -> Iterator[None]:
    """Send what Blender prints on the C level nowhere; the report is on stdout."""
    sys.stdout.flush()
    keep = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(keep, 1)
        os.close(keep)
