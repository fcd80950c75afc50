"""A run that everything happens to: its workers are killed at random, the run itself now and then.

`python -m tests.storm DIR BACKEND DELAY_S SHARDS` is the run, with frames that cost
nothing but time, so that the storm is about the scheduler alone; `storm` is what happens to it.
"""

from __future__ import annotations

import random
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from simnfnd.factory.dataset.format.schema import Provenance, config_hash
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.failures import load_failures
from simnfnd.factory.scheduler.job import Job
from simnfnd.factory.scheduler.plan import plan_shards
from simnfnd.factory.scheduler.run import make_dataset
from simnfnd.factory.scheduler.settings import SchedulerSettings
from tests.fake_source import FakeConfig, FakePreparer, GentleSource, refs, rerun
from tests.worker_processes import workers_of

FRAMES_PER_SHARD = 3
KILLS = "reef/alpha/0004"
HANGS = "reef/alpha/0009"


@dataclass(frozen=True)
class Outcome:
    """worker_kills, run_kills: how many there were.  runs: how often the command was given.

    named: frames in failed.jsonl at the end.  shards: path -> bytes.
    """

    worker_kills: int
    run_kills: int
    runs: int
    seconds: float
    named: tuple[str, ...]
    shards: dict[str, bytes]


def make(directory: Path, backend: str, config: FakeConfig, shards: int) -> None:
    """The run: `shards` shards, two kinds of workers."""
    frames = refs(shards * FRAMES_PER_SHARD)
    job = Job(
        directory,
        plan_shards({"train": frames}, 1, FRAMES_PER_SHARD),
        source=GentleSource,
        preparer=FakePreparer,
        config=config,
        provenance=Provenance({"seed": 0}, config_hash({"seed": 0}), "simnfnd storm"),
        config_values={},
        dataset=DatasetSettings(preview_pairs=0),
        scheduler=SchedulerSettings(
            backend=backend,  # type: ignore[arg-type]
            workers=5,
            render_workers=3,
            retries=2,
            frame_timeout_s=1.5,
        ),
        rerun_command=rerun,
    )
    make_dataset(job)


def storm(
    directory: Path, backend: str, *, shards: int, kills: int, run_kills: int, delay_s: float
) -> Outcome:
    """Give the command again and again, killing workers, until only the bad frames are missing.

    The command itself is killed `run_kills` times, spread over the kills of workers.
    """
    chance = random.Random(0)
    begun = time.monotonic()
    worker_kills, killed_runs, runs = 0, 0, 0
    while True:
        runs += 1
        process = _start(directory, backend, delay_s, shards)
        while process.poll() is None:
            time.sleep(chance.uniform(0.2, 0.7))
            workers = workers_of(process.pid)
            if worker_kills < kills and workers and process.poll() is None:
                chance.choice(workers).kill()
                worker_kills += 1
            if killed_runs < run_kills and worker_kills > kills * (killed_runs + 1) / (
                run_kills + 1
            ):
                process.kill()
                killed_runs += 1
        process.wait()
        missing = {item["frame"] for item in load_failures(directory)}
        if process.returncode == 0 and missing <= {KILLS, HANGS}:
            break
        if runs > 12:
            raise SystemExit(f"{runs} runs were not enough; missing {sorted(missing)}")
    return Outcome(
        worker_kills,
        killed_runs,
        runs,
        time.monotonic() - begun,
        tuple(sorted(missing)),
        shard_bytes(directory),
    )


def undisturbed(directory: Path, shards: int) -> dict[str, bytes]:
    """The shards of a run in one process, where the two bad frames merely fail."""
    prepared = str(directory.parent / "calm")
    make(directory, "serial", FakeConfig(bad=(KILLS, HANGS), prepared=prepared), shards)
    return shard_bytes(directory)


def shard_bytes(directory: Path) -> dict[str, bytes]:
    """Path below the dataset -> content, of every shard."""
    paths = sorted(directory.glob("*/*.h5"))
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in paths}


def _start(directory: Path, backend: str, delay_s: float, shards: int) -> subprocess.Popen[bytes]:
    words = [str(directory), backend, str(delay_s), str(shards)]
    directory.parent.mkdir(parents=True, exist_ok=True)
    with (directory.parent / "errors.txt").open("a") as errors:
        return subprocess.Popen(
            [sys.executable, "-m", "tests.storm", *words],
            stderr=errors,
            cwd=Path(__file__).parents[1],
            start_new_session=True,
        )


def main(words: Sequence[str]) -> None:
    """Run as the storm's victim."""
    directory = Path(words[0])
    config = FakeConfig(
        kills=(KILLS,),
        hangs=(HANGS,),
        delay_s=float(words[2]),
        prepared=str(directory.parent / "prepared"),
    )
    make(directory, words[1], config, int(words[3]))


if __name__ == "__main__":
    main(sys.argv[1:])
