"""Attacks on those who open a stranger's dataset: flipped bits, forged files, bombs and hangs.

Counted are survivors: a picture, mask or piece of metadata that is another than the sound one and
was given out, a command that was run, a file that was written elsewhere, gigabytes, a hang.
"""

from __future__ import annotations

import json
import tempfile
from contextlib import suppress
from pathlib import Path

from benchmarks.report import Cell, Options, Section, Table
from benchmarks.trust.bombs import BOMBS, PASSED_OVER
from benchmarks.trust.flips import SHARD, flipped
from benchmarks.trust.forged import forged
from benchmarks.trust.guarded import answers
from simnfnd.factory.commands import status
from simnfnd.factory.errors import FactoryError
from tests.factory.dataset.hostile import whole

FLIPS = 2000
MOST_MB, MOST_S = 1000.0, 30.0


def measure(options: Options) -> Section:
    """All attacks; the section fails when one survives."""
    flips, wrong = flipped(options.amount(FLIPS, 4))
    shards, harm = _forged(options.amount(10**6, 2))
    bombs, beyond = _bombs(options.amount(len(BOMBS), 1))
    return Section((flips, shards, bombs), failed="; ".join([*wrong, *harm, *beyond])[:2000])


def _forged(most: int) -> tuple[Table, list[str]]:
    """Forged shards through everything that opens one, and commands that a dataset brings."""
    shards, harm = forged(most)
    with tempfile.TemporaryDirectory() as name:
        ran = _commands_run(Path(name).resolve())
    if ran:
        harm.append(f"{ran} commands of a dataset were run")
    rows: tuple[tuple[Cell, ...], ...] = (
        ("shards forged and sealed again, by every reader", *shards),
        ("failed --rerun with forged commands", 4, 4 - ran, 0, ran, 0.0, 0.0),
    )
    columns = ("attack", "files", "refused", "read", "harm", "slowest s", "peak MB")
    note = "Refused, read and harm count readers: each is asked about every file."
    return Table(columns, rows, "Forged files", note), harm


def _commands_run(base: Path) -> int:
    """How many commands of a forged failed.jsonl leave their mark."""
    root, mark = whole(base / "rerun"), base / "mark"
    commands = [
        f"touch {mark}",
        f'python -c \'open("{mark}", "w")\'',
        f"simnfnd make hydra.run.dir={mark}",
        f"-c 'import os; os.mkdir(\"{mark}\")'",
    ]
    ran = 0
    for command in commands:
        line = {"frame": "a/b/c", "shard": SHARD, "kind": "error", "reason": "x"}
        (root / "failed.jsonl").write_text(json.dumps({**line, "command": command}) + "\n")
        for words in ([str(root)], [str(root), "--rerun"]):
            with suppress(FactoryError):
                status.main(words)
        ran += mark.exists()
    return ran


def _bombs(most: int) -> tuple[Table, list[str]]:
    """Each in a process of its own, whose memory and time are looked at."""
    rows: list[tuple[Cell, ...]] = []
    beyond: list[str] = []
    for name in list(BOMBS)[:most]:
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder) / "root"
            (_, made), *_ = answers(_make, {name: (name, root)}, 10 * MOST_S)
            size = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
            (_, answer), *_ = answers(_open, {name: (name, root)}, 4 * MOST_S)
            said = "read" if answer.said == "done" else answer.said.replace(str(root), "")
            said = said if made.said == "done" else f"not made: {made.said}"
        seconds, peak_mb = answer.seconds, answer.peak_mb
        print(f"{name}: {seconds:.1f} s, {peak_mb:.0f} MB, {said[:90]}", flush=True)
        rows.append((name, size / 1e6, seconds, peak_mb, said[:90]))
        good = said.startswith("refused") or (name in PASSED_OVER and said == "read")
        if not good or seconds > MOST_S or peak_mb > MOST_MB:
            beyond.append(f"{name}: {said[:90]}, {seconds:.1f} s, {peak_mb:.0f} MB")
    columns = ("file", "MB on disk", "s", "peak MB", "answer")
    slowest, largest = (max(rows, key=lambda row: float(row[k])) for k in (2, 3))
    note = (
        "Peak resident memory of the process and of the one that looks first, with all imports. "
        f"Worst: {slowest[2]:.1f} s ({slowest[0]}), {largest[3]:.0f} MB ({largest[0]})."
    )
    return Table(columns, tuple(rows), "Bombs and hangs", note), beyond


def _make(name: str, root: Path) -> None:
    BOMBS[name][0](root)


def _open(name: str, root: Path) -> None:
    BOMBS[name][1](root)
