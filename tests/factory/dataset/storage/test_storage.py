"""Datasets on storage that is no disk: made, resumed, read; two runs kept is_remote."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.workers.settings import ShardSlice
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.storage import Store, folder_of, local_folder, url_of
from simnfnd.factory.dataset.validate import validate
from simnfnd.factory.production.scheduler import run
from simnfnd.factory.production.scheduler.lock import publishing
from simnfnd.factory.production.scheduler.results import RunReport
from tests import run_fake
from tests.cloud_storage import contents, manifest_of, s3_server, shards_of
from tests.factory.dataset.some_shards import PROVENANCE, some_pairs, write_all
from tests.factory.production.scheduler.run_files import shard_bytes
from tests.fake_source import FakeConfig, FakePreparer, GentleSource
from tests.project_files import ROOT

pytest.importorskip("s3fs")
pytest.importorskip("moto")


def make(folder: Path, **changes: Any) -> RunReport:
    """Without worker processes, which cost seconds; the killed run has some."""
    return run_fake.make(folder, scheduler={"backend": "serial"}, **changes)


@pytest.fixture(scope="module", autouse=True)
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with s3_server(tmp_path_factory.mktemp("copies")) as url:
        yield url


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same dataset in a folder."""
    folder = tmp_path_factory.mktemp("local") / "dataset"
    make(folder)
    return folder


@pytest.fixture(params=["s3", "memory"])
def url(request: pytest.FixtureRequest, bucket: str, tmp_path: Path) -> str:
    name = f"data-{tmp_path.name}"
    places = {"s3": bucket, "memory": "memory://sonar"}
    return f"{places[request.param]}/{name}"


@pytest.mark.slow
def test_a_dataset_on_a_storage_is_that_of_a_folder(url: str, local: Path) -> None:
    assert make(folder_of(url)).samples == 32
    actual = contents(url)
    assert {name: actual[name] for name in actual if "/" in name} == shard_bytes(local)
    local_names = {path.name for path in local.iterdir() if path.is_file()}
    assert {name for name in actual if "/" not in name} == local_names - {"status.json"}
    for name in ("manifest.json", "README.md", "failed.jsonl"):
        assert (name in actual) == (local / name).exists()
    assert actual["manifest.json"] == (local / "manifest.json").read_bytes()
    shutil.rmtree(folder_of(url))
    with PairDataset(url) as pairs, PairDataset(local) as expected:
        assert not list(pairs.folder.glob("t*/*.h5")), "nothing is fetched before it is asked for"
        assert len(pairs) == len(expected) == 24
        np.testing.assert_array_equal(pairs[17]["noisy"], expected[17]["noisy"])
        assert len(list(pairs.folder.glob("t*/*.h5"))) == 1
        unpickled = pickle.loads(pickle.dumps(pairs))
        np.testing.assert_array_equal(unpickled[3:9]["clean"], expected[3:9]["clean"])
    report = validate(local_folder(url, fresh=True), deep=True)
    assert not [line for line in report.findings if "1 location(s)" not in line]
    again = make(folder_of(url))
    assert (again.reused_shards, again.samples) == (4, 32)


def test_what_is_damaged_or_missing_there_is_made_again(bucket: str, local: Path) -> None:
    url = f"{bucket}/damaged"
    make(folder_of(url))
    store = Store(url)
    store.remove("train/shard-00001.h5")
    content = bytearray(shards_of(url)["train/shard-00000.h5"])
    content[-100] ^= 1
    store.put("train/shard-00000.h5", bytes(content))
    assert make(folder_of(url)).reused_shards == 2
    assert shards_of(url) == shard_bytes(local)


@pytest.mark.slow
def test_a_killed_run_goes_on_on_another_machine(bucket: str, local: Path, tmp_path: Path) -> None:
    url = f"{bucket}/killed"
    code = (
        "import sys; from tests.run_fake import make; from tests.fake_source import FakeConfig\n"
        "from simnfnd.factory.dataset.storage import folder_of\n"
        "make(folder_of(sys.argv[1]), FakeConfig(delay_s=0.2))"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, url], cwd=ROOT, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 60
    # Without its result, which follows it, a shard is made again.
    while not any(name.endswith(".json") and "/" in name for name in contents(url)):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    process.send_signal(signal.SIGKILL)
    process.wait(20)
    assert ".lock" in contents(url)
    assert 1 <= len(shards_of(url)) < 4
    # Another machine has no copy.
    with mock.patch.dict(os.environ, {"SIMNFND_CLOUD_CACHE": str(tmp_path / "copies")}):
        report = make(folder_of(url))
        assert report.samples == 32
        assert report.reused_shards >= 1
        left = {name for name in contents(url) if name.startswith(".")}
    assert left == set()
    assert shards_of(url) == shard_bytes(local)
    assert manifest_of(url).keys() == shard_bytes(local).keys()


def test_two_runs_do_not_write_at_once(bucket: str) -> None:
    url = f"{bucket}/two"
    store = Store(url)
    with publishing(folder_of(url)) as first:
        assert first is not None
        with pytest.raises(FactoryError, match="process"):
            make(folder_of(url))
        part = "0-of-2"
        slice_of_it = publishing(folder_of(url, part), part)
        with pytest.raises(FactoryError, match="is being written"), slice_of_it:
            pass
        assert contents(url).keys() == {".lock"}
        # Taken over while it was suspended: it writes no more, and leaves the other's lock alone.
        theirs = contents(url)[".lock"].replace(first.token.encode(), b"0" * 32)
        store.put(".lock", theirs)
    assert contents(url) == {".lock": theirs}


def test_the_lock_goes_with_its_run_though_a_beat_is_under_way(
    bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"{bucket}/beat"
    begun = threading.Event()
    put = Store.put

    def slow(self: Store, name: str, content: bytes) -> None:
        begun.set()
        time.sleep(0.5)
        put(self, name, content)

    monkeypatch.setattr("simnfnd.factory.production.scheduler.lock._BEAT_S", 0.01)
    with publishing(folder_of(url)):
        monkeypatch.setattr(Store, "put", slow)
        assert begun.wait(30)
    time.sleep(0.6)
    assert ".lock" not in contents(url)


def test_a_run_that_lost_its_url_writes_no_more(bucket: str, monkeypatch: Any) -> None:
    url = f"{bucket}/lost"
    put = Store.put

    def steal(self: Store, name: str, content: bytes) -> None:
        put(self, name, content)
        if name.startswith("train/"):
            put(self, ".lock", b'{"token": "another", "pid": 1, "host": "elsewhere"}')

    monkeypatch.setattr(Store, "put", steal)
    with pytest.raises(FactoryError, match="another run"):
        make(folder_of(url))
    assert [name for name in contents(url) if name.startswith("train/")] == ["train/shard-00000.h5"]
    assert "another" in contents(url)[".lock"].decode()


def test_slices_make_one_dataset(bucket: str, local: Path) -> None:
    url = f"{bucket}/slices"
    for index in range(2):
        part = ShardSlice(index, 2)
        make(folder_of(url, part.part), shard=part)
    report = make(folder_of(url))
    assert (report.reused_shards, report.samples) == (4, 32)
    assert shards_of(url) == shard_bytes(local)
    assert not [name for name in contents(url) if "-of-" in name]


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("s3://sonar/none", "holds no manifest.json"),
        ("s3://no-such-bucket/data", "cannot be read"),
        ("nonsense://sonar/data", "fsspec knows no nonsense://|Protocol not known"),
        ("gcs://sonar/data", "Please install gcsfs"),
        ("file:///data", "mount it, give a folder"),
        ("simplecache::s3://sonar/data", "no such folder"),
    ],
)
def test_urls_that_are_none_are_one_line(bucket: str, url: str, why: str) -> None:
    with pytest.raises(FactoryError, match=why) as actual:
        PairDataset(url)
    assert "\n" not in str(actual.value)


def test_a_url_with_other_files_is_left_alone(bucket: str) -> None:
    url = f"{bucket}/foreign"
    Store(url).put("holiday.jpg", b"1")
    with pytest.raises(FactoryError, match=r"holiday\.jpg"):
        make(folder_of(url))
    assert contents(url) == {"holiday.jpg": b"1"}


def test_a_folder_cannot_pass_for_a_copy(local: Path, tmp_path: Path) -> None:
    """A stranger's dataset must not send us to places of its choice."""
    folder = Path(shutil.copytree(local, tmp_path / "stranger"))
    (folder / ".origin").write_text("s3://sonar/two")
    assert url_of(folder) is None
    (folder / "train/shard-00000.h5").unlink()
    with pytest.raises(FactoryError, match=r"manifest.*absent"):
        PairDataset(folder)


def test_a_storage_without_conditions_is_refused(monkeypatch: Any) -> None:
    monkeypatch.setattr(Store, "create", lambda self, name, content: True)
    with pytest.raises(FactoryError, match="overwrites"):
        make(folder_of("memory://sonar/unconditional"))


def test_workers_that_share_no_folder_prepare_and_put(
    bucket: str, tmp_path: Path, monkeypatch: Any
) -> None:
    config = FakeConfig(prepared=str(tmp_path / "prepared"), bad=("reef/alpha/0003",))
    options = {"source": GentleSource, "preparer": FakePreparer, "config": config}
    make(tmp_path / "dataset", **options)
    shutil.rmtree(tmp_path / "prepared")
    url = f"{bucket}/is_remote"
    monkeypatch.setattr(
        run, "publishing", lambda folder, part, is_remote: publishing(folder, part, is_remote=True)
    )
    report = make(folder_of(url), **options)
    assert [failure.ref.name for failure in report.failures] == ["reef/alpha/0003"]
    assert shards_of(url) == shard_bytes(tmp_path / "dataset")
    assert not [name for name in contents(url) if name.startswith(".")]


@pytest.mark.parametrize("verb", ["status", "merge", "view"])
def test_verbs_that_need_files_say_so(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    more = ["--out", "x"] if verb == "merge" else []
    assert main([verb, "s3://sonar/data", *more]) == 2
    assert "works on files of this machine" in capsys.readouterr().err


SHARDS = 12
PAIRS = 3
WINDOW = 2


@pytest.fixture(scope="module")
def dozen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of a dozen shards of two scenes in a folder."""
    folder = tmp_path_factory.mktemp("local") / "dozen"
    pairs = some_pairs(SHARDS * PAIRS - PAIRS) + some_pairs(PAIRS, "gamma")
    shards = {
        f"train/shard-{number:05d}.h5": pairs[number * PAIRS :][:PAIRS] for number in range(SHARDS)
    }
    write_all(folder, shards, PROVENANCE)
    return folder


@pytest.fixture
def far(dozen: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The same at memory://, with an empty place for copies."""
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE", str(tmp_path / "copies"))
    import fsspec

    system = fsspec.filesystem("memory")
    for path in (dozen / "manifest.json", *dozen.glob("train/*.h5")):
        system.pipe(f"/once/{path.relative_to(dozen).as_posix()}", path.read_bytes())
    yield "memory://once"
    system.rm("/once", recursive=True)


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often the storage was asked for each shard."""
    actual = Counter[str]()
    plain = Store.get

    def get(self: Store, name: str) -> Any:
        content = plain(self, name)
        if name.endswith(".h5") and name != "index.h5":
            actual[name] += 1
            time.sleep(0.01)  # as long as others need to ask for it, too
        return content

    monkeypatch.setattr(Store, "get", get)
    return actual


def keep(monkeypatch: pytest.MonkeyPatch, dozen: Path, shards: float) -> None:
    """Room for so many shards."""
    size = max(path.stat().st_size for path in dozen.glob("train/*.h5"))
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE_BYTES", str(int(shards * size)))


# One shard; all.
@pytest.mark.parametrize("room", [1, 50])
def test_shuffled_fetches_each_shard_once_an_epoch(
    dozen: Path, far: str, requests: Counter[str], monkeypatch: pytest.MonkeyPatch, room: float
) -> None:
    keep(monkeypatch, dozen, room)
    with PairDataset(far) as distant, PairDataset(dozen) as near:
        for epoch in range(2):
            actual = [pair["noisy"].tobytes() for pair in distant.shuffled(3, epoch, window=WINDOW)]
            wanted = [pair["noisy"].tobytes() for pair in near.shuffled(3, epoch, window=WINDOW)]
            assert actual == wanted
            assert sorted(actual) == sorted(pair["noisy"].tobytes() for pair in near)
            remaining = sum(path.stat().st_size for path in distant.folder.glob("t*/*.h5"))
            assert remaining <= int(os.environ["SIMNFND_CLOUD_CACHE_BYTES"])
            assert max(requests.values()) <= epoch + 1
    assert len(requests) == SHARDS


def test_a_limit_that_is_no_number_is_one_line(far: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMNFND_CLOUD_CACHE_BYTES", "10 GB")
    with (
        PairDataset(far) as pairs,
        pytest.raises(FactoryError, match="SIMNFND_CLOUD_CACHE_BYTES=10 GB"),
    ):
        pairs[0]
