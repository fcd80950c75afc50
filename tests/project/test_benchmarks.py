"""`python -m benchmarks` finds, runs and reports; a benchmark that fails is not hidden."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as benchmarks
from benchmarks.report import Options, Section, Table, from_json, shown, to_json
from benchmarks.shared import in_own_process
from tests.project_files import ROOT

GOOD = """
from benchmarks.report import Options, Section, Table
def measure(options):
    rows = (("theirs", 1.0, 20.123456), ("ours | fast", 123.456, 0.16))
    return Section((Table(("pair", "times less", "CPU s"), rows, "a frame", bars="times less"),),
                   f"quick: {options.quick}")
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of benchmarks, of which two fail, in the working directory."""
    package = tmp_path / "measured"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "room").mkdir()
    (package / "room" / "__init__.py").touch()
    (package / "room" / "bench_good.py").write_text(GOOD, encoding="utf-8")
    (package / "bench_bad.py").write_text("def measure(options): 1 / 0\n", encoding="utf-8")
    (package / "bench_wrong.py").write_text(
        "from benchmarks.report import Section\n"
        "def measure(options): return Section(failed='one shard differs')\n",
        encoding="utf-8",
    )
    (package / "helper.py").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    find = benchmarks.discover
    monkeypatch.setattr(benchmarks, "discover", lambda: find(package))
    return tmp_path


def test_all_run_and_the_failed_ones_are_named(
    folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert benchmarks.main([]) == 1
    said = capfd.readouterr()
    assert said.out.index("## bad") < said.out.index("## good") < said.out.index("| pair |")
    assert said.err.splitlines()[-1] == "error: failed: bad, wrong"
    told = (folder / "outputs/benchmarks/report.md").read_text()
    assert "**Failed: ended with exit code 1**" in told
    assert "**Failed: one shard differs**" in told


def test_one_report_as_text_numbers_and_picture(
    folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert benchmarks.main(["good", "--out", "reports"]) == 0
    text = (folder / "reports/good.md").read_text()
    assert text.startswith("# Benchmarks\n")
    assert "| ours \\| fast | 123 | 0.16 |" in text
    assert "![ratios and times](good.png)" in text
    assert "quick: False" in text
    document = json.loads((folder / "reports/good.json").read_text())
    assert document["sections"]["good"]["tables"][0]["rows"][0] == ["theirs", 1.0, 20.123456]
    assert (folder / "reports/good.png").read_bytes().startswith(b"\x89PNG")
    assert "bad" not in capfd.readouterr().out


def test_quick_says_that_its_figures_mean_nothing(folder: Path) -> None:
    assert benchmarks.main(["good", "--quick"]) == 0
    text = (folder / "outputs/benchmarks/quick-good.md").read_text()
    assert "too small for the figures to mean anything" in text
    assert "quick: True" in text


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fast"], "error: no benchmark fast; there are: bad, good, wrong\n"),
        (["good", "--frame", "nowhere"], "error: --frame nowhere: no such folder\n"),
        (["good", "--peer", "nowhere"], "error: --peer nowhere: no such folder\n"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert benchmarks.main(words) == 2
    assert capfd.readouterr().err == said


def test_a_section_survives_the_way_to_another_process() -> None:
    table = Table(("a", "b"), (("x", 1), ("y", 2.5)), "t", "n", bars="b", lines=("a", "b"))
    section = Section((table,), "note", "bad", 3.0)
    assert from_json(json.loads(json.dumps(to_json(section)))) == section


@pytest.mark.parametrize(
    ("cell", "text"), [(0.0, "0"), (0.00012345, "0.00012"), (1.2345, "1.23"), (1234.5, "1234"),
                       (7, "7"), ("x", "x")]
)  # fmt: skip
def test_numbers_are_shown_with_three_digits(cell: float | str, text: str) -> None:
    assert shown(cell) == text


def test_the_projects_own_are_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main(["--list"]) == 0
    assert set(capsys.readouterr().out.split()) >= {
        *("codecs", "pair", "peer", "readers", "scaling", "stages", "sweep", "workers"),
    }


def test_without_a_peer_the_comparison_says_so() -> None:
    section = benchmarks.run("peer", Options(quick=True))
    assert section.note.startswith("Skipped: --peer")
    assert (section.tables, section.failed) == ((), "")


PEER = """
import sys, yaml, pathlib
run = yaml.safe_load(open("config/" + sys.argv[1]))
sonar = yaml.safe_load(open(run["sonar_config_file"]))
count = yaml.safe_load(open(run["trajectory_file"]))["timesteps"]
assert open(run["scene_file"], "rb").readline() == b"ply\\n"
assert sonar["azimuth_bins"] == 512 and 1 < sonar["max_range"] < 100
sum(range(10_000_000 * count))
for number in range(count):
    pathlib.Path(run["output_folder"], f"{number}.png").touch()
"""


def _held(kb_a_sample: int, samples: int) -> list[float]:
    """MB of the first and last quarter of a reader that keeps so much of the first `samples`."""
    from benchmarks.shards.bench_streams import timed

    held = []

    def read() -> Iterator[int]:
        for number in range(400):
            if number < samples:
                held.append(np.ones(kb_a_sample << 7))
            yield number

    *_, first_mb, last_mb, _ = timed("held", read(), range(400), [], warm=100)
    return [float(first_mb), float(last_mb)]


@pytest.mark.parametrize(
    ("kb_a_sample", "samples", "leaks"),
    # What is open from the first hundred on is no leak; a picture kept of every sample is.
    [(0, 400, False), (400, 100, False), (400, 400, True)],
)
def test_a_leak_shows_in_the_memory_of_a_reader(
    kb_a_sample: int, samples: int, leaks: bool
) -> None:
    pytest.importorskip("psutil")
    pytest.importorskip("moto")
    from benchmarks.shards.bench_streams import has_grown

    assert has_grown(*in_own_process(_held, kb_a_sample, samples)) == leaks


@pytest.mark.slow
def test_a_peer_is_run_as_its_readme_says(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "run_simulation.py").write_text(PEER)
    section = benchmarks.run("peer", Options(quick=True, peer=str(tmp_path)))
    assert section.failed == ""
    (table,) = section.tables
    assert [row[1] > 0 for row in table.rows if isinstance(row[1], float)] == [True] * 2
    assert [path.name for path in (tmp_path / "config").iterdir()] == [], "the checkout was touched"


@pytest.mark.slow
def test_quick_compares_the_profiles() -> None:
    section = benchmarks.run("profiles", Options(quick=True))
    assert not section.failed
    (table,) = section.tables
    assert table.column("pictures")[:2] == ["512x512", "256x256"]
    assert all(isinstance(times, float) and times > 0 for times in table.column("times"))


def test_quick_runs_the_stages() -> None:
    section = benchmarks.run("stages", Options(quick=True))
    assert section.failed == ""
    assert all(table.rows for table in section.tables)


def test_what_is_left_of_spokes_is_told_by_bearing() -> None:
    """Two stripes along bearings, of which a tenth and four fifths stay; the rest is no spoke."""
    from benchmarks.denoising.bench_spokes import left_of_spokes
    from simnfnd.factory.sonar.geometry import FanGeometry
    from simnfnd.factory.sonar.settings import SonarSettings

    geometry = FanGeometry.from_sonar(SonarSettings(), 1.0, 6.0, -0.39, 0.39)
    maps = geometry.maps(0, 0, *SonarSettings().shape())
    inside, bearing = maps["sector"] > 0, maps["azimuth_rad"]
    one, other = (inside & (abs(bearing - at) < 0.015) for at in (-0.2, 0.1))
    faint = inside & (abs(bearing - 0.3) < 0.015)
    before = 0.3 * one + 0.1 * other + 0.01 * faint
    after = 0.03 * one + 0.08 * other + 0.01 * faint
    spokes = list(left_of_spokes(before, after, geometry))
    assert [spoke.left for spoke in spokes] == pytest.approx([0.1, 0.8], abs=0.02)
    assert [spoke.height for spoke in spokes] == pytest.approx([0.3, 0.1], abs=0.02)
