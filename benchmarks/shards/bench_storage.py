"""A dataset on S3 from the command line: made, killed, resumed, validated, trained on, exported.

The server is moto's, in a process of its own on loopback; the bytes are compared with a folder's.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.report import Cell, Options, Section, Table
from tests.cloud_storage import contents, s3_server, shards_of

_WORDS = ("render=analytic", "scenes.frames_per_location=2", "scenes.width=242",
          "scenes.height=152", "scheduler.shard_size=2", "scheduler.workers=2")  # fmt: skip
_ROOT = Path(__file__).parents[2]


def measure(options: Options) -> Section:
    """Each command once, with its exit code and its time."""
    locations = options.amount(8, 4)
    words = [*_WORDS, f"scenes.locations={locations}"]
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory(prefix="storage-") as name:
        base = Path(name)
        with s3_server(base / "copies") as bucket:
            url = f"{bucket}/data"
            make = ["make", *words, f"dataset.dir={url}"]
            _run(base, rows, "make in a folder", ["make", *words, "dataset.dir=local"])
            rows.append(("make, killed", *_killed(base, make, url)))
            os.environ["SIMNFND_CLOUD_CACHE"] = str(base / "elsewhere")
            _run(base, rows, "the same command, where there is no copy", make)
            _run(base, rows, "validate --deep", ["validate", "--deep", url])
            _run(base, rows, "inspect", ["inspect", url])
            _run(base, rows, "export", ["export", url, "--to", "png", "--out", "png"])
            train = ["train", f"dataset={url}", "train.steps=2", "train.check_every=1",
                     "data.patch=64", "data.batch=2", "data.crops=1", "data.validation=0.25",
                     "model=unet", "out=trained"]  # fmt: skip
            _run(base, rows, "train, two steps", train)
            paths = sorted((base / "local").glob("t*/*.h5"))
            local = {p.relative_to(base / "local").as_posix(): p.read_bytes() for p in paths}
            same = sum(shards_of(url).get(name) == content for name, content in local.items())
            left = [name for name in contents(url) if name.startswith(".")]
            rows.append((f"shards of the same bytes: {same} of {len(local)}", "", "", ""))
    codes = [str(row[1]) for row in rows if row[1] not in ("", -signal.SIGKILL)]
    wrong = set(codes) != {"0"} or same != len(local) or bool(left)
    columns = ("command", "exit code", "s", "said")
    return Section((Table(columns, tuple(rows)),), failed=f"{codes} {left}" if wrong else "")


def _start(base: Path, words: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "simnfnd", *words],
        cwd=base,
        env={**os.environ, "PYTHONPATH": str(_ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def _run(base: Path, rows: list[tuple[Cell, ...]], what: str, words: list[str]) -> None:
    begun = time.perf_counter()
    process = _start(base, words)
    said, _ = process.communicate(timeout=1200)
    last = said.strip().splitlines()[-1] if said.strip() else ""
    last = last.replace(str(base), "")[:100]
    rows.append((what, process.returncode, time.perf_counter() - begun, last))
    print(rows[-1], flush=True)


def _killed(base: Path, words: list[str], url: str) -> tuple[Cell, ...]:
    """Kill the command and its workers when some shards are there."""
    begun = time.perf_counter()
    process = _start(base, words)
    while process.poll() is None and len(shards_of(url)) < 2:
        time.sleep(0.2)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    seconds = time.perf_counter() - begun
    return process.returncode, seconds, f"{len(shards_of(url))} shards are there"
