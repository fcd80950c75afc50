"""The training campaign: its plan, what it does again and what not, and its table."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from evaluation import campaign as table
from factory.errors import FactoryError
from factory.scheduler.lock import Lock
from factory.settings import build
from models import build_network
from models.campaign.execute import Campaign
from models.campaign.settings import CampaignSettings
from models.weights import save_weights

TINY = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 0, "decoder": [1]}
ROWS = (
    "rows=[{name: a, cpu_s: 20.5, words: ['model=nafnet'], seeds: [0, 1]},"
    "{name: b, cpu_s: 10.5, words: []}]"
)


def settings(out: Path, *words: str) -> CampaignSettings:
    with initialize_config_module("conf", version_base="1.3"):
        values: Any = OmegaConf.to_container(compose("campaign", [f"out='{out}'", *words]))
    result: CampaignSettings = build(CampaignSettings, values)
    return result


class Programs:
    """Instead of the three programs: notes what is asked, and leaves behind what they would."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, fails: str = "") -> None:
        self.asked: list[tuple[str, tuple[str, ...]]] = []
        self.fails, self.cpu_s = fails, 0.0
        monkeypatch.setattr("models.campaign.execute._children_cpu_s", lambda: self.cpu_s)

    def __call__(self, program: str, words: Sequence[str], threads: int) -> int:
        self.asked.append((program, tuple(words)))
        given = dict(word.split("=", 1) for word in words if "=" in word)
        # 10 ms a step; coming and going takes longer, and not always the same time.
        coming = (3.0, 2.2, 3.1)[len(self.asked) % 3] if program == "models" else 3.0
        self.cpu_s += coming + 0.01 * int(given.get("train.steps", 0))
        if self.fails and any(self.fails in word for word in words):
            return 2
        if program == "models":
            out = Path(given["out"].strip("'"))
            out.mkdir(parents=True, exist_ok=True)
            torch.manual_seed(int(given["seed"]))
            save_weights(out / "weights.safetensors", build_network(TINY), TINY, {})
        return 0

    def steps(self, program: str) -> list[str]:
        return [word for p, words in self.asked for word in words if p == program]


def test_every_row_of_the_configuration_is_one_that_models_accepts(tmp_path: Path) -> None:
    from models.settings import ModelsSettings

    chosen = settings(tmp_path, "data.flsea=x", "data.mdd=y")
    for row in chosen.rows:
        more = ["data=olddata", "data.folder=x"] if row.data == "olddata" else ["data=renders"]
        with initialize_config_module("conf", version_base="1.3"):
            values: Any = OmegaConf.to_container(
                compose("models", [*more, *chosen.words, *row.words]), resolve=True
            )
        built: ModelsSettings = build(ModelsSettings, values)
        build_network(built.model)
    assert {"simnfnd_l1", "simnfnd_newloss", "olddata_l1"} == {row.name for row in chosen.rows[:3]}
    first = chosen.data.train
    assert first.locations * 0.9 >= 60
    assert first.locations * first.frames * 0.9 * 0.999 >= 3800


def test_a_budget_becomes_steps_and_stays_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs = Programs(monkeypatch)
    assert Campaign(settings(tmp_path, ROWS, "checks=10"), programs)() == 0
    trained = [words for program, words in programs.asked if program == "models"]
    whole = [words for words in trained if not any("pace" in word for word in words)]
    lengths = [
        {w.split("=")[0]: int(w.split("=")[1]) for w in words if w.startswith("train.")}
        for words in whole
    ]
    assert len(whole) == 3
    assert lengths[0] == lengths[1], "one pace a row"
    assert all(one["train.steps"] == 10 * one["train.check_every"] for one in lengths)
    # 20.5 s at about 10 ms a step, and 10.5 s.
    assert 1700 <= lengths[0]["train.steps"] <= 2300
    assert 850 <= lengths[2]["train.steps"] <= 1150
    # Another day the machine is slower: what was measured counts.
    (tmp_path / "steps" / "train-a-s1.json").unlink()
    again = Programs(monkeypatch)
    Campaign(settings(tmp_path, ROWS, "checks=10"), again)()
    (words,) = [words for program, words in again.asked if program == "models"]
    assert [word for word in words if word.startswith("train.")] == [
        word for word in whole[1] if word.startswith("train.")
    ]


def test_a_second_run_does_only_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    programs = Programs(monkeypatch, fails="seed=1")
    assert Campaign(settings(tmp_path, ROWS), programs)() == 1
    assert "failed: train-a-s1" in capsys.readouterr().out
    reports = [words for program, words in programs.asked if words[0].startswith("dataset.dir")]
    assert any("models/a-s0" in word and "b-s0" in word for word in reports[-1])
    assert not any("a-s1" in word for word in reports[-1])
    rest = Programs(monkeypatch)
    assert Campaign(settings(tmp_path, ROWS), rest)() == 0
    assert [program for program, _ in rest.asked] == ["models", *["evaluation"] * 7]
    assert any("a-s1" in word for word in rest.asked[1][1]), "new weights, new reports"
    nothing = Programs(monkeypatch)
    assert Campaign(settings(tmp_path, ROWS), nothing)() == 0
    assert nothing.asked == []
    only = Programs(monkeypatch)
    longer = ("data.test.locations=17", "only=['data-*']")
    assert Campaign(settings(tmp_path, ROWS, *longer), only)() == 0
    assert len(only.asked) == 1
    Campaign(settings(tmp_path, ROWS)).show()
    shown = capsys.readouterr().out.splitlines()
    assert any(line.startswith("done   train-a-s1: python -m models ") for line in shown)


def test_one_campaign_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    programs = Programs(monkeypatch)
    with Lock(tmp_path), pytest.raises(FactoryError, match="another campaign is at work"):
        Campaign(settings(tmp_path, ROWS), programs)()
    assert programs.asked == []


def test_a_row_that_cannot_be_trained_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    programs = Programs(monkeypatch, fails="model=nafnet")
    assert Campaign(settings(tmp_path, ROWS), programs)() == 1
    said = capsys.readouterr()
    assert "a cannot be trained" in said.err
    assert "failed: train-a-s0, train-a-s1" in said.out
    assert "b-s0" in " ".join(programs.steps("evaluation"))


def test_odd_campaigns_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="train and test share locations"):
        settings(tmp_path, "data.test.first=1010")
    with pytest.raises(FactoryError, match="a is there twice with other words"):
        settings(tmp_path, "rows=[{name: a, cpu_s: 1, words: []}, {name: a, cpu_s: 2, words: []}]")
    with pytest.raises(FactoryError, match="a has seed 0 twice"):
        settings(tmp_path, "rows=[{name: a, cpu_s: 1, words: []}, {name: a, cpu_s: 1, words: []}]")
    with pytest.raises(FactoryError, match="holds no report of a campaign"):
        table.read_sets(tmp_path)


def results(folder: Path, psnr: dict[str, list[float]]) -> None:
    """A report's results.parquet with these PSNR values of four pairs of two frames."""
    count = 4
    labels = [label for label in psnr for _ in range(count)]
    columns: dict[str, Any] = {
        "method": labels,
        "pair": [0, 1, 2, 3] * len(psnr),
        "location": ["l"] * len(labels),
        "scene": ["s"] * len(labels),
        "frame": ["1", "1", "2", "2"] * len(psnr),
        "psnr": np.concatenate([np.asarray(values, float) for values in psnr.values()]),
    }
    for name in ("ssim", "gmsd", "shadow_iou"):
        columns[name] = np.full(len(labels), 0.5)
    folder.mkdir(parents=True)
    pq.write_table(pa.table(columns), folder / "results.parquet")


def test_the_table_says_gain_margin_and_what_came_out_worse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results(
        tmp_path / "reports" / "procedural",
        {
            "noisy": [17, 17, 19, 19],
            "median": [25, 25, 25, 25],
            "median + levels": [18, 18, 20, 20],
            "median tuned + levels": [19, 19, 20, 20],
            "net-s0": [24, 24, 25, 18],
            "net-s1": [26, 26, 27, 20],
        },
    )
    results(tmp_path / "reports" / "zero", {"noisy": [100] * 4, "net-s0": [40, 41, 42, 39]})
    for seed in (0, 1):
        folder = tmp_path / "models" / f"net-s{seed}"
        folder.mkdir(parents=True)
        save_weights(folder / "weights.safetensors", build_network(TINY), TINY, {})
    assert table.campaign([str(tmp_path)]) == 0
    content = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))
    found = content["sets"]["procedural"]
    assert found["best_classical"] == "median tuned + levels"
    row = found["rows"]["net"]
    assert row["seeds"] == 2
    assert row["psnr"]["mean"] == pytest.approx(23.75)
    assert row["gain_db"]["mean"] == pytest.approx(5.75)
    assert row["margin_db"]["mean"] == pytest.approx(4.25)
    assert row["seed_spread_db"] == pytest.approx(2)
    assert (row["worse"], row["images"]) == (1, 8)
    assert row["worst_gain_db"] == pytest.approx(-1)
    zero = content["checks"]["zero"]["rows"]["net"]
    assert (zero["lowest_psnr"], zero["worse"]) == (39, 4)
    assert content["costs"]["net"]["gmac"] > 0
    text = (tmp_path / "table.md").read_text(encoding="utf-8")
    assert "| net | 2 | 23.75 (" in text
    assert "1 of 8" in text
    assert (tmp_path / "table.png").stat().st_size > 5000
    capsys.readouterr()
