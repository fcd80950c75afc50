"""`simnfnd evaluate`: from a dataset folder to the files of the report."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation import runner
from simnfnd.evaluation.compare import read_results
from simnfnd.evaluation.methods import NOISY, Method, baselines_of, methods_of
from simnfnd.evaluation.metrics import fidelity as metrics
from simnfnd.evaluation.metrics.measure import Picture, Scene, sector_of
from simnfnd.evaluation.pairs import items_of, picture
from simnfnd.evaluation.report import build as builder
from simnfnd.evaluation.runner import STORE_NAME, Measured, Task, measure_task
from simnfnd.factory.errors import FactoryError
from tests.evaluation.evaluation_settings import measured, settings_for
from tests.small_dataset import fan_images, write_dataset

FILES = {"report.html", "report.json", "report.md", "results.csv", STORE_NAME}
METRICS = ("psnr", "ssim", "gmsd", "psnr_fan", "shadow_iou", "shadow_residual")
MEDIAN = Method("median", "", {"size": 3})
GAUSSIAN = Method("gaussian", "", {"sigma_px": 1.0})


def assert_same(one: Measured, other: Measured) -> None:
    columns = ["method", "picture", *METRICS]
    assert one.table()[columns].equals(other.table()[columns])


def test_one_command_writes_the_whole_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    dataset = write_dataset(tmp_path / "data", train=16, test=6, size=48)
    out = tmp_path / "report"
    words = (f"dataset={dataset}", f"out={out}", "baselines=[median]", "tuning.pairs=2",
             "workers=1", "models=[]", f"tuning.file={tmp_path / 'tuned.json'}")  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["evaluation"])
    assert main(["evaluate", *words]) == 0
    assert "+ levels (size=" in capsys.readouterr().out, "the best form of the median"
    assert {path.name for path in out.iterdir()} == FILES
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"data", "report", "tuned.json"}, "Hydra left litter"

    # The figures are those of the images in the shards, taken one by one.
    expected = []
    for path in sorted((dataset / "test").glob("*.h5")):
        with h5py.File(path) as file:
            expected += [
                metrics.psnr(clean, noisy, data_range=255)
                for clean, noisy in zip(file["clean"], file["noisy"], strict=True)
            ]
    results = read_results(out)
    noisy = results["method"] == "noisy"
    assert results["psnr"][noisy].to_numpy() == pytest.approx(expected, rel=1e-6)
    assert set(results["method"]) == {
        "noisy", "median", "median + levels", "median tuned", "median tuned + levels",
    }  # fmt: skip
    content = json.loads((out / "report.json").read_text(encoding="utf-8"))
    row = next(row for row in content["rows"] if row["label"] == "noisy")
    psnr = row["metrics"]["psnr"]
    assert psnr["mean"] == pytest.approx(np.mean(expected))
    assert psnr["low"] < psnr["mean"] < psnr["high"]
    assert (content["facts"]["pairs"], content["facts"]["frames"]) == (6, 3)
    assert content["best_classical"]["chosen_on"] == "validation pairs"
    levels = next(row for row in content["rows"] if row["label"] == "median + levels")
    assert levels["against_noisy"]["psnr"]["low"] > 0, "the haze is an offset"
    markdown = (out / "report.md").read_text(encoding="utf-8")
    assert "| Median | 17.76 / 0.690 / 0.190 |" in markdown
    # One row a method, its other forms below.
    first, _, more = markdown.partition("## All 5 forms")
    assert first.count("| median") == 1
    assert more.partition("##")[0].count("| median") == 4


def test_a_report_goes_on_where_it_was_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = write_dataset(tmp_path / "data", train=0, test=9, size=48)
    whole = measured(dataset, [MEDIAN, GAUSSIAN], tmp_path / "whole")
    tasks: list[Task] = []

    def stopping(task: Task) -> Any:
        tasks.append(task)
        if len(tasks) == 2:
            raise KeyboardInterrupt
        return measure_task(task)

    monkeypatch.setattr(runner, "measure_task", stopping)
    with pytest.raises(KeyboardInterrupt):
        measured(dataset, [MEDIAN, GAUSSIAN], tmp_path / "out")
    # A crash may cut a line in two.
    with (tmp_path / "out" / STORE_NAME).open("a", encoding="utf-8") as file:
        file.write('{"method": "x", "pictures": ["a"')
    again = measured(dataset, [MEDIAN, GAUSSIAN], tmp_path / "out")
    assert [len(task.subjects) for task in tasks[2:]] == [4, 1], "the first four were known"
    assert_same(again, whole)
    # Known rows are read, a new one is measured alone.
    tasks[:] = [tasks[0]] * 2
    more = [MEDIAN, Method("grey_opening", "", {"size": 3})]
    measured(dataset, more, tmp_path / "out")
    assert {method.name for task in tasks[2:] for method in task.methods} == {"grey_opening"}


def test_processes_do_not_change_the_figures(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=3, test=9, size=48, per_shard=5)
    alone, together = (
        measured(dataset, [MEDIAN], tmp_path / str(n), split="all", workers=n) for n in (1, 2)
    )
    assert_same(alone, together)
    items = items_of(dataset, "all")
    assert len(items) == 12
    assert items[0].shard == "train/shard-00000.h5"
    assert items_of(dataset, "all", 5) == items[:5]


def killed_by_median(task: Task) -> Any:
    if any(method.name == "median" for method in task.methods):
        os.kill(os.getpid(), signal.SIGKILL)
    return measure_task(task)


@pytest.mark.skipif(os.name == "nt", reason="there is no SIGKILL")
def test_a_killed_worker_costs_the_row_of_its_method_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = write_dataset(tmp_path / "data", train=0, test=2, size=48)
    monkeypatch.setattr(runner, "measure_task", killed_by_median)
    found = measured(dataset, [MEDIAN, GAUSSIAN], tmp_path / "out", workers=2)
    assert set(found.lost) == {"median"}
    assert "SIGKILL" in found.lost["median"]
    monkeypatch.undo()
    assert_same(found, measured(dataset, [GAUSSIAN], tmp_path / "other"))
    assert not measured(dataset, [MEDIAN], tmp_path / "out").lost, "the next run tries again"


def test_the_sector_leaves_out_what_the_sonar_cannot_see() -> None:
    noisy, clean, shadow = fan_images(64, np.random.default_rng(1))
    sector = sector_of(noisy, clean, shadow)
    scene = Scene(Picture(noisy, clean, shadow, sector))
    scores = scene.figures(noisy)
    share = sector.mean()
    assert 0.2 < share < 0.8
    # Outside all is 0 in both images: it adds 10 log10(1/share) dB to the full frame.
    assert scores["psnr"] - scores["psnr_fan"] == pytest.approx(-10 * math.log10(share))
    assert scores["ssim_fan"] < scores["ssim"]


def test_out_that_cannot_be_written(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=0, test=2, size=48)
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(FactoryError, match=r"out: cannot write"):
        builder.build(settings_for(dataset, out=str(tmp_path / "file" / "x")))


def test_identical_pairs_have_a_stated_rule(tmp_path: Path) -> None:
    item, *_ = items_of(write_dataset(tmp_path / "data", train=0, test=2, size=48), "test")
    figures = item.measure(picture(item.place).clean)
    assert figures["psnr"] == metrics.PSNR_CAP_DB
    assert figures["ssim"] == pytest.approx(1)


def test_rows_are_named_once() -> None:
    methods = methods_of(baselines_of(["fast", "median", "paper"]), {})
    labels = [method.label for method in methods]
    assert labels == ["noisy", "median", "gaussian", "bilateral", "nlm", "grey_opening", "bm3d"]
    assert methods[0] == NOISY
    keys = {method.key for method in (MEDIAN, GAUSSIAN, Method("median", "", {"size": 5}))}
    assert len(keys) == 3


def test_somebodys_denoised_pictures_are_a_row(tmp_path: Path) -> None:
    """By the names of `export --to png`, PNG or .npy; equal pictures give equal figures."""
    dataset = write_dataset(tmp_path / "data", train=2, test=5, size=48, per_shard=3)
    items = items_of(dataset, "test")
    mine, arrays = tmp_path / "mine", tmp_path / "arrays"
    for folder in (mine / "test" / "noisy", arrays):
        folder.mkdir(parents=True)
    for number, item in enumerate(items):
        noisy = np.rint(picture(item.place).noisy * 255).astype(np.uint8)
        cv2.imwrite(str(mine / "test" / "noisy" / f"{number:06d}.png"), cv2.medianBlur(noisy, 3))
        np.save(arrays / f"{number:06d}.npy", noisy / 255)
    given = [{"name": "mine", "dir": str(mine)}, {"name": "arrays", "dir": str(arrays)}]
    content = builder.build(settings_for(dataset, pictures=given))
    rows_ = {row["label"]: row for row in content["rows"]}
    assert rows_["mine"]["kind"] == "pictures"
    assert rows_["mine"]["milliseconds"] is None
    for name in ("psnr", "ssim", "gmsd"):
        assert rows_["mine"]["metrics"][name] == rows_["median"]["metrics"][name]
        assert rows_["arrays"]["metrics"][name] == rows_["noisy"]["metrics"][name]
    assert "psnr" in rows_["mine"]["against_best"]
    for array, said in (
        (np.full((48, 48), 9.0), "floats must be grey values from 0 to 1"),
        (np.zeros((48, 40)), "test/noisy/000002: 40x48 pixels, but its pair has 48x48"),
    ):
        np.save(arrays / "000002.npy", array)
        rows = builder.build(settings_for(dataset, pictures=given[1:]))["rows"]
        assert said in rows[-1]["lost"]
    cases: list[tuple[dict[str, str], str]] = [
        ({"name": "mine", "dir": "nowhere"}, "mine: nowhere: 5 of 5 pictures are missing"),
        ({"name": "median", "dir": str(mine)}, "median: another row has this name"),
    ]
    for one, words in cases:
        with pytest.raises(FactoryError, match=words):
            builder.build(settings_for(dataset, pictures=[one]))
    (mine / "test" / "noisy" / "000001.png").unlink()
    with pytest.raises(FactoryError, match=r"1 of 5 pictures are missing, the first is test/noisy"):
        builder.build(settings_for(dataset, pictures=given))
