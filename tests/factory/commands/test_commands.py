"""The verbs of `simnfnd`: each explains itself, and ends as the others do."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import pytest

from simnfnd.command import main
from tests.factory.export.export_dataset import write
from tests.project_files import ROOT


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Exit code of `simnfnd WORDS`, in this process."""
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    try:
        return main(words)
    except SystemExit as ended:  # of argparse
        return int(ended.code or 0)


def test_what_verbs_do_is_printed(monkeypatch, capsys, tmp_path: Path) -> None:
    source = write(tmp_path / "source")
    assert run(monkeypatch, "inspect", str(source)) == 0
    assert "9 train, 3 test" in capsys.readouterr().out
    out = tmp_path / "out"
    assert run(monkeypatch, "export", str(source), "--to", "png", "--out", str(out)) == 0
    assert "12 samples as PNG" in capsys.readouterr().out
    assert (out / "test/clean/000002.png").exists()


@pytest.mark.parametrize(
    "words",
    [
        ("inspect", "{nothing}"),
        ("merge", "{nothing}", "{nothing}", "--out", "{nothing}/out"),
        ("export", "{nothing}", "--to", "png", "--out", "{nothing}/out"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_two(words, monkeypatch, capsys, tmp_path) -> None:
    nothing = str(tmp_path / "nothing")
    given = [word.replace("{nothing}", nothing) for word in words]
    assert run(monkeypatch, *given) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1
    assert told[0].startswith("error: ")
    assert not Path(nothing).exists()


def test_the_preview_of_a_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = ROOT / "examples" / "didson" / "lamprey.avi"
    out = tmp_path / "sheet.png"
    assert run(monkeypatch, "preview", str(recording), "--out", str(out), "--pairs", "3") == 0
    sheet = cv2.imread(str(out))
    assert sheet is not None
    assert sheet.std() > 15
    assert run(monkeypatch, "preview", str(recording)) == 2
    assert "give --out FILE.png" in capsys.readouterr().err
