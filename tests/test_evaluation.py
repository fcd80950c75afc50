"""`python -m evaluation`: from a dataset folder to the table beside the paper's."""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from evaluation import measure, metrics, statistics, summary
from factory.errors import FactoryError
from factory.sample import Pair
from factory.settings import build
from factory.shards.reader import open_shard, shard_paths
from tests.small_dataset import add_shard, fan_images, write_dataset, write_manifest

ROOT = Path(__file__).parents[1]


def settings_for(dataset: Path, **changes: object) -> measure.EvaluationSettings:
    values: dict[str, object] = {
        "dataset": {"dir": str(dataset)},
        "split": "test",
        "out": None,
        "workers": 1,
        "limit": None,
        "shadow_threshold": 0.02,
        "bootstrap": 200,
        "seed": 0,
        "debug": False,
    }
    return build(measure.EvaluationSettings, {**values, **changes})


def evaluation(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "evaluation", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def test_the_command_writes_the_report(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=0, test=6, size=48)
    done = evaluation(f"dataset={dataset}", f"out={tmp_path / 'report'}", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "| PSNR, dB |" in done.stdout
    assert "17.64" in done.stdout
    names = {path.name for path in (tmp_path / "report").iterdir()}
    assert names == {"metrics.csv", "summary.json", "summary.md", "summary.png"}
    assert {path.name for path in tmp_path.iterdir()} == {"data", "report"}, "Hydra left litter"

    # The figures are those of the images in the shards, taken one by one.
    expected = []
    for path in sorted((dataset / "test").glob("*.h5")):
        with h5py.File(path) as file:
            expected += [
                metrics.psnr(clean, noisy, data_range=255)
                for clean, noisy in zip(file["clean"], file["noisy"], strict=True)
            ]
    with (tmp_path / "report" / "metrics.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["psnr"]) for row in rows] == expected
    content = json.loads((tmp_path / "report" / "summary.json").read_text(encoding="utf-8"))
    psnr = content["metrics"]["psnr"]
    assert psnr["mean"] == pytest.approx(np.mean(expected))
    assert psnr["low"] < psnr["mean"] < psnr["high"]
    assert (content["pairs"], content["frames"]) == (6, 3)


def test_processes_do_not_change_the_figures(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path, train=3, test=20, size=48, per_shard=9)
    alone = measure.measure(settings_for(dataset, split="all"))
    together = measure.measure(settings_for(dataset, split="all", workers=2))
    assert alone == together
    assert len(alone) == 23
    assert alone[0].shard == "train/shard-00000.h5"
    assert measure.measure(settings_for(dataset, split="all", limit=5)) == alone[:5]


def test_float_shards_measure_like_uint8_ones(tmp_path: Path) -> None:
    whole, unit = (
        measure.measure(settings_for(write_dataset(tmp_path / name, train=0, test=3, dtype=dtype)))
        for name, dtype in (("whole", "uint8"), ("unit", "float32"))
    )
    for one, other in zip(whole, unit, strict=True):
        for name in measure.METRICS:
            assert getattr(one.quality, name) == pytest.approx(
                getattr(other.quality, name), rel=0.02, abs=1e-3
            )


def test_noiseless_pairs_have_a_stated_rule(tmp_path: Path) -> None:
    _, clean, shadow = fan_images(48, np.random.default_rng(0))
    record: dict[str, float | int | str] = {
        "location": "",
        "scene": "s",
        "frame": "f",
        "variant": 0,
    }
    add_shard(tmp_path, "test/shard-00000.h5", [Pair(clean, clean, shadow, record)] * 2)
    settings = settings_for(tmp_path)
    scores = measure.measure(settings)
    assert scores[0].quality.psnr == math.inf
    assert scores[0].quality.shadow_iou == 1
    estimates = measure.summarise(scores, settings)
    assert estimates["psnr"].mean == metrics.PSNR_CAP_DB
    summary.write(tmp_path / "out", scores, estimates, settings)
    assert "identical pairs (2 here) count as 100 dB" in (tmp_path / "out/summary.md").read_text()


def test_the_sector_leaves_out_what_the_sonar_cannot_see() -> None:
    noisy, clean, shadow = fan_images(64, np.random.default_rng(1))
    sector = measure.sector_of(noisy, clean, shadow)
    scores = measure.score_pair(noisy, clean, shadow, data_range=1, shadow_threshold=0.02)
    share = sector.mean()
    assert 0.2 < share < 0.8
    # Outside all is 0 in both images: it adds 10 log10(1/share) dB to the full frame.
    assert scores.psnr - scores.psnr_fan == pytest.approx(-10 * math.log10(share))
    assert scores.ssim_fan < scores.ssim


def test_bootstrap_draws_frames_not_images() -> None:
    """Ten copies of each of four frames are four observations, not forty."""
    values = np.repeat([1.0, 2.0, 3.0, 4.0], 10)
    frames = [str(index // 10) for index in range(40)]
    together = statistics.estimate(values, frames, resamples=2000, seed=0)
    apart = statistics.estimate(values, [str(index) for index in range(40)], resamples=2000, seed=0)
    assert together.mean == apart.mean == 2.5
    assert together.high - together.low > 2.5 * (apart.high - apart.low)
    assert statistics.estimate(values, frames, resamples=2000, seed=0) == together


def test_bootstrap_interval_covers_the_mean() -> None:
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(200):
        values = rng.normal(5, 2, 40)
        item = statistics.estimate(values, [str(i) for i in range(40)], resamples=300, seed=1)
        hits += item.low <= 5 <= item.high
    assert 0.88 <= hits / 200 <= 0.99


def test_values_that_do_not_exist_are_left_out() -> None:
    item = statistics.estimate(np.array([1.0, np.nan, 3.0]), list("abc"), resamples=100, seed=0)
    assert (item.mean, item.count) == (2.0, 2)
    none = statistics.estimate(np.array([np.nan]), ["a"], resamples=100, seed=0)
    assert none.count == 0
    assert math.isnan(none.mean)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "dataset: give the folder"),
        (("dataset=nowhere",), "no such folder"),
        (("dataset=nowhere", "speed=1"), "Could not override 'speed'"),
        (("dataset=nowhere", "workers=0"), "workers: "),
        (("dataset=nowhere", "split=valid"), "split: Input should be 'train', 'test' or 'all'"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    done = evaluation(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_bad_datasets_are_named(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="no shards"):
        shard_paths(tmp_path, "test")
    dataset = write_dataset(tmp_path / "train only", train=4, test=0)
    with pytest.raises(FactoryError, match=r"test split is empty.*split=train"):
        shard_paths(dataset, "test")
    path = dataset / "train" / "shard-00000.h5"
    for name, words in (("schema", "schema 'other/9'"), ("clean", "/clean is absent")):
        with h5py.File(path, "r+") as file:
            if name == "schema":
                file.attrs["schema"] = "other/9"
            else:
                file.attrs["schema"] = "simnfnd/1"
                del file["clean"]
        with pytest.raises(FactoryError, match=words):
            open_shard(path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FactoryError, match="not a readable HDF5 file"):
        open_shard(path)
    path.unlink()
    with pytest.raises(FactoryError, match="absent"):
        open_shard(path)


def test_the_manifest_decides_which_shards_count(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path, train=8, test=4)
    write_manifest(dataset, "train/shard-00001.h5")
    assert [path.name for path in shard_paths(dataset, "all")] == ["shard-00001.h5"]
    (dataset / "manifest.json").write_text("{", encoding="utf-8")
    with pytest.raises(FactoryError, match="damaged"):
        shard_paths(dataset, "all")


def test_nan_in_a_shard_names_the_sample(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path, train=0, test=3, dtype="float32")
    with h5py.File(dataset / "test" / "shard-00000.h5", "r+") as file:
        file["noisy"][1, 5, 5] = np.nan
    with pytest.raises(FactoryError, match=r"shard-00000\.h5: sample 1: image has NaN"):
        measure.measure(settings_for(dataset))


def test_out_that_cannot_be_written(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=0, test=2, size=48)
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    settings = settings_for(dataset)
    scores = measure.measure(settings)
    with pytest.raises(FactoryError, match=r"out=.*cannot write"):
        summary.write(
            tmp_path / "file" / "x", scores, measure.summarise(scores, settings), settings
        )
