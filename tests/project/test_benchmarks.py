"""`python -m benchmarks` finds, runs and reports; a benchmark that fails is not hidden."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import __main__ as benchmarks
from benchmarks.shared import Options
from tests.project_files import ROOT

GOOD = """
from benchmarks.shared import Section, Table
def measure(options):
    rows = (("theirs", 1.0, 20.123456), ("ours | fast", 123.456, 0.16))
    return Section((Table(("pair", "times less", "CPU s"), rows, f"quick: {options.quick}"),))
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of benchmarks, of which two fail, in the working directory."""
    package = tmp_path / "measured"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "bench_good.py").write_text(GOOD, encoding="utf-8")
    (package / "bench_bad.py").write_text("def measure(options): 1 / 0\n", encoding="utf-8")
    (package / "bench_wrong.py").write_text(
        "from benchmarks.shared import Section\n"
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
    printed = capfd.readouterr()
    assert printed.out.index("## bad") < printed.out.index("## good")
    assert printed.err.splitlines()[-1] == "error: failed: bad, wrong"
    text = (folder / "outputs/benchmarks/report.md").read_text()
    assert "**Failed: ended with exit code 1**" in text
    assert "**Failed: one shard differs**" in text
    assert "| ours \\| fast | 123 | 0.16 |" in text
    document = json.loads((folder / "outputs/benchmarks/report.json").read_text())
    assert document["sections"]["good"]["tables"][0]["rows"][0] == ["theirs", 1.0, 20.123456]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("words", [["fast"], ["good", "--frame", "nowhere"]])
def test_mistakes_are_one_line(words: list[str], capfd: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main(words) == 2
    error = capfd.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert words[-1] in error


def test_quick_runs() -> None:
    assert {"command", "denoise", "stages"} <= set(benchmarks.discover())
    section = benchmarks.run("stages", Options(quick=True))
    assert section.failed == ""
    assert all(table.rows for table in section.tables)
