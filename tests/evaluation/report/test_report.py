"""What the figures say together, and the page: tests, breakdowns, comparisons, moving objects."""

from __future__ import annotations

import html
import json
import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from simnfnd.command import main
from simnfnd.evaluation.filters import REGISTRY
from simnfnd.evaluation.judging.methods import NOISY, Method
from simnfnd.evaluation.judging.pairs import JudgedPair
from simnfnd.evaluation.judging.runner import SECONDS, Measured
from simnfnd.evaluation.metrics import statistics
from simnfnd.evaluation.metrics.measure import METRICS
from simnfnd.evaluation.report import build as builder
from simnfnd.evaluation.report import tables
from simnfnd.evaluation.report.compare import compare, read_results
from simnfnd.evaluation.report.content import best_classical, content_of
from tests.evaluation.evaluation_settings import BROKEN, settings_for
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


def test_a_shadow_column_that_tells_no_rows_apart_is_left_out() -> None:
    def row(name: str, overlap: float) -> dict[str, Any]:
        figures = {"psnr": 20.0, "ssim": 0.5, "shadow_iou": overlap}
        metrics = {
            key: {"mean": value, "low": None, "high": None, "count": 4}
            for key, value in figures.items()
        }
        common: dict[str, Any] = {
            "lost": None,
            "parameters": [],
            "against_noisy": {},
            "cpu_s": 0.001,
        }
        return {"label": name, "metrics": metrics, **common}

    label = METRICS["shadow_iou"].label
    assert label not in tables.leaderboard([row("noisy", 0.0), row("median", 0.0003)]).columns
    assert label in tables.leaderboard([row("noisy", 0.0), row("median", 0.3)]).columns


def test_the_paired_test_sees_frames() -> None:
    rng = np.random.default_rng(1)
    base = rng.normal(20, 3, 24)
    shift = np.repeat(rng.normal(0.4, 0.5, 12), 2)
    groups = [str(index // 2) for index in range(24)]
    actual = statistics.paired(base + shift, base, groups, better=1, resamples=200, seed=0)
    assert actual.difference.mean == pytest.approx(shift.mean())
    assert actual.p == pytest.approx(stats.wilcoxon(shift[::2]).pvalue)
    assert actual.wins == pytest.approx((shift > 0).mean())
    same = statistics.paired(base, base, groups, better=1, resamples=200, seed=0)
    assert (same.p, same.wins, same.difference.mean) == (1.0, 0.5, 0.0)
    base[0] = np.nan
    actual = statistics.paired(base + shift, base, groups, better=1, resamples=200, seed=0)
    assert actual.difference.count == 23, "values that do not exist are left out"


def test_holm_is_the_published_procedure() -> None:
    """Worked by hand: the smallest p times 4, the next times 3, ..., never decreasing."""
    actual = statistics.holm([0.01, 0.04, 0.03, 0.005, float("nan")])
    assert actual[:4] == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert math.isnan(actual[4])
    assert statistics.holm([0.9, 0.8]) == [1.0, 1.0]


def measured_of(**psnr: Any) -> Measured:
    """Figures of methods by label; the other metrics follow from the PSNR."""
    figures = {
        label: {
            number: {
                "psnr": psnr_db,
                "ssim": psnr_db / 30,
                "gmsd": 0.4 - psnr_db / 100,
                SECONDS: 0.005,
            }
            for number, psnr_db in enumerate(values)
        }
        for label, values in psnr.items()
    }
    return Measured(figures)


def items(count: int, scenes: int = 2) -> list[JudgedPair]:
    return [
        JudgedPair("s", ("s", n), "test", n, str(n), "", f"scene-{n % scenes}", str(n), 0)
        for n in range(count)
    ]


@pytest.mark.slow
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
    louder = write_dataset(root / "louder", train=0, test=4, size=40, noise=0.4)
    a, b, c = (root / name for name in "abc")
    rows = ["grey_opening", "gaussian", "broken"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(REGISTRY, "broken", BROKEN)
        builder.build(settings_for(dataset, out=str(a), baselines=rows, examples=1))
    builder.build(settings_for(dataset, out=str(b), baselines=[], examples=0))
    builder.build(settings_for(louder, out=str(c), baselines=[], examples=0))
    return a, b, c


@pytest.mark.slow
def test_compare_says_which_is_better(
    reports: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    a, b, _ = reports
    words = ("--row-a", "grey_opening", "--row-b", "noisy")
    assert main(["evaluate", "compare", str(a), str(b), *words]) == 0
    said = capsys.readouterr().out
    assert "A = grey_opening (a), B = noisy (b): 24 pairs of 12 frames" in said
    content = compare(a, b, "grey_opening", "noisy")
    first_results = read_results(a)
    second_results = read_results(b)
    first = first_results["psnr"][first_results["method"] == "grey_opening"].to_numpy()
    second = second_results["psnr"][second_results["method"] == "noisy"].to_numpy()
    psnr = content["metrics"]["psnr"]
    assert psnr["mean"] == pytest.approx((first - second).mean())
    assert psnr["wins"] == pytest.approx((first > second).mean())
    assert psnr["verdict"] == "better"
    assert main(["evaluate", "compare", str(a), str(a)]) == 0
    assert "no difference shown" in capsys.readouterr().out


def test_reports_on_real_images_are_tabulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def row(label: str, psnr_db: float, kind: str = "baseline") -> dict[str, Any]:
        metrics = {"psnr": {"mean": psnr_db}, "ssim": {"mean": 0.7}}
        return {"label": label, "kind": kind, "lost": None, "metrics": metrics}

    for name, offset in (("aris", 0.0), ("lamprey", 4.0)):
        rows = [row("noisy", 25 + offset), row("tv tuned on others", 29 + offset)]
        rows.append(row(f"outputs/{name}/both", 29.5 + offset, kind="network"))
        best = {"psnr": "tv tuned on others"}
        report = {"name": name, "best_filter": best, "rows": rows}
        (tmp_path / name).mkdir()
        (tmp_path / name / "real.json").write_text(json.dumps(report), encoding="utf-8")
    folders = [str(tmp_path / name) for name in ("aris", "lamprey")]
    assert main(["evaluate", "compare", *folders]) == 0
    said = capsys.readouterr().out
    assert "| noisy | 25.00 / 0.700 | 29.00 / 0.700 |" in said
    assert "| best filter | 29.00 / 0.700 (tv) | 33.00 / 0.700 (tv) |" in said
    assert "| both | 29.50 / 0.700 | 33.50 / 0.700 |" in said
    (tmp_path / "aris" / "real.json").write_text("{}", encoding="utf-8")
    assert main(["evaluate", "compare", *folders]) == 2


def test_compare_refuses_what_cannot_be_compared(
    reports: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    a, b, c = reports
    (tmp_path / "results.csv").write_text("method,psnr\nnoisy,17\n")
    for words, said in (
        ((str(a), str(c)), "different pairs, none in common"),
        ((str(a), "nowhere"), "no report here"),
        ((str(a), str(tmp_path)), "damaged"),
        (
            (str(a), str(b), "--row-a", "wiener"),
            "no row 'wiener'; it has noisy, grey_",
        ),
        ((str(a),), "evaluate compare: 1 folders; give two reports"),
    ):
        assert main(["evaluate", "compare", *words]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


# --- the page ------------------------------------------------------------------------------------


def test_it_is_one_file_that_loads_no_other(reports: tuple[Path, Path, Path]) -> None:
    text = (reports[0] / builder.PAGE_NAME).read_text(encoding="utf-8")
    assert text.startswith("<!DOCTYPE html>")
    for word in ("http://", "https://", "//cdn", "@import"):
        assert word not in text
    assert not re.search(r"url\((?!#)", text), "parts of its own images alone"
    assert not re.search(r"<(script|img|link)[^>]+(src|href)=\"(?!data:)", text)


# What a reader does: sorts the board twice, moves the slider, zooms, compares, darkens.
READ = """<script>(async () => {
const page = window, at = (name) => document.querySelector(name);
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const board = at("table.board"), rows = () => [...board.tBodies[0].rows];
const names = () => rows().map((row) => row.cells[0].textContent);
const figures = (column) => rows().filter((row) => !row.classList.contains("lost"))
  .map((row) => Number.parseFloat(row.cells[column].textContent));
const heads = board.tHead.querySelectorAll("button"), before = names();
heads[1].click();
const down = figures(1), order = heads[1].parentElement.ariaSort;
heads[1].click();
while (!(at(".stage").dataset.painted >= 2)) await wait(20);
const clip = () => at(".layer.second").style.clipPath;
const middle = clip(), slider = at("#slider");
slider.value = 25; slider.dispatchEvent(new page.Event("input"));
const moved = clip();
const scale = () => at(".layer.second canvas").style.transform;
at("#closer").click(); const near = scale();
at("#whole").click(); const whole = scale();
const set = (id, value) => {
  at(id).value = value;
  at(id).dispatchEvent(new page.Event("change"));
};
set("#after", "clean"); set("#map", "error");
const sum = (side) => {
  const from = at(`.layer.${side} canvas`);
  const canvas = new OffscreenCanvas(from.width, from.height), context = canvas.getContext("2d");
  context.drawImage(from, 0, 0);
  const data = context.getImageData(0, 0, from.width, from.height).data;
  return data.reduce((all, value, i) => i % 4 === 3 ? all : all + value, 0);
};
while (sum("second") > 0) await wait(20);
const errors = [sum("first"), sum("second")];
const back = () => page.getComputedStyle(page.document.body).backgroundColor;
const light = back(); at("#theme").click();
const asked = performance.getEntriesByType("resource").map((one) => one.name);
document.title = JSON.stringify({
  before, after: names(), up: figures(1), down, order, middle, moved, near, whole, errors, light,
  dark: back(), tags: [at(".tag.before").textContent, at(".tag.after").textContent], complaints,
  asked: asked.filter((url) => !url.startsWith("data:"))});
})().catch((error) => { document.title = JSON.stringify({broken: String(error)}); });</script>"""
WATCH = """<head><script>
const complaints = [];
addEventListener("error", (event) => complaints.push(String(event.message)));
console.error = console.warn = (...words) => complaints.push(words.join(" "));
</script>"""
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_a_reader_can_sort_and_compare(reports: tuple[Path, Path, Path], tmp_path: Path) -> None:
    text = (reports[0] / builder.PAGE_NAME).read_text(encoding="utf-8")
    copy = tmp_path / "page.html"
    copy.write_text(text.replace("<head>", WATCH, 1) + READ, encoding="utf-8")
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
             f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=20000",
             "--window-size=1280,900", "--dump-dom"]  # fmt: skip
    command = [str(CHROMIUM), *flags, copy.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=180)
    written = re.search(r"<title>(.*?)</title>", done.stdout, re.DOTALL)
    assert written is not None
    actual = json.loads(html.unescape(written[1]))
    assert (actual["complaints"], actual["asked"]) == ([], []), actual
    assert actual["before"][-1] == "broken"
    assert actual["after"][-1] == "broken", "lost rows stay last"
    assert actual["order"] == "descending"
    assert actual["down"] == sorted(actual["down"], reverse=True)
    assert actual["up"] == actual["down"][::-1]
    assert actual["middle"] == "inset(0px 0px 0px 50%)"
    assert actual["moved"] == "inset(0px 0px 0px 25%)"
    assert "scale(1.5)" in actual["near"]
    assert "scale(1)" in actual["whole"]
    assert actual["errors"][0] > 0 == actual["errors"][1], "clean has no error against clean"
    assert (actual["light"], actual["dark"]) == ("rgb(255, 255, 255)", "rgb(18, 23, 29)")
    assert re.fullmatch(r"noisy, \d+\.\d\d dB", actual["tags"][0])
    assert actual["tags"][1] == "clean"
