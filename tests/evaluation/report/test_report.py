"""What the figures say together: tests, the paper's tables, comparisons."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from simnfnd.command import main
from simnfnd.evaluation.compare import compare, read_results
from simnfnd.evaluation.methods import NOISY, Method
from simnfnd.evaluation.metrics import statistics
from simnfnd.evaluation.pairs import Item
from simnfnd.evaluation.report import build as builder
from simnfnd.evaluation.report.content import best_classical, content_of
from simnfnd.evaluation.runner import SECONDS, Measured
from tests.evaluation.evaluation_settings import settings_for
from tests.small_dataset import write_dataset


def test_bootstrap_draws_frames_not_images() -> None:
    """Ten copies of each of four frames are four observations, not forty."""
    values = np.repeat([1.0, 2.0, 3.0, 4.0], 10)
    frames = [str(index // 10) for index in range(40)]
    together = statistics.estimate(values, frames, resamples=2000, seed=0)
    apart = statistics.estimate(values, [str(index) for index in range(40)], resamples=2000, seed=0)
    assert together.mean == apart.mean == 2.5
    assert together.high - together.low > 2.5 * (apart.high - apart.low)
    assert statistics.estimate(values, frames, resamples=2000, seed=0) == together


def test_the_paired_test_sees_frames() -> None:
    rng = np.random.default_rng(1)
    base = rng.normal(20, 3, 24)
    shift = np.repeat(rng.normal(0.4, 0.5, 12), 2)
    groups = [str(index // 2) for index in range(24)]
    found = statistics.paired(base + shift, base, groups, better=1, resamples=200, seed=0)
    assert found.difference.mean == pytest.approx(shift.mean())
    assert found.p == pytest.approx(stats.wilcoxon(shift[::2]).pvalue)
    assert found.wins == pytest.approx((shift > 0).mean())
    low_is_good = statistics.paired(base + shift, base, groups, better=-1, resamples=200, seed=0)
    assert low_is_good.wins == pytest.approx(1 - found.wins)
    same = statistics.paired(base, base, groups, better=1, resamples=200, seed=0)
    assert (same.p, same.wins, same.difference.mean) == (1.0, 0.5, 0.0)
    base[0] = np.nan
    found = statistics.paired(base + shift, base, groups, better=1, resamples=200, seed=0)
    assert found.difference.count == 23, "values that do not exist are left out"


def test_holm_is_the_published_procedure() -> None:
    """Worked by hand: the smallest p times 4, the next times 3, ..., never decreasing."""
    found = statistics.holm([0.01, 0.04, 0.03, 0.005, float("nan")])
    assert found[:4] == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert math.isnan(found[4])
    assert statistics.holm([0.9, 0.8]) == [1.0, 1.0]


def measured_of(**psnr: Any) -> Measured:
    """Figures of methods by label; the other metrics follow from the PSNR."""
    figures = {
        label: {
            number: {"psnr": one, "ssim": one / 30, "gmsd": 0.4 - one / 100, SECONDS: 0.005}
            for number, one in enumerate(values)
        }
        for label, values in psnr.items()
    }
    return Measured(figures)


def items(count: int, scenes: int = 2) -> list[Item]:
    return [
        Item("s", ("s", n), "test", n, str(n), "", f"scene-{n % scenes}", str(n), 0)
        for n in range(count)
    ]


def test_networks_are_held_against_the_best_tuned_baseline(tmp_path: Path) -> None:
    """Which baseline that is, validation says: on the test pairs another one is ahead."""
    base = np.linspace(15, 20, 12)
    measured = measured_of(**{
        "noisy": base,
        "median + levels": base + 1,
        "nlm + levels": base + 1.5,
        "net": base + 3 + np.sin(np.arange(12)),
    })  # fmt: skip
    measured.lost["broken"] = "no luck"
    methods = [
        NOISY,
        Method("median", "+ levels", {}),
        Method("nlm", "+ levels", {}),
        Method("net", "", {}, weights="net.safetensors"),
        Method("broken", "", {}),
    ]
    point = {"psnr_levels": 18.0}
    tuned = {
        "median": {"default": point, "tuned_levels": point},
        "nlm": {"default": {"psnr_levels": 17.0}, "tuned_levels": {"psnr_levels": 17.0}},
    }
    settings = settings_for(tmp_path / "data")
    content = content_of(methods, measured, items(12), settings, tuned)
    assert content["best_classical"] == {"row": "median + levels", "chosen_on": "validation pairs"}
    assert [row["label"] for row in content["rows"]] == [
        "net", "nlm + levels", "median + levels", "noisy", "broken",
    ]  # fmt: skip
    net = content["rows"][0]
    assert net["against_best"]["psnr"]["mean"] == pytest.approx(2 + np.sin(np.arange(12)).mean())
    assert net["against_noisy"]["psnr"]["p_holm"] < 0.01
    assert net["against_noisy"]["gmsd"]["wins"] == 1, "low is good"
    json.dumps(content, allow_nan=False)
    assert best_classical(content["rows"], {}) == ("nlm + levels", "these very pairs")


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Two reports on the same twelve frames, and one on others."""
    root = tmp_path_factory.mktemp("reports")
    dataset = write_dataset(root / "data", train=0, test=24, size=40, per_shard=24)
    other = write_dataset(root / "louder", train=0, test=4, size=40, noise=0.4)
    a, b, c = (root / name for name in "abc")
    builder.build(settings_for(dataset, out=str(a), baselines=["grey_opening"], examples=1))
    builder.build(settings_for(dataset, out=str(b), baselines=["gaussian"], examples=1))
    builder.build(settings_for(other, out=str(c), baselines=[], examples=0))
    return a, b, c


def test_compare_says_which_is_better(
    reports: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    a, b, _ = reports
    assert main(["evaluate", "compare", str(a), str(b), "--row-b", "noisy"]) == 0
    said = capsys.readouterr().out
    assert "A = grey_opening (a), B = noisy (b): 24 pairs of 12 frames" in said
    content = compare(a, b, None, "noisy")
    one, other = read_results(a), read_results(b)
    first = one["psnr"][one["method"] == "grey_opening"].to_numpy()
    second = other["psnr"][other["method"] == "noisy"].to_numpy()
    psnr = content["metrics"]["psnr"]
    assert psnr["difference"] == pytest.approx((first - second).mean())
    assert psnr["wins"] == pytest.approx((first > second).mean())
    assert psnr["verdict"] == "better"
    assert main(["evaluate", "compare", str(a), str(a)]) == 0
    assert "no difference shown" in capsys.readouterr().out


def test_compare_refuses_what_cannot_be_compared(
    reports: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    a, b, c = reports
    (tmp_path / "results.csv").write_text("method,psnr\nnoisy,17\n")
    for words, said in (
        ((str(a), str(c)), "different pairs, none in common"),
        ((str(a), "nowhere"), "no report here"),
        ((str(a), str(tmp_path)), "damaged"),
        ((str(a), str(b), "--row-a", "wiener"), "no row 'wiener'; it has noisy, grey_opening"),
        ((str(a),), "the following arguments are required: B"),
    ):
        assert main(["evaluate", "compare", *words]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


def test_the_network_that_ships_has_a_row(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=6, test=3, size=32)
    settings = settings_for(
        dataset, out=str(tmp_path / "out"), models="auto", tuning={"auto": True}, bootstrap=100
    )
    content = builder.build(settings)
    assert len(content["rows"]) == 6  # noisy, median in four forms, the network
    (network,) = [row for row in content["rows"] if row["kind"] == "network"]
    assert network["name"].removesuffix("-paper") == "simnfnd"
    assert network["lost"] is None
