"""`python -m benchmarks` finds, runs and reports; a benchmark that fails is not hidden."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import __main__ as benchmarks


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of two benchmarks, one of which fails, in the working directory."""
    package = tmp_path / "measured"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "bench_good.py").write_text("def main(): print('| a |')\n", encoding="utf-8")
    (package / "bench_bad.py").write_text("def main(): 1 / 0\n", encoding="utf-8")
    (package / "helper.py").touch()
    monkeypatch.chdir(tmp_path)
    find, run = benchmarks.discover, benchmarks.run
    monkeypatch.setattr(benchmarks, "discover", lambda: find(package))
    monkeypatch.setattr(benchmarks, "run", lambda name: run(name, "measured"))
    return package


@pytest.mark.usefixtures("folder")
def test_all_run_and_the_failed_one_is_named(capfd: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main([]) == 1
    said = capfd.readouterr()
    assert said.out.index("## bad") < said.out.index("## good") < said.out.index("| a |")
    assert said.err.splitlines()[-1] == "error: failed: bad"


@pytest.mark.usefixtures("folder")
def test_one_can_be_chosen(capfd: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main(["good"]) == 0
    said = capfd.readouterr().out
    assert "| a |" in said
    assert "bad" not in said


@pytest.mark.usefixtures("folder")
def test_an_unknown_name_is_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main(["fast"]) == 2
    assert capfd.readouterr().err == "error: no benchmark fast; there are: bad, good\n"


def test_the_projects_own_are_found(capsys: pytest.CaptureFixture[str]) -> None:
    assert benchmarks.main(["--list"]) == 0
    assert "render" in capsys.readouterr().out.split()
