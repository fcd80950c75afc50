"""A real Slurm on this machine: an array of slices that begin at once on a folder that is new.

One node on loopback with as many CPUs as it is told; needs root, and the Debian packages slurm-wlm
and munge.  What it starts is stopped, and what it writes lies in a temporary folder.
"""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.report import Cell, Options, Section, Table

SLICES, ROUNDS = 8, 10
_ROOT = Path(__file__).parents[2]
_WORDS = ("render=analytic", "scenes.locations=8", "scenes.frames_per_location=1",
          "scenes.width=242", "scenes.height=152", "scheduler.shard_size=1",
          "scheduler.workers=1", "dataset.preview_pairs=0")  # fmt: skip


def measure(options: Options) -> Section:
    """Rounds of `sbatch --array`, each on a new folder, and the run of the whole after it."""
    if not (shutil.which("slurmctld") and shutil.which("munged") and os.geteuid() == 0):
        return Section((), note="no Slurm here (apt-get install slurm-wlm munge, as root); not run")
    slices, rounds = options.amount(SLICES, 2), options.amount(ROUNDS, 1)
    rows: list[tuple[Cell, ...]] = []
    bad: list[str] = []
    with tempfile.TemporaryDirectory(prefix="slurm-") as name:
        base = Path(name)
        base.chmod(0o755)
        _make(base, "alone")
        expected = _shards(base / "alone")
        with _slurm(base, slices) as environment:
            for number in range(rounds):
                begun = time.perf_counter()
                job = _submit(base, environment, f"round-{number}", slices)
                states = _states(job, environment, slices)
                seconds = time.perf_counter() - begun
                red = [state for state in states if state != "COMPLETED"]
                _make(base, f"round-{number}")
                same = _shards(base / f"round-{number}") == expected
                left = [p.name for p in (base / f"round-{number}").glob("*-of-*")]
                rows.append((number + 1, len(states), len(red), seconds, "yes" if same else "NO"))
                print(rows[-1], left, flush=True)
                if red or not same or left or len(states) != slices:
                    logs = "".join(p.read_text() for p in base.glob(f"log-{job}_*"))
                    bad.append(f"round {number + 1}: {states} {left} {logs[-600:]}")
    columns = ("round", "tasks", "red", "s", "bytes as alone")
    title = f"sbatch --array=0-{slices - 1} on a new folder"
    return Section((Table(columns, tuple(rows), title),), failed="; ".join(bad)[:2000])


def _make(base: Path, folder: str) -> None:
    words = [sys.executable, "-m", "simnfnd", "make", *_WORDS, f"dataset.dir={folder}"]
    done = subprocess.run(words, cwd=base, capture_output=True, text=True, env=_environment())
    if done.returncode:
        raise SystemExit(f"{folder}: {done.stderr[-1000:]}")


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(_ROOT), "OMP_NUM_THREADS": "1"}


def _shards(folder: Path) -> dict[str, bytes]:
    paths = sorted(folder.glob("t*/*.h5"))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _submit(base: Path, environment: dict[str, str], folder: str, slices: int) -> str:
    script = (
        f"#!/bin/bash\n{sys.executable} -m simnfnd make {' '.join(_WORDS)} dataset.dir={folder} "
        f"shard.index=$SLURM_ARRAY_TASK_ID shard.count={slices}\n"
    )
    words = ["sbatch", "--parsable", f"--array=0-{slices - 1}", "--cpus-per-task=1",
             f"--output={base}/log-%A_%a", f"--chdir={base}"]  # fmt: skip
    done = subprocess.run(
        words, input=script, cwd=base, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.strip().split(";")[0]


def _states(job: str, environment: dict[str, str], slices: int) -> list[str]:
    """The state of each task, when all have ended (or ten minutes are over)."""
    deadline = time.monotonic() + 600
    while True:
        said = subprocess.run(
            ["scontrol", "-o", "show", "job", job], env=environment, capture_output=True, text=True
        ).stdout
        states = [line.split("JobState=")[1].split()[0] for line in said.splitlines()]
        running = {"PENDING", "RUNNING", "COMPLETING", "CONFIGURING"} & set(states)
        if (len(states) == slices and not running) or time.monotonic() > deadline:
            return states
        time.sleep(0.5)


@contextmanager
def _slurm(base: Path, cpus: int) -> Iterator[dict[str, str]]:
    """munge, slurmctld and slurmd of our own; the environment that leads to them."""
    host = socket.gethostname().split(".")[0]
    key, pipe = base / "munge.key", base / "munge.socket"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    # What sbatch gives to the tasks is read again from the node: no more than there is.
    config = base / "slurm.conf"
    config.write_text(
        f"ClusterName=sonar\nSlurmctldHost={host}(127.0.0.1)\nAuthType=auth/munge\n"
        f"AuthInfo=socket={pipe}\nCredType=cred/munge\nSlurmUser=root\nSlurmdUser=root\n"
        f"SlurmctldPort=16817\nSlurmdPort=16818\nStateSaveLocation={base}/state\n"
        f"SlurmdSpoolDir={base}/spool\nSlurmctldPidFile={base}/ctld.pid\n"
        f"SlurmdPidFile={base}/slurmd.pid\nSlurmctldLogFile={base}/ctld.log\n"
        f"SlurmdLogFile={base}/slurmd.log\nProctrackType=proctrack/pgid\n"
        "TaskPlugin=task/none\nSelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\n"
        "SwitchType=switch/none\nMpiDefault=none\nReturnToService=2\nMinJobAge=3600\n"
        "SlurmdParameters=config_overrides\nJobAcctGatherType=jobacct_gather/none\n"
        f"NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} State=UNKNOWN\n"
        f"PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP\n"
    )
    environment = {**_environment(), "SLURM_CONF": str(config)}
    commands = [
        ["munged", "-F", "--force", f"--key-file={key}", f"--socket={pipe}",
         f"--pid-file={base}/munged.pid", f"--log-file={base}/munged.log",
         f"--seed-file={base}/munged.seed"],
        ["slurmctld", "-D", "-i", "-f", str(config)],
        ["slurmd", "-D", "-f", str(config)],
    ]  # fmt: skip
    (base / "state").mkdir()
    (base / "spool").mkdir()
    started: list[subprocess.Popen[bytes]] = []
    try:
        for command in commands:
            with (base / f"{command[0]}.out").open("wb") as said:
                started.append(subprocess.Popen(command, env=environment, stdout=said, stderr=said))
            time.sleep(2)
        _wait_until_idle(base, environment)
        yield environment
    finally:
        for process in reversed(started):
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _wait_until_idle(base: Path, environment: dict[str, str]) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        said = subprocess.run(
            ["sinfo", "-h", "-o", "%T"], env=environment, capture_output=True, text=True
        )
        if "idle" in said.stdout:
            return
        time.sleep(1)
    logs = "".join(path.read_text(errors="replace")[-800:] for path in base.glob("*.[lo][ou][gt]"))
    raise SystemExit(f"Slurm does not come up: {said.stdout} {said.stderr} {logs}")
