"""The run loop: same bytes however the work went, and nothing lost to crashes, hangs or signals."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.memory import workers_of
from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.jobs.journal import open_journal, read_journal
from simnfnd.factory.jobs.pending import PendingShard
from simnfnd.factory.jobs.plan import plan_shards
from simnfnd.factory.jobs.settings import MAX_AUTO_WORKERS, Crew, SchedulerSettings
from simnfnd.factory.settings import build
from tests.fake_source import BrokenSource, FakeConfig, LethalSource, refs
from tests.project_files import ROOT
from tests.run_fake import make


def shard_bytes(directory: Path) -> dict[str, bytes]:
    """Path below the dataset -> content, of every shard."""
    paths = sorted(directory.glob("*/*.h5"))
    return {path.relative_to(directory).as_posix(): path.read_bytes() for path in paths}


def failures(directory: Path) -> dict[str, dict[str, str]]:
    """Frame name -> its line of failed.jsonl."""
    lines = (directory / "failed.jsonl").read_text().splitlines()
    return {item["frame"]: item for item in map(json.loads, lines)}


def litter(directory: Path) -> list[str]:
    """Files that a run must not leave behind."""
    return [path.name for path in directory.rglob(".*")]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The shards of a run with one worker to which nothing happened."""
    directory = tmp_path_factory.mktemp("undisturbed") / "dataset"
    report = make(directory, workers=1)
    assert (report.samples, report.shards, report.kept, report.failures) == (32, 4, 0, ())
    assert litter(directory) == []
    return shard_bytes(directory)


# --- plan -------------------------------------------------------------------------------------


@given(
    train=st.integers(0, 60),
    test=st.integers(0, 20),
    variants=st.integers(1, 5),
    shard_size=st.integers(1, 12),
    limit=st.none() | st.integers(0, 100),
)
def test_plan_holds_every_sample_once_in_order(
    train: int, test: int, variants: int, shard_size: int, limit: int | None
) -> None:
    frames = {"train": refs(train), "test": refs(test, "beta")}
    tasks = plan_shards(frames, variants, shard_size, {"train": limit})
    assert tasks == plan_shards(frames, variants, shard_size, {"train": limit})
    for split, count in (("train", train), ("test", test)):
        own = [task for task in tasks if task.split == split]
        assert [task.path for task in own] == [
            f"{split}/shard-{index:05d}.h5" for index in range(len(own))
        ]
        samples = [
            (ref.frame, variant)
            for task in own
            for ref, numbers in task.items
            for variant in numbers
        ]
        whole = count * variants
        limited = whole if limit is None or split == "test" else min(limit, whole)
        assert len(samples) == limited == sum(task.samples for task in own)
        assert samples == sorted(set(samples))
        assert all(0 < task.samples <= shard_size for task in own)
        if variants <= shard_size:
            homes = [ref.frame for task in own for ref, _ in task.items]
            assert len(homes) == len(set(homes)), "a frame lies in two shards"


def test_a_limit_takes_frames_from_all_scenes() -> None:
    frames = refs(50, "alpha") + refs(50, "beta")
    (task,) = plan_shards({"train": frames}, 1, 100, {"train": 10})
    scenes = [ref.scene for ref, _ in task.items]
    assert scenes.count("alpha") == scenes.count("beta") == 5


def test_plan_digest_tells_frames_and_variants_but_not_where_files_lie() -> None:
    (one,) = plan_shards({"train": refs(3)}, 2, 10)
    (other,) = plan_shards({"train": refs(3)}, 3, 10)
    assert one.digest != other.digest
    moved = [type(ref)(ref.location, ref.scene, ref.frame, ("elsewhere",)) for ref in refs(3)]
    assert plan_shards({"train": moved}, 2, 10)[0].digest == one.digest


def test_plan_refuses_a_frame_in_both_splits() -> None:
    with pytest.raises(FactoryError, match="reef/alpha/0001: named twice"):
        plan_shards({"train": refs(3), "test": refs(2)[1:]}, 1, 10)


# --- parts ------------------------------------------------------------------------------------


def test_settings_file_states_the_defaults() -> None:
    stated = yaml.safe_load((ROOT / "conf/scheduler/local.yaml").read_text())
    assert build(SchedulerSettings, stated) == SchedulerSettings()
    assert set(stated) == set(SchedulerSettings.__dataclass_fields__)


def test_crew_follows_cores_memory_and_work(monkeypatch: pytest.MonkeyPatch) -> None:
    from simnfnd.factory.jobs import settings as module

    def machine(cores: int, memory_gb: float) -> None:
        monkeypatch.setattr(module, "usable_cores", lambda: cores)
        monkeypatch.setattr(module, "available_memory_bytes", lambda: int(memory_gb * 1e9))

    auto = SchedulerSettings(memory_per_worker_gb=0.3, memory_per_renderer_gb=1.0)
    machine(64, 100)
    assert auto.crew(1000, 0) == Crew(0, MAX_AUTO_WORKERS)
    assert MAX_AUTO_WORKERS == 48
    assert auto.crew(5, 0) == Crew(0, 5)
    assert auto.crew(1000, 9000) == Crew(48, 0), "room for 48 that render"
    machine(64, 30)
    crew = auto.crew(1000, 9000)
    assert crew.total == 48
    assert 0.3 * crew.noise + 1.0 * crew.render < 30 * 0.8
    machine(2, 24)
    assert auto.crew(1000, 9000) == Crew(2, 0)
    assert SchedulerSettings(workers=48, start_all=True).crew(4, 16) == Crew(2, 46)
    assert SchedulerSettings(workers=48, render_workers=5).crew(100, 99) == Crew(5, 43)
    machine(8, 0)
    assert auto.crew(1000, 9000) == Crew(1, 0)
    assert auto.crew(1000, 0) == Crew(0, 1)
    assert SchedulerSettings(workers=7).crew(1000, 0) == Crew(0, 7)


@pytest.mark.parametrize("workers", [0, -1, "many", 1.5])
def test_bad_worker_counts_are_refused_by_name(workers: object) -> None:
    with pytest.raises(FactoryError, match=r"scheduler\.workers"):
        build(SchedulerSettings, {"workers": workers}, "scheduler")


def test_journal_tells_progress_even_when_cut_short(tmp_path: Path) -> None:
    path = tmp_path / "work" / "one.journal"
    assert read_journal(path).begun is False
    with open_journal(path, 1.0) as journal:
        journal.start(0)
        journal.done(0, 3)
        journal.start(1)
        journal.failed(1)
        journal.start(12)
    progress = read_journal(path)
    assert (progress.samples, progress.failed, progress.in_hand) == (3, 1, 12)
    text = path.read_text()
    path.write_text(text[:-2])
    assert read_journal(path).in_hand is None, "half a line is no event"
    path.write_text(text + "Timeout (0:00:01)!\nThread 0x1 (most recent call first):\n")
    assert read_journal(path).timed_out
    assert read_journal(path).in_hand == 12


@given(deaths=st.lists(st.none() | st.integers(0, 4)), retries=st.integers(0, 3))
def test_deaths_of_a_shard_come_to_an_end(deaths: list[int | None], retries: int) -> None:
    (task,) = plan_shards({"train": refs(5)}, 1, 10)
    shard = PendingShard(task, retries)
    happened = 0  # deaths before this one; those of a frame that is given up do not happen
    for count, in_hand in enumerate(deaths):
        given_up = {failure.ref.frame for failure in shard.given_up}
        if in_hand is not None and task.items[in_hand][0].frame in given_up:
            continue  # is never in hand again
        again = shard.died(in_hand, "crash", "killed")
        assert happened <= 6 * (retries + 1)
        happened += 1
        if not again:
            assert len(shard.given_up) == 5
            assert deaths[: count + 1].count(None) == retries + 1
            return
    for index, (ref, _) in enumerate(task.items):
        named = ref.frame in {failure.ref.frame for failure in shard.given_up}
        assert named == (deaths.count(index) > retries)


# --- whole runs -------------------------------------------------------------------------------


def test_three_workers_give_the_bytes_of_one(tmp_path: Path, undisturbed: dict[str, bytes]) -> None:
    # Each worker is replaced after every shard, which must not show either.
    report = make(tmp_path / "dataset", workers=3, recycle_frames=1)
    assert report.samples_by_split == {"train": 24, "test": 8}
    assert shard_bytes(tmp_path / "dataset") == undisturbed


def test_frames_that_fail_kill_or_break_cost_themselves_alone(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    config = FakeConfig(
        bad=("reef/alpha/0000",),
        buggy=("reef/alpha/0001",),
        kills=("reef/alpha/0006",),
        killed_once=("reef/alpha/0009", "reef/beta/0003"),
        marks=str(tmp_path),
    )
    report = make(directory, config)
    told = failures(directory)
    assert {name: item["kind"] for name, item in told.items()} == {
        "reef/alpha/0000": "frame",
        "reef/alpha/0001": "error",
        "reef/alpha/0006": "crash",
    }
    assert told["reef/alpha/0000"]["reason"] == "reef/alpha/0000: depth has 3 NaN pixels"
    assert "ZeroDivisionError: no such thing (fake_source.py:" in told["reef/alpha/0001"]["reason"]
    assert "SIGKILL" in told["reef/alpha/0006"]["reason"]
    assert told["reef/alpha/0006"]["command"].endswith("frames.only=[reef/alpha/0006]")
    assert [failure.ref.name for failure in report.failures] == sorted(told)
    assert report.samples == 32 - 3 * 2
    manifest = load_manifest(directory)
    assert manifest is not None
    assert manifest.shards["train/shard-00001.h5"].failed == ("reef/alpha/0006",)
    made = shard_bytes(directory)
    for path in ("train/shard-00002.h5", "test/shard-00000.h5"):
        assert made[path] == undisturbed[path], "a worker that died once left a trace"
    assert litter(directory) == []

    # The shards that are as good as they can be stay as they are; cured frames come in.
    before = {path: (directory / path).stat().st_mtime_ns for path in made}
    again = make(directory, FakeConfig(bad=config.bad, kills=config.kills, buggy=config.buggy))
    assert again.kept == 4
    assert {path: (directory / path).stat().st_mtime_ns for path in made} == before
    assert set(failures(directory)) == set(told)
    cured = make(directory)
    assert (cured.samples, cured.kept, cured.failures) == (32, 2, ())
    assert failures(directory) == {}
    assert shard_bytes(directory) == undisturbed


def test_a_shard_without_any_good_frame_has_no_file(tmp_path: Path) -> None:
    bad = tuple(ref.name for ref in refs(4, "beta"))
    report = make(tmp_path / "dataset", FakeConfig(bad=bad))
    assert report.samples_by_split == {"train": 24, "test": 0}
    assert not list((tmp_path / "dataset").glob("test/*"))
    assert len(report.failures) == 4


def test_a_frame_that_hangs_is_given_up(tmp_path: Path) -> None:
    config = FakeConfig(hangs=("reef/alpha/0002",))
    report = make(tmp_path / "dataset", config, frame_timeout_s=1.0, retries=0)
    (failure,) = report.failures
    assert (failure.kind, failure.ref.name) == ("timeout", "reef/alpha/0002")
    assert "scheduler.frame_timeout_s=1" in failure.reason
    assert report.samples == 30


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"config": FakeConfig(fatal=("reef/alpha/0002",))}, "render.kind=cycles needs bpy"),
        ({"source": BrokenSource}, "use Python 3.11"),
        ({"source": LethalSource}, "no worker lives long enough to begin a frame"),
    ],
)
def test_what_no_frame_can_survive_ends_the_run_in_one_line(
    tmp_path: Path, changes: dict[str, object], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simnfnd.factory.jobs.loop._MAX_BARREN_DEATHS", 3)
    with pytest.raises(FactoryError, match=message) as caught:
        make(tmp_path / "dataset", **changes)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    assert not workers_of(os.getpid())


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def flip_a_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def test_damaged_shards_are_made_again_and_the_rest_kept(
    tmp_path: Path, undisturbed: dict[str, bytes], capfd: pytest.CaptureFixture[str]
) -> None:
    directory = tmp_path / "dataset"
    make(directory)
    capfd.readouterr()
    truncate(directory / "train/shard-00000.h5")
    flip_a_bit(directory / "train/shard-00001.h5")
    (directory / "test/shard-00000.h5").unlink()
    kept = (directory / "train/shard-00002.h5").stat().st_mtime_ns
    report = make(directory)
    assert report.kept == 1
    told = capfd.readouterr().err
    assert "train/shard-00000.h5: " in told
    assert "bytes instead of" in told
    assert "train/shard-00001.h5: SHA-256 differs; it is made again" in told
    assert "test/shard-00000.h5: absent" in told
    assert shard_bytes(directory) == undisturbed
    assert (directory / "train/shard-00002.h5").stat().st_mtime_ns == kept


def test_a_full_disk_is_said_in_one_line_and_cured_by_running_again(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    largest = max(map(len, undisturbed.values()))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The workers inherit it: a shard no longer fits, what else is written does.
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest // 2, limits[1]))
    try:
        with pytest.raises(FactoryError, match="no room to write") as caught:
            make(directory)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "\n" not in str(caught.value)
    assert litter(directory) == []
    assert make(directory).samples == 32
    assert shard_bytes(directory) == undisturbed


def test_frames_gone_missing_do_not_cost_finished_samples(tmp_path: Path) -> None:
    from simnfnd.factory.jobs.resume import take_up

    make(tmp_path / "dataset")
    manifest = load_manifest(tmp_path / "dataset")
    assert manifest is not None
    fewer = plan_shards({"train": refs(6), "test": refs(4, "beta")}, 2, 8)
    with pytest.raises(FactoryError, match=r"holds 24 train samples.*only 12"):
        take_up(tmp_path / "dataset", fewer, manifest)
    assert len(shard_bytes(tmp_path / "dataset")) == 4


def test_another_cut_of_the_same_frames_leaves_no_stray_shard(tmp_path: Path) -> None:
    from simnfnd.factory.jobs.resume import take_up

    make(tmp_path / "dataset")
    manifest = load_manifest(tmp_path / "dataset")
    assert manifest is not None
    larger = plan_shards({"train": refs(12), "test": refs(4, "beta")}, 2, 100)
    resumed = take_up(tmp_path / "dataset", larger, manifest)
    # Both test cuts hold the same samples, so that shard stays.
    assert [task.path for task in resumed.todo] == ["train/shard-00000.h5"]
    assert set(resumed.manifest.shards) == {"test/shard-00000.h5"}
    assert not (tmp_path / "dataset/train/shard-00001.h5").exists()


def start(directory: Path, workers: int, delay_s: float) -> subprocess.Popen[bytes]:
    """A run in a session of its own, as a terminal would give it."""
    command = [sys.executable, "-m", "tests.run_fake", str(directory), str(workers), str(delay_s)]
    return subprocess.Popen(
        command, cwd=ROOT, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def finished(directory: Path) -> int:
    """Shards that are on record."""
    manifest = load_manifest(directory)
    return len(manifest.shards) if manifest else 0


def wait_for(condition: Callable[[], object], seconds: float = 20.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.02)


def session_members(session: int) -> list[int]:
    """Processes of a session that are alive."""
    members = []
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == session and process.status() != psutil.STATUS_ZOMBIE:
                members.append(process.pid)
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
    return members


@pytest.mark.parametrize(
    ("number", "exit_code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["ctrl-c", "term"]
)
def test_signals_stop_quickly_leave_nobody_and_lose_nothing(
    tmp_path: Path, undisturbed: dict[str, bytes], number: int, exit_code: int
) -> None:
    directory = tmp_path / "dataset"
    process = start(directory, 2, 0.1)
    wait_for(lambda: finished(directory))
    asked = time.monotonic()
    # Ctrl-C reaches every process of the terminal's group, kill only the one.
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - asked < 5
    assert process.returncode == exit_code
    assert b"Traceback" not in errors
    wait_for(lambda: not session_members(process.pid), 5)
    assert litter(directory) == []
    manifest = load_manifest(directory)
    assert manifest is not None
    assert 1 <= len(manifest.shards) < 4
    report = make(directory)
    assert report.kept == len(manifest.shards)
    assert shard_bytes(directory) == undisturbed


NEVER_ENDING_STOP = """
import sys, time
from simnfnd.factory.workers.local import LocalBackend
from pathlib import Path
from tests.fake_source import FakeConfig
from tests.run_fake import make
def stop(self):
    Path(sys.argv[1] + ".stopping").touch()
    time.sleep(60)
LocalBackend.stop = stop
make(Path(sys.argv[1]), FakeConfig(delay_s=0.1))
"""


@pytest.mark.parametrize(
    ("number", "exit_code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)], ids=["ctrl-c", "term"]
)
def test_a_second_signal_kills_at_once(
    tmp_path: Path, undisturbed: dict[str, bytes], number: int, exit_code: int
) -> None:
    directory = tmp_path / "dataset"
    process = subprocess.Popen(
        [sys.executable, "-c", NEVER_ENDING_STOP, str(directory)],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    wait_for(lambda: finished(directory))
    os.kill(process.pid, number)
    wait_for((tmp_path / "dataset.stopping").exists)
    time.sleep(0.4)  # what comes sooner is the same keypress
    assert process.poll() is None
    asked = time.monotonic()
    os.kill(process.pid, number)
    assert process.wait(20) == exit_code
    assert time.monotonic() - asked < 2
    wait_for(lambda: not session_members(process.pid), 10)
    make(directory)
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed


def test_a_killed_parent_takes_its_workers_along_and_the_run_goes_on(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    for _ in range(2):
        process = start(directory, 3, 0.1)
        there = finished(directory)
        wait_for(lambda: finished(directory) > there)  # noqa: B023
        process.kill()
        process.communicate(timeout=20)
        wait_for(lambda: not session_members(process.pid), 5)  # noqa: B023
    report = make(directory)
    assert report.kept >= 1
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed


def test_what_a_run_killed_after_its_last_shard_left_goes_away(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    make(directory, workers=1)
    half_written = (
        "import pathlib, sys; from simnfnd.factory import files; "
        "files._temporary_for(pathlib.Path(sys.argv[1])).write_bytes(b'half')"
    )
    target = directory / "train" / "shard-00000.h5"
    subprocess.run([sys.executable, "-c", half_written, str(target)], cwd=ROOT, check=True)
    (directory / ".work").mkdir()
    (directory / ".work" / "train-shard-00000.h5.1.journal").write_bytes(b"half")
    assert len(litter(directory)) >= 2
    report = make(directory, workers=1)
    assert report.kept == 4
    assert litter(directory) == []
    assert shard_bytes(directory) == undisturbed


def test_killing_workers_at_random_moments_changes_nothing(
    tmp_path: Path, undisturbed: dict[str, bytes]
) -> None:
    directory = tmp_path / "dataset"
    process = start(directory, 2, 0.1)
    killed = 0
    while process.poll() is None and killed < 4:
        time.sleep(0.25)
        for worker in workers_of(process.pid)[:1] if process.poll() is None else []:
            worker.kill()
            killed += 1
    _, errors = process.communicate(timeout=60)
    assert killed >= 2
    # Whatever the kills hit, running again completes it; mostly there is nothing left to do.
    assert process.returncode == 0, errors.decode()[-500:]
    make(directory)
    assert shard_bytes(directory) == undisturbed


@settings(max_examples=30)
@given(st.text(max_size=200))
def test_any_text_in_a_journal_is_read_without_a_crash(text: str) -> None:
    import tempfile

    with tempfile.NamedTemporaryFile("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        read_journal(Path(file.name))


def test_zero_planned_samples_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="nothing to make"):
        make(tmp_path / "dataset", tasks=(), source=BrokenSource)
    assert not (tmp_path / "dataset").exists()
