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
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from simnfnd.evaluation.campaign import table
from simnfnd.evaluation.campaign.execute import Campaign
from simnfnd.evaluation.campaign.plan import Folders, training_steps
from simnfnd.evaluation.campaign.trainings import write_trainings
from simnfnd.evaluation.report.content import SCHEMA as REPORT_SCHEMA
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.scheduler.lock import Lock
from simnfnd.factory.settings import build
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import save_weights
from tests.evaluation.campaign.campaign_programs import ROWS, TINY, Programs, settings

LENGTH = ("train.steps=", "train.check_every=")


def test_every_row_of_the_configuration_is_one_that_models_accepts(tmp_path: Path) -> None:
    from simnfnd.models.settings import ModelsSettings

    chosen = settings(tmp_path, "data.flsea=x", "data.mdd=y")
    for row in chosen.rows:
        kind = "renders" if row.data == "simnfnd" else row.data
        more = [f"data={kind}", *(["data.folder=x"] if kind != "renders" else [])]
        with initialize_config_module("simnfnd.conf", version_base="1.3"):
            values: Any = OmegaConf.to_container(
                compose("models", [*more, *chosen.words, *row.words]), resolve=True
            )
        built: ModelsSettings = build(ModelsSettings, values)
        build_network(built.model)
    assert {"simnfnd_l1", "simnfnd_newloss", "olddata_l1"} <= {row.name for row in chosen.rows}
    held = next(word for word in chosen.words if word.startswith("data.validation="))
    renders = 0
    for places in (chosen.data.train, chosen.data.sparse):
        assert places is not None
        training = places.locations - round(float(held.partition("=")[2]) * places.locations)
        assert training >= 60
        renders += training * places.frames
    assert renders * 0.995 >= 4000


def test_a_budget_becomes_steps_and_stays_so(tmp_path: Path) -> None:
    programs = Programs()
    assert Campaign(settings(tmp_path, ROWS, "checks=10", "jobs=1"), programs)() == 0
    trained = [words for verb, words in programs.asked if verb == "train"]
    whole = [words for words in trained if not any("pace" in word for word in words)]
    lengths = [
        {w.split("=")[0]: int(w.split("=")[1]) for w in words if w.startswith(LENGTH)}
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
    again = Programs()
    Campaign(settings(tmp_path, ROWS, "checks=10", "jobs=1"), again)()
    (words,) = [words for verb, words in again.asked if verb == "train"]
    assert [word for word in words if word.startswith(LENGTH)] == [
        word for word in whole[1] if word.startswith(LENGTH)
    ]


def test_a_second_run_does_only_what_is_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    programs = Programs(fails="seed=1")
    assert Campaign(settings(tmp_path, ROWS), programs)() == 1
    assert "failed: train-a-s1" in capsys.readouterr().out
    reports = [words for verb, words in programs.asked if words[0].startswith("dataset.dir")]
    assert any("models/a-s0" in word and "b-s0" in word for word in reports[-1])
    assert not any("a-s1" in word for word in reports[-1])
    rest = Programs()
    assert Campaign(settings(tmp_path, ROWS), rest)() == 0
    assert [verb for verb, _ in rest.asked] == ["train", *["evaluate"] * 6, "campaign"]
    assert any("a-s1" in word for word in rest.asked[1][1]), "new weights, new reports"
    nothing = Programs()
    assert Campaign(settings(tmp_path, ROWS), nothing)() == 0
    assert nothing.asked == []
    record = json.loads((tmp_path / "campaign.json").read_text(encoding="utf-8"))
    assert record["trainings"] == [
        {"row": row, "seed": seed, "folder": f"models/{row}-s{seed}", "label": f"{row}-s{seed}"}
        for row, seed in (("a", 0), ("a", 1), ("b", 0))
    ]
    only = Programs()
    longer = ("data.test.locations=17", "only=['data-*']")
    assert Campaign(settings(tmp_path, ROWS, *longer), only)() == 0
    assert len(only.asked) == 1
    Campaign(settings(tmp_path, ROWS)).show()
    shown = capsys.readouterr().out.splitlines()
    assert any(line.startswith("done   train-a-s1: simnfnd train ") for line in shown)


def test_a_row_goes_on_from_the_weights_of_another(tmp_path: Path) -> None:
    rows = (
        "rows=[{name: later, steps: 100, checks: 5, start: first, seeds: [0, 1, 7], words: []},"
        "{name: first, cpu_s: 20.5, places: sparse, seeds: [0, 1], words: []}]"
    )
    programs = Programs()
    assert Campaign(settings(tmp_path, rows, "checks=10", "data.pack=small"), programs)() == 0
    trained = [words for verb, words in programs.asked if verb == "train"]
    later = [words for words in trained if any("models/later" in word for word in words)]
    # Its start is there before it begins, although it stands first in the list.
    assert trained[-3:] == later
    begun = [next(word for word in words if word.startswith("start=")) for words in later]
    weights = "start='{}/models/first-s{}/weights.safetensors'"
    assert sorted(begun) == sorted(weights.format(tmp_path, seed) for seed in (0, 1, 0))
    assert all({"train.steps=100", "train.check_every=20"} <= set(words) for words in later)
    assert any(word.endswith("train.pack'") for word in later[0])
    first = next(words for words in trained if any("models/first" in word for word in words))
    assert any(word.endswith("sparse.pack'") for word in first)
    again = Programs()
    (tmp_path / "models" / "first-s1" / "weights.safetensors").write_bytes(b"other weights")
    only = "only=['train-*']"
    assert Campaign(settings(tmp_path, rows, "data.pack=small", only), again)() == 0
    (words,) = [words for _, words in again.asked]
    assert {"seed=1", "resume=false"} <= set(words), "what went on from them, and afresh"
    assert Campaign(settings(tmp_path, rows, "data.pack=small", only), again)() == 0
    assert len(again.asked) == 1
    with pytest.raises(FactoryError, match="start must name a row that comes to an end"):
        settings(tmp_path, "rows=[{name: a, steps: 1, start: b, words: []}]")
    with pytest.raises(FactoryError, match="a: give it cpu_s or steps"):
        settings(tmp_path, "rows=[{name: a, words: []}]")
    sparse = "rows=[{name: a, steps: 1, places: sparse, words: []}]"
    with pytest.raises(FactoryError, match=r"a needs data\.sparse"):
        settings(tmp_path, sparse, "data.sparse=null")
    wide = settings(tmp_path, sparse.replace("sparse", "wide"))
    assert any("data/wide" in word for word in next(training_steps(wide)).words)


def test_one_campaign_a_folder(tmp_path: Path) -> None:
    programs = Programs()
    with Lock(tmp_path), pytest.raises(FactoryError, match="another campaign is at work"):
        Campaign(settings(tmp_path, ROWS), programs)()
    assert programs.asked == []


def test_a_row_that_cannot_be_trained_does_not_stop_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    programs = Programs(fails="model=nafnet")
    assert Campaign(settings(tmp_path, ROWS), programs)() == 1
    said = capsys.readouterr()
    assert "a cannot be trained" in said.err
    assert "failed: train-a-s0, train-a-s1" in said.out
    assert "b-s0" in " ".join(programs.steps("evaluate"))


def test_odd_campaigns_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="test shares locations with what is learned"):
        settings(tmp_path, "data.test.first=1010")
    with pytest.raises(FactoryError, match="checks shares locations with what is learned"):
        settings(tmp_path, "data.checks.first=2000")
    with pytest.raises(FactoryError, match="a is there twice with other words"):
        settings(tmp_path, "rows=[{name: a, cpu_s: 1, words: []}, {name: a, cpu_s: 2, words: []}]")
    with pytest.raises(FactoryError, match="a has seed 0 twice"):
        settings(tmp_path, "rows=[{name: a, cpu_s: 1, words: []}, {name: a, cpu_s: 1, words: []}]")
    with pytest.raises(FactoryError, match="holds no report of a campaign"):
        table.read_sets(tmp_path, [])


def results(folder: Path, psnr: dict[str, list[float]], networks: Sequence[str]) -> None:
    """The files of a report with these PSNR values of four pairs of two frames."""
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
    rows = [
        {
            "label": label,
            "kind": "network" if label in networks else "baseline",
            "levels": {"gain": 1, "offset": 0} if "levels" in label else None,
        }
        for label in psnr
    ]
    content = json.dumps({"schema": REPORT_SCHEMA, "rows": rows})
    (folder / "report.json").write_text(content, encoding="utf-8")


def test_the_table_says_gain_margin_and_what_came_out_worse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    networks = ("net-s0", "net-s1", "other-s2", "with + levels")
    results(
        tmp_path / "reports" / "procedural",
        {
            "noisy": [17, 17, 19, 19],
            "median": [25, 25, 25, 25],
            "median + levels": [18, 18, 20, 20],
            "median tuned + levels": [19, 19, 20, 20],
            "net-s0": [24, 24, 25, 18],
            "net-s1": [26, 26, 27, 20],
            "other-s2": [60, 60, 60, 60],
            "with + levels": [50, 50, 50, 50],
        },
        networks,
    )
    zero: dict[str, list[float]] = {"noisy": [100] * 4, "net-s0": [40, 41, 42, 39]}
    results(tmp_path / "reports" / "zero", zero, networks)
    for seed in (0, 1):
        folder = tmp_path / "models" / f"net-s{seed}"
        folder.mkdir(parents=True)
        save_weights(folder / "weights.safetensors", build_network(TINY), TINY, {})
    with pytest.raises(FactoryError, match=r"campaign\.json: absent or damaged; run `simnfnd"):
        table.campaign([str(tmp_path)])
    write_trainings(Folders(tmp_path), [("net", 0), ("net", 1)])
    assert table.campaign([str(tmp_path)]) == 0
    content = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))
    found = content["sets"]["procedural"]
    assert list(found["rows"]) == ["noisy", "median tuned + levels", "net"], "rows by record"
    assert found["best_classical"] == "median tuned + levels"
    row = found["rows"]["net"]
    assert row["seeds"] == 2
    assert row["psnr"]["mean"] == pytest.approx(23.75)
    assert row["gain_db"]["mean"] == pytest.approx(5.75)
    assert row["margin_db"]["mean"] == pytest.approx(4.25)
    assert row["seed_spread_db"] == pytest.approx(2)
    assert (row["worse"], row["images"]) == (1, 8)
    assert row["worst_gain_db"] == pytest.approx(-1)
    check = content["checks"]["zero"]["rows"]["net"]
    assert (check["lowest_psnr"], check["worse"]) == (39, 4)
    assert content["costs"]["net"]["gmac"] > 0
    text = (tmp_path / "table.md").read_text(encoding="utf-8")
    assert "| net | 2 | 23.75 (" in text
    assert "1 of 8" in text
    assert (tmp_path / "table.png").stat().st_size > 5000
    capsys.readouterr()
