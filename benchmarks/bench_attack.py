"""Attacks on those who open a stranger's dataset: flipped bits, forged files, bombs and hangs.

Counted are survivors: a picture, mask or piece of metadata that is another than the sound one and
was given out, a command that was run, a file that was written elsewhere, gigabytes, a hang.
"""

from __future__ import annotations

import json
import multiprocessing
import resource
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from unittest import mock

import h5py
import numpy as np

from benchmarks.bombs import BOMBS, PASSED_OVER
from benchmarks.report import Cell, Options, Section, Table
from simnfnd.factory.commands import failed
from simnfnd.factory.dataset.read import reader
from simnfnd.factory.dataset.read.isolated import IsolatedProcess
from simnfnd.factory.errors import FactoryError
from tests.factory.dataset.flips import LAYERS, any_bit, flip, given_out, outcome
from tests.factory.dataset.hostile import OBJECTS, LastingProcess, admit, reseal, whole
from tests.factory.dataset.test_untrusted import ATTRIBUTES, READERS

SHARD = "train/shard-00000.h5"
FLIPS = 2000
MOST_MB, MOST_S = 1000.0, 30.0


def measure(options: Options) -> Section:
    """All attacks; the section fails when one survives."""
    flips, wrong = _flips(options.amount(FLIPS, 4))
    forged, harm = _forged(options.amount(10**6, 2))
    bombs, beyond = _bombs(options.amount(len(BOMBS), 1))
    return Section((flips, forged, bombs), failed="; ".join([*wrong, *harm, *beyond])[:2000])


def _flips(count: int) -> tuple[Table, list[str]]:
    """Single bits over all of a shard: half gzip, half plain chunks."""
    counts: dict[str, Counter[str]] = {"h5py alone": Counter()}
    wrong: list[str] = []
    with tempfile.TemporaryDirectory() as name, IsolatedProcess() as process:
        for seed, compression in enumerate(("gzip", "none")):
            root = whole(Path(name) / compression, compression=compression)
            path = root / SHARD
            content, right = path.read_bytes(), given_out(root)
            alone = process.call(_by_h5py, path, limit_s=60.0)
            rng = np.random.default_rng(seed)
            for _ in range(count // 2):
                place, bit = any_bit(path, rng)
                flip(path, place, bit)
                counts["h5py alone"][_alone(process, path, alone)] += 1
                for verify in ("checksums", "hash"):
                    said = process.call(outcome, root, right, verify, limit_s=MOST_S)
                    kind = said if said in ("same", "refused") else "another"
                    counts.setdefault(f"PairDataset, verify={verify}", Counter())[kind] += 1
                    if kind == "another":
                        wrong.append(f"bit {bit} of byte {place} of {compression}: {said}")
                path.write_bytes(content)
    kinds = ("refused", "same", "another")
    rows = tuple(
        (who, found["refused"], found["same"], found["another"]) for who, found in counts.items()
    )
    title = f"{count} single bits flipped, one at a time, anywhere in a shard"
    note = "Another: a picture, mask, table, axis or text that is not the sound one was given out."
    return Table(("reader", *kinds), rows, title, note), wrong


def _by_h5py(path: Path) -> dict[str, bytes]:
    """What h5py gives of a shard without any check of ours."""
    with h5py.File(path, "r") as file:
        found = {name: file[name][()].tobytes() for name in (*LAYERS, "meta")}
        found |= {f"axis {name}": file["axes"][name][()].tobytes() for name in file["axes"]}
        for name in ("/", *LAYERS, "meta"):
            told = {k: v for k, v in file[name].attrs.items() if k != "DIMENSION_LIST"}
            found[f"attributes {name}"] = repr(sorted(told.items(), key=lambda x: x[0])).encode()
    return found


def _alone(process: IsolatedProcess, path: Path, right: dict[str, bytes]) -> str:
    try:
        return "same" if process.call(_by_h5py, path, limit_s=5.0) == right else "another"
    except (FactoryError, RuntimeError):  # also a crash or a hang of the library
        return "refused"


def _forged(most: int) -> tuple[Table, list[str]]:
    """Files that were changed on purpose and sealed again, through everything that opens one."""
    rows: list[tuple[Cell, ...]] = []
    harm: list[str] = []
    kinds: dict[str, Callable[[h5py.File, Path], Any]] = {
        **{name: partial(_by_attribute, action) for name, (action, _) in ATTRIBUTES.items()},
        **{name: partial(_by_object, action) for name, action in OBJECTS.items()},
    }
    del kinds["swapped names"]  # a sound shard with its pictures exchanged
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        base = Path(name).resolve()
        sound = whole(base / "sound")
        with mock.patch.multiple(reader, IsolatedProcess=LastingProcess, _LIMIT_S=5.0):
            for kind, action in list(kinds.items())[:most]:
                root = Path(shutil.copytree(sound, base / "forged"))
                with h5py.File(root / SHARD, "r+") as file:
                    action(file, base / "secret.h5")
                    _try_to_seal(file)
                admit(root)
                before = sorted(base.rglob("*"))
                for verb, open_it in READERS.items():
                    said = "read"
                    try:
                        if verb not in ("inspect a file",):
                            open_it(root)
                    except FactoryError as error:
                        said = "refused" if "\n" not in str(error) else "no line"
                    counts[said] += 1
                    if said == "no line":
                        harm.append(f"{kind}, {verb}: more than a line")
                shutil.rmtree(base / "out", ignore_errors=True)
                if new := set(base.rglob("*")) - set(before) - {base / "sheet.png"}:
                    harm.append(f"{kind}: wrote {sorted(new)[0]}")
                shutil.rmtree(root)
        rows.append(("shards forged and sealed again, by every reader", *_of(counts), 0))
        ran = _commands_run(base)
        rows.append(("failed --rerun with forged commands", 0, 0, ran))
        if ran:
            harm.append(f"{ran} commands of a dataset were run")
    columns = ("attack", "refused", "read", "commands run or files outside")
    return Table(columns, tuple(rows), "Forged files"), harm


def _by_attribute(action: Callable[[h5py.File], Any], file: h5py.File, _: Path) -> None:
    action(file)


def _by_object(
    action: Callable[[h5py.File, str, Path], Any], file: h5py.File, secret: Path
) -> None:
    action(file, "noisy", secret)


def _of(counts: Counter[str]) -> tuple[int, int]:
    return counts["refused"] + counts["no line"], counts["read"]


def _try_to_seal(file: h5py.File) -> None:
    """As who knows the checksums would, where what is left of the file allows it."""
    try:
        reseal(file)
    except Exception:
        for name in ("checksum", "text_checksum"):
            file.attrs.pop(name, None)
        if "checksums" in file:
            del file["checksums"]


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
                failed.main(words)
        ran += mark.exists()
    return ran


def _bombs(most: int) -> tuple[Table, list[str]]:
    """Each in a process of its own, whose memory and time are looked at."""
    rows: list[tuple[Cell, ...]] = []
    beyond: list[str] = []
    context = multiprocessing.get_context("fork")
    for name in list(BOMBS)[:most]:
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder) / "root"
            maker = context.Process(target=_make, args=(name, root))
            maker.start()
            maker.join()
            size = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
            ours, theirs = context.Pipe()
            child = context.Process(target=_open, args=(name, root, theirs))
            child.start()
            theirs.close()
            try:
                said, seconds, peak_mb = ours.recv()
            except EOFError:
                said, seconds, peak_mb = f"ended by signal {-(child.exitcode or 0)}", MOST_S, 0.0
            child.join()
        print(f"{name}: {seconds:.1f} s, {peak_mb:.0f} MB, {said[:90]}", flush=True)
        rows.append((name, size / 1e6, seconds, peak_mb, said[:90]))
        good = said.startswith("refused") or (name in PASSED_OVER and said == "read")
        if not good or seconds > MOST_S or peak_mb > MOST_MB:
            beyond.append(f"{name}: {said[:90]}, {seconds:.1f} s, {peak_mb:.0f} MB")
    columns = ("file", "MB on disk", "s", "peak MB", "answer")
    note = "Peak resident memory of the process and of the one that looks first, with all imports."
    return Table(columns, tuple(rows), "Bombs and hangs", note), beyond


def _make(name: str, root: Path) -> None:
    BOMBS[name][0](root)


def _open(name: str, root: Path, answers: Connection) -> None:
    signal.alarm(int(4 * MOST_S))
    begun = time.perf_counter()
    try:
        BOMBS[name][1](root)
        said = "read"
    except (FactoryError, ValueError) as error:
        said = f"refused: {str(error).replace(str(root), '')}"
    except BaseException as error:
        said = f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - begun
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    answers.send((said, seconds, max(usage.ru_maxrss for usage in usages) * 1024 / 1e6))
