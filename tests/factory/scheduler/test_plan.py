"""The parts of a run: the plan of shards, the crew, deaths that are counted."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.scheduler.loop import Pending
from simnfnd.factory.scheduler.plan import plan_shards
from simnfnd.factory.scheduler.settings import MAX_AUTO_WORKERS, Crew, SchedulerSettings
from simnfnd.factory.settings import build
from tests.fake_source import refs
from tests.project_files import ROOT

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


# --- parts ------------------------------------------------------------------------------------


def test_settings_file_states_the_defaults() -> None:
    stated = yaml.safe_load((ROOT / "conf/scheduler/local.yaml").read_text())
    assert build(SchedulerSettings, stated) == SchedulerSettings()
    assert set(stated) == set(SchedulerSettings.__dataclass_fields__)


def test_crew_follows_cores_memory_and_work(monkeypatch: pytest.MonkeyPatch) -> None:
    from simnfnd.factory.scheduler import settings as module

    def machine(cores: int, memory_gb: float) -> None:
        monkeypatch.setattr(module, "usable_cores", lambda: cores)
        monkeypatch.setattr(module, "available_memory_bytes", lambda: int(memory_gb * 1e9))

    auto = SchedulerSettings()
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
    assert SchedulerSettings(workers=48).crew(4, 16) == Crew(2, 14)
    assert SchedulerSettings(workers=48, render_workers=5).crew(100, 99) == Crew(5, 43)
    machine(8, 0)
    assert auto.crew(1000, 9000) == Crew(1, 0)
    assert auto.crew(1000, 0) == Crew(0, 1)
    assert SchedulerSettings(workers=7).crew(1000, 0) == Crew(0, 7)


@given(deaths=st.lists(st.none() | st.integers(0, 4)), retries=st.integers(0, 3))
def test_deaths_of_a_shard_come_to_an_end(deaths: list[int | None], retries: int) -> None:
    frames = refs(5)
    shard = Pending(frames, retries, "train/shard-00000.h5")
    happened = 0  # deaths before this one; those of a frame that is given up do not happen
    for count, in_hand in enumerate(deaths):
        given_up = {failure.ref.frame for failure in shard.given_up.values()}
        if in_hand is not None and frames[in_hand].frame in given_up:
            continue  # is never in hand again
        again = shard.died(in_hand, "crash", "killed")
        assert happened <= 6 * (retries + 1)
        happened += 1
        if not again:
            assert len(shard.given_up) == 5
            between = deaths[: count + 1].count(None) == retries + 1
            assert between or {*range(5)} <= {*deaths[: count + 1]}
            return
    for index, ref in enumerate(frames):
        named = ref.frame in {failure.ref.frame for failure in shard.given_up.values()}
        assert named == (deaths.count(index) > retries)
