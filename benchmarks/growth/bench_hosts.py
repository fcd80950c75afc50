"""Three hosts that share nothing but a URL: one dies, one is slow, one comes late.

Each host is a network name space of this machine with temporary files of its own and a Dask worker
in it; datasets go to an S3 server on the bridge between them.  Needs root, iproute2 and util-linux.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from benchmarks.report import Cell, Options, Section, Table

HERE = "10.77.3.1"
HOSTS = ("dies", "slow", "late")
DELAY_MS = 150
_ROOT = Path(__file__).parents[2]
# Tables of datasets, not pictures of them: the machine is small.
_WORDS = ("render=analytic", "scenes.frames_per_location=2", "scenes.width=242",
          "scenes.height=152", "scheduler.shard_size=2", "dataset.preview_pairs=0")  # fmt: skip


def measure(options: Options) -> Section:
    """Make a dataset in a folder and by the three hosts; every byte is compared."""
    locations = options.amount(12, 6)
    rows: list[tuple[Cell, ...]] = []
    with tempfile.TemporaryDirectory(prefix="hosts-") as name, ExitStack() as held:
        base = Path(name)
        words = [*_WORDS, f"scenes.locations={locations}"]
        begun = time.perf_counter()
        _make(base, dict(os.environ), [*words, "dataset.dir=local", "scheduler.workers=1"])
        rows.append(("one process, a folder", time.perf_counter() - begun, "", "", ""))
        expected = _shards(base / "local")
        try:
            held.enter_context(_bridge())
        except (OSError, subprocess.CalledProcessError) as error:
            return Section((), note=f"no network name spaces here ({error}); not run")
        environment = held.enter_context(_storage(base))
        address = held.enter_context(_scheduler(environment))
        started = {
            host: held.enter_context(_worker(host, address, environment)) for host in HOSTS[:2]
        }
        time.sleep(8)
        begun = time.perf_counter()
        url = "s3://sonar/hosts"
        more = [f"dataset.dir={url}", "scheduler=dask", f"scheduler.address={address}",
                "scheduler.frame_timeout_s=120", "scheduler.retries=2"]  # fmt: skip
        run = _start(base, environment, [*words, *more])
        _wait(lambda: len(_remote(environment, url)) >= locations // 4 or run.poll() is not None)
        held.enter_context(_worker("late", address, environment))
        os.killpg(started["dies"].pid, signal.SIGKILL)
        said, _ = run.communicate(timeout=1200)
        seconds = time.perf_counter() - begun
        found = _remote(environment, url)
        same = sum(found.get(name) == content for name, content in expected.items())
        rows.append(
            (
                "three hosts, a URL",
                seconds,
                run.returncode,
                f"{same} of {len(expected)}",
                len(found),
            )
        )
        wrong = run.returncode or same != len(expected) or len(found) != same
    columns = ("made by", "s", "exit code", "shards of the same bytes", "shards")
    note = f"slow: {DELAY_MS} ms on every packet; dies: killed with its nanny; late: joins then."
    table = Table(columns, tuple(rows), "Hosts without a shared folder", note)
    return Section((table,), failed=said.decode()[-500:] if wrong else "")


def _start(
    base: Path, environment: dict[str, str], words: Sequence[str]
) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "simnfnd", "make", *words]
    return subprocess.Popen(
        command, cwd=base, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )


def _make(base: Path, environment: dict[str, str], words: Sequence[str]) -> None:
    run = _start(base, environment, words)
    said, _ = run.communicate(timeout=1200)
    if run.returncode:
        raise SystemExit(said.decode()[-1000:])


def _shards(folder: Path) -> dict[str, bytes]:
    paths = sorted(folder.glob("t*/*.h5"))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _remote(environment: dict[str, str], url: str) -> dict[str, bytes]:
    """What lies in train/ and test/ at the URL."""
    import fsspec

    system = fsspec.filesystem("s3", endpoint_url=environment["AWS_ENDPOINT_URL"],
                               key="us", secret="secret")  # fmt: skip
    system.invalidate_cache()
    root = url.removeprefix("s3://")
    names = [name for name in system.find(root) if name.endswith(".h5") and "/t" in name]
    found = system.cat(names, on_error="omit") if names else {}
    return {name[len(root) + 1 :]: content for name, content in found.items()}


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@contextmanager
def _bridge() -> Iterator[None]:
    """A bridge with an address of ours, and a name space on it for each host."""
    with ExitStack() as held:
        _ip("link", "add", "sonar-br", "type", "bridge")
        held.callback(subprocess.run, ["ip", "link", "del", "sonar-br"], check=False)
        _ip("addr", "add", f"{HERE}/24", "dev", "sonar-br")
        _ip("link", "set", "sonar-br", "up")
        for number, host in enumerate(HOSTS, 2):
            name = f"sonar-{host}"
            _ip("netns", "add", name)
            held.callback(subprocess.run, ["ip", "netns", "del", name], check=False)
            _ip("link", "add", f"sv-{host}", "type", "veth", "peer", "name", "eth0", "netns", name)
            _ip("link", "set", f"sv-{host}", "master", "sonar-br", "up")
            address = f"{HERE.rpartition('.')[0]}.{number}/24"
            _ip("-n", name, "addr", "add", address, "dev", "eth0")
            _ip("-n", name, "link", "set", "eth0", "up")
            _ip("-n", name, "link", "set", "lo", "up")
        yield


@contextmanager
def _storage(base: Path) -> Iterator[dict[str, str]]:
    """An S3 server on the bridge; the environment that leads to it."""
    code = (
        "import sys, time, logging; from moto.server import ThreadedMotoServer\n"
        "logging.getLogger('werkzeug').setLevel(logging.ERROR)\n"
        f"ThreadedMotoServer(ip_address='{HERE}', port=9077, verbose=False).start()\n"
        "import fsspec; fsspec.filesystem('s3').mkdir('sonar'); print('ready', flush=True)\n"
        "time.sleep(3600)"
    )
    environment = {
        **os.environ,
        "AWS_ACCESS_KEY_ID": "us",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_ENDPOINT_URL": f"http://{HERE}:9077",
        "SIMNFND_CLOUD_CACHE": str(base / "copies"),
        "OMP_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
        "PYTHONPATH": str(_ROOT),
    }
    server = subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    assert server.stdout is not None
    try:
        server.stdout.readline()
        yield environment
    finally:
        server.kill()


@contextmanager
def _scheduler(environment: dict[str, str]) -> Iterator[str]:
    words = ["-m", "distributed.cli.dask_scheduler", "--host", HERE, "--port", "8777"]
    process = subprocess.Popen(
        [sys.executable, *words, "--no-dashboard"], env=environment, stderr=subprocess.DEVNULL
    )
    try:
        yield f"tcp://{HERE}:8777"
    finally:
        process.kill()


@contextmanager
def _worker(
    host: str, address: str, environment: dict[str, str]
) -> Iterator[subprocess.Popen[bytes]]:
    """A Dask worker with its nanny on a host; ends with all that it has started."""
    here = tempfile.gettempdir()
    own = f'mount -t tmpfs tmpfs {here} && cd {here} && exec "$@"'
    if host == "slow":
        own = f"tc qdisc add dev eth0 root netem delay {DELAY_MS}ms || renice -n 15 $$; {own}"
    words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nworkers", "1",
             "--nthreads", "1", "--memory-limit", "0", "--no-dashboard",
             "--preload", "simnfnd.factory.scheduler.workers.dask_preload"]  # fmt: skip
    there = {**environment, "SIMNFND_CLOUD_CACHE": f"{here}/copies", "HOME": here, "TMPDIR": here}
    process = subprocess.Popen(
        ["ip", "netns", "exec", f"sonar-{host}", "unshare", "-m", "sh", "-c", own, "sh", *words],
        env=there,
        start_new_session=True,
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        with ExitStack() as quiet:
            quiet.callback(process.wait, 20)
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


def _wait(condition: Callable[[], bool], seconds: float = 600.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.5)
