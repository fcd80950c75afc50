"""Several trainings of a campaign at the same time, and how all of them end."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from simnfnd.evaluation.campaign.execute import Campaign
from simnfnd.evaluation.campaign.processes import Processes
from tests.evaluation.campaign.campaign_programs import Programs, settings

ROWS = (
    "rows=[{name: a, cpu_s: 20.5, words: ['model=nafnet'], seeds: [0, 1]},"
    "{name: b, cpu_s: 10.5, words: []}, {name: c, cpu_s: 10.5, words: []}]"
)
WAIT_S = 30


def is_training(verb: str, words: Sequence[str]) -> bool:
    return verb == "train" and "resume=false" not in words


class Together(Programs):
    """Trainings meet in twos, and the one into `loses` fails; notes who runs beside whom."""

    def __init__(self, *, loses: str = "") -> None:
        super().__init__()
        self.loses = loses
        self.meeting, self.count = threading.Barrier(2), threading.Lock()
        self.running: list[str] = []
        self.most = 0
        self.beside_others: list[str] = []

    def __call__(self, verb: str, words: Sequence[str], threads: int) -> tuple[int, float]:
        with self.count:
            self.running.append(verb)
            self.most = max(self.most, len(self.running))
            if len(self.running) > 1:
                self.beside_others += self.running
        try:
            if is_training(verb, words):
                self.meeting.wait(WAIT_S)
                if self.loses and any(self.loses in word for word in words):
                    return 2, 1.0
            elif verb == "train":
                # Long enough for another thread to measure the same, if nothing keeps it.
                time.sleep(0.2)
            return super().__call__(verb, words, threads)
        finally:
            with self.count:
                self.running.remove(verb)


def test_two_trainings_at_a_time_and_nothing_else(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    programs = Together()
    assert Campaign(settings(tmp_path, ROWS, "jobs=2"), programs)() == 0
    assert programs.most == 2
    assert set(programs.beside_others) == {"train"}, "data, tuning and reports run alone"
    kinds = [verb for verb, _ in programs.asked]
    last = len(kinds) - 1 - kinds[::-1].index("train")
    assert set(kinds[last + 1 :]) == {"evaluate", "campaign"}, "reports begin when all are trained"
    trained = [words for verb, words in programs.asked if is_training(verb, words)]
    assert len(trained) == 4
    lines = [line for line in capsys.readouterr().out.splitlines() if "train-" in line]
    names = ("train-a-s0", "train-a-s1", "train-b-s0", "train-c-s0")
    before = kinds.index("train")
    assert sorted(lines) == sorted(
        f"campaign: {number}/{before + 4} {name}" for number, name in enumerate(names, before + 1)
    )
    # Each record has the CPU seconds of its own training, not of those beside it.
    for words in trained:
        given = dict(word.split("=", 1) for word in words if "=" in word)
        name = Path(given["out"].strip("'")).name
        record = json.loads((tmp_path / "steps" / f"train-{name}.json").read_text())
        assert record["code"] == 0
        assert record["words"] == list(words)
        assert 2.1 < record["cpu_s"] - 0.01 * int(given["train.steps"]) < 3.2


def test_seeds_at_the_same_time_share_one_measured_pace(tmp_path: Path) -> None:
    programs = Together()
    assert Campaign(settings(tmp_path, ROWS, "jobs=2", "only=['train-a-*']"), programs)() == 0
    paces = [words for verb, words in programs.asked if not is_training(verb, words)]
    paces = [words for words in paces if "resume=false" in words]
    lengths = [[word for word in words if word.startswith("train.")] for words in paces]
    assert len(lengths) >= 2
    assert all(lengths.count(length) == 1 for length in lengths), "nothing is measured twice"
    trained = [words for verb, words in programs.asked if is_training(verb, words)]
    first, second = ([w for w in words if w.startswith("train.")] for words in trained)
    assert first == second


def test_a_failed_training_loses_only_itself(tmp_path: Path) -> None:
    programs = Together(loses="models/b-s0")
    campaign = Campaign(settings(tmp_path, ROWS, "jobs=2"), programs)
    assert campaign() == 1
    assert campaign.failed == ["train-b-s0"]
    assert programs.stopped == []
    reports = programs.steps("evaluate")
    assert any("a-s0" in word and "a-s1" in word and "c-s0" in word for word in reports)
    assert not any("b-s0" in word for word in reports)


class Ended(Programs):
    """The second training of two is ended with `code`, or ends us with `number`."""

    def __init__(self, *, code: int = 0, number: int = 0) -> None:
        super().__init__()
        self.code, self.number = code, number
        self.meeting, self.end = threading.Barrier(2), threading.Event()

    def __call__(self, verb: str, words: Sequence[str], threads: int) -> tuple[int, float]:
        done = super().__call__(verb, words, threads)
        if not is_training(verb, words):
            return done
        if self.meeting.wait(WAIT_S) == 0:
            if self.code:
                return self.code, 1.0
            os.kill(os.getpid(), self.number)
        return (-signal.SIGTERM, 1.0) if self.end.wait(WAIT_S) else (0, 1.0)

    def stop(self, *, signalled: bool) -> None:
        super().stop(signalled=signalled)
        self.end.set()


@pytest.mark.parametrize("code", [-signal.SIGKILL, 128 + signal.SIGINT])
def test_an_interrupted_training_stops_the_others(tmp_path: Path, code: int) -> None:
    programs = Ended(code=code)
    with pytest.raises(KeyboardInterrupt):
        Campaign(settings(tmp_path, ROWS, "jobs=2"), programs)()
    assert programs.stopped == [False]
    begun = [words for verb, words in programs.asked if is_training(verb, words)]
    assert len(begun) == 2, "nothing more is begun"
    records = [json.loads(path.read_text()) for path in tmp_path.glob("steps/train-*.json")]
    assert sorted(record["code"] for record in records) == sorted([code, -signal.SIGTERM])
    rest = Programs()
    assert Campaign(settings(tmp_path, ROWS, "jobs=2"), rest)() == 0
    assert len([words for p, words in rest.asked if is_training(p, words)]) == 4


@pytest.mark.parametrize(
    ("number", "signalled"),
    [(signal.SIGINT, True), (signal.SIGTERM, False)],
    ids=["ctrl-c", "kill"],
)
def test_an_interrupted_campaign_stops_its_trainings(
    tmp_path: Path, number: int, signalled: bool
) -> None:
    programs = Ended(number=number)
    with pytest.raises(KeyboardInterrupt) as stopped:
        Campaign(settings(tmp_path, ROWS, "jobs=2"), programs)()
    assert getattr(stopped.value, "exit_code", None) == 128 + number
    assert programs.stopped == [signalled]
    assert len([words for p, words in programs.asked if is_training(p, words)]) == 2


def test_each_process_is_charged_for_itself_and_its_own() -> None:
    burn = "import time\nwhile time.process_time() < 1.5: pass"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {burn!r}])"
    programs = Processes("timeit")
    with ThreadPoolExecutor(2) as pool:
        busy = pool.submit(programs, "-n1", ["-r1", child], 1)
        idle = pool.submit(programs, "-n1", ["-r1", "pass"], 1)
    assert busy.result()[0] == idle.result()[0] == 0
    assert busy.result()[1] >= 1.5
    assert idle.result()[1] < 1.5
    assert programs("-n1", ["-r1", "raise ValueError"], 1)[0] == 1


def test_stopped_processes_end_and_none_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("simnfnd.evaluation.campaign.processes._PATIENCE_S", 2.0)
    deaf = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
    codes = {"listens": -signal.SIGTERM, "deaf": -signal.SIGKILL}
    programs = Processes("timeit")
    with ThreadPoolExecutor(2) as pool:
        running = {}
        for name in codes:
            first = deaf if name == "deaf" else ""
            file = str(tmp_path / name)
            code = f"{first}import time; open({file!r}, 'w').close(); time.sleep({WAIT_S})"
            running[name] = pool.submit(programs, "-n1", ["-r1", code], 1)
        while not all((tmp_path / name).exists() for name in codes):
            assert not any(one.done() for one in running.values())
            time.sleep(0.05)
        programs.stop(signalled=False)
    assert {name: one.result()[0] for name, one in running.items()} == codes
    with pytest.raises(KeyboardInterrupt):
        programs("-n1", ["-r1", "pass"], 1)
