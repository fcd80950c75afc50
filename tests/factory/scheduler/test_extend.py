"""`dataset.on_existing=extend`: more samples in the same folder, and what was there untouched."""

from __future__ import annotations

import json
import os
import signal
import zlib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.commands.merge import merge
from simnfnd.factory.dataset import PairDataset
from simnfnd.factory.dataset.validate import validate
from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.dataset.format.sample import Pair
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.read.source import open_source
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.scheduler.earlier import Earlier
from simnfnd.factory.scheduler.extend import plan_extension
from simnfnd.factory.scheduler.job import Job
from simnfnd.factory.scheduler.ledger import RunReport
from simnfnd.factory.scheduler.plan import plan_shards
from simnfnd.factory.scheduler.run import make_dataset
from simnfnd.factory.scheduler.settings import SchedulerSettings, ShardSlice
from tests.fake_source import FakeConfig, FakeSource, refs, rerun

NOISE = {"background": {"density": {"uniform": [0.1, 0.5]}}}


def make(
    directory: Path,
    train: int = 6,
    *,
    variants: int = 1,
    max_train: int | None = None,
    on_existing: Any = "extend",
    config: FakeConfig = FakeConfig(),  # noqa: B008
    shard: ShardSlice = ShardSlice(),  # noqa: B008
    source: type[FakeSource] = FakeSource,
    splits: Mapping[str, list[FrameRef]] | None = None,
    **changes: Any,
) -> RunReport:
    """`train` frames to train on and two to test, in shards of four samples."""
    frames = splits or {"train": refs(train), "test": refs(2, "beta")}
    how = (variants, 4, {"train": max_train})
    identity = {
        "noise": NOISE,
        "frames": {"limit": train, "variants": variants},
        "dataset": {"max_train": max_train},
        "frames_found": sorted(ref.name for refs_ in frames.values() for ref in refs_),
        **changes,
    }
    job = Job(
        directory,
        plan_shards(frames, *how),
        source=source,
        config=config,
        provenance=Provenance(identity, f"{hash_of(identity):016x}", "simnfnd test"),
        config_values=identity,
        dataset=DatasetSettings(dir=str(directory), preview_pairs=0, on_existing=on_existing),
        scheduler=SchedulerSettings(backend="serial", shard_size=4, backoff_s=0.01),
        rerun_command=rerun,
        shard=shard,
        extension=lambda earlier: plan_extension(frames, *how, earlier),
    )
    return make_dataset(job)


def hash_of(identity: dict[str, Any]) -> int:
    return zlib.crc32(json.dumps(identity, sort_keys=True).encode())


def shards(directory: Path) -> dict[str, bytes]:
    return {
        path.relative_to(directory).as_posix(): path.read_bytes()
        for path in sorted(directory.glob("*/*.h5"))
    }


def samples(directory: Path) -> dict[tuple[str, str, str, int], bytes]:
    """(split, scene, frame, variant) -> noisy picture."""
    found = {}
    for path in sorted(directory.glob("*/*.h5")):
        with h5py.File(path) as file:
            for row, noisy in zip(file["meta"][()], file["noisy"][()], strict=True):
                key = (path.parent.name, row["scene"].decode(), row["frame"].decode())
                found[(*key, int(row["variant"]))] = noisy.tobytes()
    return found


def sound(directory: Path) -> None:
    assert [str(error) for error in validate(directory, deep=True).errors] == []


def test_more_frames_go_into_new_shards_and_the_old_ones_stay(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    make(directory, 6)
    before = shards(directory)
    report = make(directory, 11)
    after = shards(directory)
    assert before.items() <= after.items()
    assert sorted(set(after) - set(before)) == ["train/shard-00002.h5", "train/shard-00003.h5"]
    assert (report.samples, report.kept) == (13, 3)
    make(tmp_path / "fresh", 11)
    assert samples(directory) == samples(tmp_path / "fresh")
    sound(directory)


def test_everybody_reads_an_extended_dataset(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    make(directory, 6)
    old = load_manifest(directory)
    make(directory, 11)
    new = load_manifest(directory)
    assert old is not None
    assert new is not None
    assert new.config_hash != old.config_hash
    assert {info.config_hash for info in new.shards.values()} == {
        old.config_hash,
        new.config_hash,
    }
    (part,) = new.config["extends"]
    assert (part["config_hash"], part["samples"]) == (old.config_hash, 8)
    assert part["frames"] == {"limit": 6, "variants": 1}
    assert "noise" not in part
    with PairDataset(directory) as pairs:
        assert (len(pairs), pairs.config_hash) == (11, new.config_hash)
    with h5py.File(directory / "index.h5") as index:
        assert index["train/noisy"].shape[0] == 11
    assert (
        f"extends a dataset of 8 pairs, config hash `{old.config_hash}`"
        in (directory / "README.md").read_text()
    )
    listed = (directory / "croissant.json").read_text()
    assert all(path in listed for path in new.shards)
    assert len(open_source(directory, "train").shards) == 4


def test_the_same_command_again_keeps_everything(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    make(directory, 6)
    make(directory, 11)
    manifest, files = (directory / "manifest.json").read_bytes(), shards(directory)
    for on_existing in ("extend", "resume"):
        assert make(directory, 11, on_existing=on_existing).kept == 5
        assert ((directory / "manifest.json").read_bytes(), shards(directory)) == (manifest, files)


def test_an_empty_folder_is_extended_from_nothing(tmp_path: Path) -> None:
    make(tmp_path / "dataset", 6)
    make(tmp_path / "plain", 6, on_existing="resume")
    assert shards(tmp_path / "dataset") == shards(tmp_path / "plain")
    assert not (tmp_path / "dataset/extended.json").exists()


def test_variants_and_limits_and_a_second_extension(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    make(directory, 10, max_train=3)
    first = shards(directory)
    make(directory, 10, max_train=7)
    second = shards(directory)
    assert len(samples(directory)) == 9
    make(directory, 10, variants=2)
    third = shards(directory)
    assert first.items() <= second.items() <= third.items()
    make(tmp_path / "fresh", 10, variants=2)
    assert samples(directory) == samples(tmp_path / "fresh")
    manifest = load_manifest(directory)
    assert manifest is not None
    assert [part["samples"] for part in manifest.config["extends"]] == [5, 4]
    sound(directory)


class Interrupting(FakeSource):
    """Stops the run, which is this very process, at one frame."""

    def pairs(self, ref: FrameRef, variants: tuple[int, ...]) -> list[Pair]:
        """Like every other frame, but for one."""
        if ref.frame == "0012":
            os.kill(os.getpid(), signal.SIGINT)
        return super().pairs(ref, variants)


def test_an_interrupted_extension_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    make(tmp_path / "calm", 6)
    make(tmp_path / "calm", 17)
    directory = tmp_path / "dataset"
    make(directory, 6)
    old = load_manifest(directory)
    with pytest.raises(KeyboardInterrupt):
        make(directory, 17, source=Interrupting)
    manifest = load_manifest(directory)
    assert old is not None
    assert manifest is not None
    assert len(old.shards) < len(manifest.shards) < 6
    with pytest.raises(FactoryError, match=r"another configuration .*on_existing=extend to add"):
        make(directory, 6, on_existing="resume")
    make(directory, 17, on_existing="resume")
    assert shards(directory) == shards(tmp_path / "calm")
    assert (directory / "manifest.json").read_bytes() == (
        tmp_path / "calm/manifest.json"
    ).read_bytes()
    sound(directory)


@pytest.mark.parametrize("last", ["extended.json", "manifest.json"])
def test_an_extension_killed_as_it_begins_has_changed_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: str
) -> None:
    """Killed before the file `last` is written."""
    directory = tmp_path / "dataset"
    make(directory, 6)
    manifest = (directory / "manifest.json").read_bytes()
    name = "save_earlier" if last == "extended.json" else "save_manifest"
    with monkeypatch.context() as patched:
        patched.setattr(f"simnfnd.factory.scheduler.extend.{name}", killed)
        with pytest.raises(MemoryError):
            make(directory, 11)
    assert (directory / "manifest.json").read_bytes() == manifest
    assert make(directory, 6, on_existing="resume").kept == 3
    make(directory, 11)
    make(tmp_path / "calm", 6)
    make(tmp_path / "calm", 11)
    assert shards(directory) == shards(tmp_path / "calm")


def killed(*_: object) -> None:
    raise MemoryError


def test_a_shard_of_before_that_is_damaged_later_is_made_again_as_it_was(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    make(directory, 6, config=FakeConfig(bad=("reef/alpha/0001",)))
    make(directory, 11, config=FakeConfig(bad=("reef/alpha/0001",)))
    before = shards(directory)
    (directory / "train/shard-00000.h5").unlink()
    with (directory / "test/shard-00000.h5").open("r+b") as file:
        file.write(b"damage")
    # Its bad frame is good by now, and goes with what was added.
    report = make(directory, 11)
    assert report.failures == ()
    after = shards(directory)
    assert {path for path in before if before[path] != after[path]} == {"train/shard-00002.h5"}
    make(tmp_path / "fresh", 11)
    assert samples(directory) == samples(tmp_path / "fresh")
    sound(directory)


def test_a_shard_that_is_damaged_already_gives_its_samples_to_new_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    directory = tmp_path / "dataset"
    make(directory, 6)
    with (directory / "train/shard-00000.h5").open("r+b") as file:
        file.write(b"damage")
    make(directory, 11)
    assert "its samples are made again" in capsys.readouterr().err
    make(tmp_path / "fresh", 11)
    assert samples(directory) == samples(tmp_path / "fresh")
    sound(directory)


def test_without_extended_json_the_shards_are_asked(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    make(directory, 6)
    make(directory, 11)
    before = shards(directory)
    for damage in (None, b"{", b'{"schema": "simnfnd/1", "config_hash": "other", "shards": []}'):
        (directory / "extended.json").unlink(missing_ok=True)
        if damage is not None:
            (directory / "extended.json").write_bytes(damage)
        assert make(directory, 11).kept == 5
        assert shards(directory) == before


def test_slices_of_before_are_taken_in(tmp_path: Path) -> None:
    directory = tmp_path / "dataset"
    with pytest.raises(KeyboardInterrupt):
        make(directory, 14, on_existing="resume", source=Interrupting)
    make(directory, 14, on_existing="resume", shard=ShardSlice(3, 4))
    before = shards(directory)
    assert len(before) == 4
    make(directory, 17)
    assert before.items() <= shards(directory).items()
    sound(directory)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"train": 5}, r"reef/alpha/0005: is in the dataset, but this configuration would not"),
        ({"noise": {"background": None}}, r"other settings \(noise\.background"),
        ({"sonar": {"beams": 3}}, r"sonar\.beams \(absent\) -> 3"),
        ({"train": 9, "max_train": 4}, r"dataset\.max_train=4: there are 6 train samples already"),
        (
            {"splits": {"train": refs(6), "test": [*refs(2, "beta")[:1], *refs(1, "gamma")]}},
            "reef/beta/0001: is in the dataset, but",
        ),
        (
            {"splits": {"train": refs(2, "beta"), "test": refs(6)}, "split": {"test": ["alpha"]}},
            r"reef/beta: is in test of the dataset and would now be in train; .*split\.test=",
        ),
        ({"shard": ShardSlice(0, 2)}, "extended as a whole"),
    ],
)
def test_what_would_not_only_add_is_refused_and_changes_nothing(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    directory = tmp_path / "dataset"
    make(directory, 6)
    before = {path: path.read_bytes() for path in directory.rglob("*") if path.is_file()}
    with pytest.raises(FactoryError, match=said) as caught:
        make(directory, **changes)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in directory.rglob("*") if path.is_file()} == before


def test_fewer_variants_are_refused(tmp_path: Path) -> None:
    make(tmp_path, 3, variants=3)
    with pytest.raises(FactoryError, match=r"frames\.variants=2: there is variant 2 of reef/beta"):
        make(tmp_path, 9, variants=2)


def test_merged_and_extended_datasets_go_together_where_they_can(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    make(one, 4)
    make(one, 6)
    make(two, splits={"train": refs(3, "gamma"), "test": refs(2, "delta")})
    merged = merge([one, two], tmp_path / "both")
    assert merged.samples() == 13
    sound(tmp_path / "both")
    with pytest.raises(FactoryError, match="was merged of several datasets; extend those"):
        make(tmp_path / "both", 20)


def test_extend_needs_a_folder() -> None:
    with pytest.raises(ValueError, match="on_existing=extend needs dir"):
        DatasetSettings(on_existing="extend")


@given(
    first=st.integers(1, 12),
    more=st.integers(0, 12),
    variants=st.tuples(st.integers(1, 5), st.integers(0, 3)),
    size=st.tuples(st.integers(1, 7), st.integers(1, 7)),
    limit=st.none() | st.integers(0, 60),
    made=st.integers(0, 255),
)
def test_a_plan_holds_what_was_there_and_every_sample_once(
    first: int,
    more: int,
    variants: tuple[int, int],
    size: tuple[int, int],
    limit: int | None,
    made: int,
) -> None:
    """made: bits that say which of the first shards were finished."""
    start = plan_shards({"train": refs(first)}, variants[0], size[0])
    earlier = [
        Earlier(task.path, task.items, "0") for n, task in enumerate(start) if made >> (n % 8) & 1
    ]
    there = sum(shard.task.samples for shard in earlier)
    everything, most = refs(first + more), first + more
    if limit is not None:
        limit = max(limit, there)
    how = ({"train": everything}, sum(variants), size[1], {"train": limit})
    tasks = plan_extension(*how, earlier)
    assert tasks == plan_extension(*how, earlier)
    assert [task.digest for task in tasks[: len(earlier)]] == [s.task.digest for s in earlier]
    names = [(ref.name, v) for task in tasks for ref, numbers in task.items for v in numbers]
    assert len(set(names)) == len(names)
    assert len({task.path for task in tasks}) == len(tasks)
    assert all(1 <= task.samples <= size[1] for task in tasks[len(earlier) :])
    whole = most * sum(variants)
    assert len(names) == (whole if limit is None else min(limit, whole))


def test_a_limit_spreads_what_is_added() -> None:
    tasks = plan_extension({"train": refs(100)}, 1, 100, {"train": 10}, ())
    numbers = [int(ref.frame) for ref, _ in tasks[0].items]
    assert numbers == sorted(numbers)
    gaps = [after - before for before, after in pairwise(numbers)]
    assert max(gaps) <= 16
