"""The attack: kills and stops while datasets are made, flipped bits, forged files, bombs, damage.

Every row of the table says what was done, how often, and what went wrong; 0 is expected.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
from scipy.io import savemat

from benchmarks.shared import Options, Section, Table, in_own_process
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.isolated import IsolatedProcess
from simnfnd.factory.dataset.manifest import INDEX_NAME, MANIFEST_NAME
from simnfnd.factory.dataset.validate import validate
from tests.factory.dataset import flips, hostile
from tests.models.recordings.mutations import mutated, use
from tests.models.recordings.recording_files import write_black_png
from tests.models.recordings.test_hostile_recordings import WRITERS
from tests.worker_processes import workers_of

HUNG_S = 60.0
_MOST_BYTES = 1_500_000_000  # that a command may hold while it refuses a bomb
_ACTS = ("kill worker", "stop worker", "kill run", "end run")
_TINY = (
    "scenes=seabed", "scenes.locations=2", "scenes.frames_per_location=12", "scenes.width=120",
    "scenes.height=80", "render=analytic", "sonar.beams=64", "sonar.range_bins=64",
    "sonar.image.width_px=64", "sonar.image.height_px=64", "scheduler.shard_size=2",
    "scheduler.frame_timeout_s=5", "dataset.preview_pairs=0", "cache.enabled=true",
)  # fmt: skip


@dataclass
class Tally:
    """done: how often.  wrong: what went wrong, one line each.  note: figures beside them."""

    done: int = 0
    wrong: list[str] = field(default_factory=list)
    note: str = ""

    def must(self, holds: bool, problem: str) -> None:
        """Count what went wrong."""
        if not holds:
            self.wrong.append(problem)


def measure(options: Options) -> Section:
    """A row for each kind of attack."""
    amount = options.amount
    rows = list[tuple[str, Tally]]()
    with tempfile.TemporaryDirectory(prefix="trust-") as folder:
        root = Path(folder)
        for workers in (2, 48):
            name = f"rounds of kills and stops, {workers} workers, no renders cached"
            rows.append((name, storms(root / f"storm-{workers}", workers, amount(8))))
        rows.append(("bits flipped in shards", flipped(root / "flips", amount(1600, 20))))
        for file, count in ((INDEX_NAME, 200), (MANIFEST_NAME, 200)):
            tally = flipped_file(root / f"flips-{file}", file, amount(count, 5))
            rows.append((f"bits flipped in {file}", tally))
        rows.append(("forged and damaged datasets", forged(root / "forged", amount(300, 10))))
        rows.append(("bombs, by simnfnd denoise", bombs(root / "bombs")))
        for name in WRITERS:
            tally = in_own_process(damaged, root / f"damaged-{name}", name, amount(300, 10))
            rows.append((f"damaged {name}", tally))
    table = Table(
        ("attack", "times", "went wrong", "beside"),
        [(name, tally.done, len(tally.wrong), tally.note) for name, tally in rows],
    )
    wrong = [f"{name}: {line}" for name, tally in rows for line in tally.wrong]
    return Section((table,), "; ".join(wrong[:20]))


def storms(folder: Path, workers: int, rounds: int) -> Tally:
    """Make a dataset again and again under fire; its bytes must be those of a quiet run."""
    tally = Tally()
    acts = 0
    longest = 0.0
    quiet = folder / "quiet"
    _finish(_start(quiet, folder / "quiet-cache", 1), tally, "quiet")
    expected = _hashes(quiet)
    tally.must(len(expected) > 10, "the quiet run made too little")
    chance = random.Random(workers)
    for number in range(rounds):
        dataset = folder / f"made-{number}"
        cache = folder / f"cache-{number}"
        for _ in range(4):
            run = _start(dataset, cache, workers)
            acts += _fire(run, chance)
            begun = time.monotonic()
            _finish(run, tally, f"round {number}")
            longest = max(longest, time.monotonic() - begun)
        last = _start(dataset, cache, workers)
        _finish(last, tally, f"round {number}")
        tally.must(last.returncode == 0, f"round {number}: exit code {last.returncode}")
        tally.must(_hashes(dataset) == expected, f"round {number}: lost or other shards")
        left = [
            process.pid
            for process in psutil.process_iter(["cmdline"])
            if _belongs(process, dataset)
        ]
        tally.must(not left, f"round {number}: processes left: {left}")
        tally.done += 1
        shutil.rmtree(dataset)
        shutil.rmtree(cache)
    tally.note = f"{acts} kills and stops; at most {longest:.0f} s from one to the end of its run"
    return tally


def _start(dataset: Path, cache: Path, workers: int) -> subprocess.Popen[bytes]:
    words = [*_TINY, f"dataset.dir={dataset}", f"cache.dir={cache}", f"scheduler.workers={workers}"]
    if workers == 1:
        words.append("scheduler=serial")
    dataset.parent.mkdir(parents=True, exist_ok=True)
    with (dataset.parent / "errors.txt").open("ab") as errors:
        return subprocess.Popen(
            [sys.executable, "-m", "simnfnd", "make", *words],
            stdout=errors, stderr=errors, start_new_session=True,
        )  # fmt: skip


def _fire(run: subprocess.Popen[bytes], chance: random.Random) -> int:
    """Some kills and stops of a run or its workers; returns how many."""
    acts = 0
    for _ in range(chance.randint(1, 4)):
        time.sleep(chance.uniform(0.5, 3.0))
        if run.poll() is not None:
            break
        act = chance.choice(_ACTS)
        workers = workers_of(run.pid)
        try:
            if act == "kill run":
                os.killpg(run.pid, signal.SIGKILL)
            elif act == "end run":
                run.send_signal(signal.SIGTERM)
            elif workers:
                chosen = chance.choice(workers)
                chosen.send_signal(signal.SIGKILL if act == "kill worker" else signal.SIGSTOP)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
        acts += 1
    return acts


def _finish(run: subprocess.Popen[bytes], tally: Tally, label: str) -> None:
    """Wait for a run; one that takes more than a minute more hangs."""
    try:
        run.wait(HUNG_S)
    except subprocess.TimeoutExpired:
        tally.must(False, f"{label}: hangs")
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()


def _belongs(process: psutil.Process, dataset: Path) -> bool:
    words = process.info["cmdline"] or []
    return any(str(dataset) in word for word in words)


def _hashes(dataset: Path) -> dict[str, str]:
    """Shard -> hash of its bytes."""
    return {
        path.relative_to(dataset).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(dataset.glob("*/shard-*.h5"))
    }


def flipped(folder: Path, times: int) -> Tally:
    """Single bits of shards; a reader gives the same images or refuses."""
    folder.mkdir()
    root = hostile.whole(folder / "sound")
    tally = Tally()
    rng = np.random.default_rng(1)
    sound = flips.given_out(root)
    refused = 0
    shards = sorted(root.glob("train/*.h5"))
    for _ in range(times):
        path = shards[rng.integers(len(shards))]
        place, bit = flips.any_bit(path, rng)
        flips.flip(path, place, bit)
        outcome = flips.outcome(root, sound)
        flips.flip(path, place, bit)
        refused += outcome == "refused"
        tally.must(outcome in ("same", "refused"), f"{path.name} {place}.{bit}: {outcome}")
        tally.done += 1
    tally.note = f"{refused} refused, the rest changed nothing"
    return tally


def flipped_file(folder: Path, name: str, times: int) -> Tally:
    """Single bits of the index or manifest; `validate` finds them, or they change nothing."""
    folder.mkdir()
    root = hostile.whole(folder / "sound")
    tally = Tally()
    rng = np.random.default_rng(2)
    sound = flips.given_out(root)
    detected = 0
    for _ in range(times):
        place, bit = flips.any_bit(root / name, rng)
        flips.flip(root / name, place, bit)
        try:
            valid = not validate(root).errors
        except FactoryError:
            valid = False
        if valid and name == INDEX_NAME:
            tally.wrong.append(f"{name} {place}.{bit}: valid")
        elif valid:
            read = flips.outcome(root, sound)
            tally.must(read in ("same", "refused"), f"{name} {place}.{bit}: {read}")
        detected += not valid
        flips.flip(root / name, place, bit)
        tally.done += 1
    tally.note = f"{detected} found by validate"
    return tally


def forged(folder: Path, times: int) -> Tally:
    """Datasets forged with true checksums, or damaged: a clear answer, no file outside of them."""
    folder.mkdir()
    sound = hostile.whole(folder / "sound")
    tally = Tally()
    readable = 0
    reader = IsolatedProcess()
    for number in range(times):
        root = hostile.copy(sound, folder / "forged")
        mutation = hostile.mutate(root, number)
        begun = time.monotonic()
        try:
            read, _ = hostile.check(root, reader)
            readable += read == "read"
        except Exception as error:
            tally.must(False, f"{mutation}: {type(error).__name__} {error}"[:200])
        tally.must(time.monotonic() - begun < HUNG_S, f"{mutation}: hangs")
        tally.done += 1
    tally.note = f"{readable} still readable"
    return tally


def bombs(folder: Path) -> Tally:
    """Small files that unpack to gigabytes: one line, exit code not 0, little memory."""
    folder.mkdir()
    tally = Tally()
    most = 0
    for name, write in _BOMBS.items():
        path = folder / name
        in_own_process(write, path)  # the memory of who starts a command counts as the command's
        code, said, peak = _refused("denoise", str(path), "--out", str(folder / "out"))
        most = max(most, peak)
        lines = [line for line in said.splitlines() if line.startswith("error:")]
        tally.must(code not in (0, -9) and "Traceback" not in said, f"{name}: exit {code}")
        tally.must(len(lines) == 1 and name in lines[0], f"{name}: said {said[-160:]!r}")
        tally.must(peak < _MOST_BYTES, f"{name}: {peak / 1e9:.1f} GB")
        tally.done += 1
    tally.note = f"at most {most / 1e6:.0f} MB of memory"
    return tally


def _refused(*words: str) -> tuple[int, str, int]:
    """Exit code, what was said on stderr, and the most memory of a command, bytes."""
    with tempfile.TemporaryFile() as said:
        run = subprocess.Popen(
            [sys.executable, "-m", "simnfnd", *words], stdout=subprocess.DEVNULL, stderr=said
        )
        _, status, usage = os.wait4(run.pid, 0)
        run.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        return run.returncode, said.read().decode(), usage.ru_maxrss * 1024


def _png(path: Path) -> None:
    write_black_png(path, 40_000)


def _npz(path: Path) -> None:
    np.savez_compressed(path, image=np.zeros((2, 24_000, 24_000), np.uint8))


def _npz_aside(path: Path) -> None:
    large = np.zeros((2, 24_000, 24_000), np.uint8)
    np.savez_compressed(path, image=np.zeros((64, 64), np.uint8), large=large)


def _mat(path: Path) -> None:
    savemat(path, {"image": np.zeros((24_000, 48_000), np.uint8)}, do_compression=True)


def _tiff(path: Path) -> None:
    page = np.zeros((8000, 8000), np.uint16)
    assert cv2.imwritemulti(str(path), [page] * 10, (cv2.IMWRITE_TIFF_COMPRESSION, 8))


def _npy(path: Path) -> None:
    with path.open("wb") as file:
        write: Any = np.lib.format.write_array_header_1_0
        write(file, {"descr": "<f4", "fortran_order": False, "shape": (200_000, 100_000)})
        file.truncate(4096)


def _h5(path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        storage: Any = {"chunks": (1, 3000, 30_000), "compression": "gzip", "fillvalue": 7}
        for name in ("noisy", "clean"):
            file.create_dataset(name, (4, 30_000, 30_000), "u1", **storage)
        file.attrs["schema"] = "simnfnd/1"
        file.attrs["config"] = json.dumps({})


_BOMBS: dict[str, Callable[[Path], None]] = {
    "a.png": _png, "a.npz": _npz, "b.npz": _npz_aside, "a.mat": _mat, "a.tif": _tiff,
    "a.npy": _npy, "a.h5": _h5,
}  # fmt: skip


def damaged(folder: Path, name: str, times: int) -> Tally:
    """A recording with bits, words and pieces changed: read, or refused in one line."""
    folder.mkdir(exist_ok=True)
    tally = Tally()
    refused = 0
    rng = np.random.default_rng(300)
    path = WRITERS[name](folder / name)
    sound = path.read_bytes()
    before = _peak()
    for number in range(times):
        path.write_bytes(mutated(sound, rng))
        begun = time.monotonic()
        try:
            use(path, again=number % 10 == 0)
        except FactoryError as error:
            refused += 1
            tally.must("\n" not in str(error) and str(path) in str(error), f"{number}: {error}")
        except Exception as error:
            tally.must(False, f"{number}: {type(error).__name__} {error}"[:160])
        tally.must(time.monotonic() - begun < HUNG_S, f"{number}: hangs")
        tally.done += 1
    tally.must(_peak() - before < 500e6, f"takes {(_peak() - before) / 1e6:.0f} MB")
    tally.note = f"{refused} refused, the rest read"
    return tally


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
