"""`simnfnd evaluate paper`: both tables from a dataset, three trainings and a report, in small."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from simnfnd import command
from simnfnd.evaluation import paper
from tests.evaluation.realism.realism_pictures import polar_folder


def test_one_command_gives_both_tables_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran: list[str] = []

    def here(words: list[str]) -> int:
        """The same words in this process, on pictures as small as a crop."""
        ran.append(words[0])
        small = {
            "make": ["sonar.image.width_px=72", "sonar.image.height_px=72", "scheduler=serial"],
            "train": ["model.width=4", "device=cpu"],
            "evaluate": ["workers=1", "bootstrap=100", "baselines=[median]"],
        }
        monkeypatch.setattr(sys, "argv", ["simnfnd"])
        return command.main([*words, *small[words[0]]])

    monkeypatch.setattr(paper, "run", lambda words: 0 if words[0] != "train" else 3)
    out, real = tmp_path / "out", polar_folder(tmp_path / "real", 1, 4)
    words = ["--quick", "--real", str(real), "--frames", "8", "--steps", "2", "--out", str(out)]
    assert paper.main(words) == 3
    said = capsys.readouterr()
    assert said.out.startswith("Quick mode, no reproduction: 16 pairs of 8 frames at most")
    assert "the same command goes on from here" in said.err
    monkeypatch.setattr(paper, "run", here)
    assert paper.main(words) == 0
    assert ran == ["make", "train", "train", "train", "evaluate"]
    text = (out / "tables.md").read_text(encoding="utf-8")
    assert "Quick mode, no reproduction" in text
    assert "| row | paper PSNR / SSIM / GMSD | ours (quick) | which row here |" in text
    for row in ("OldData + L1loss", "SimNFND + L1loss", "SimNFND + Newloss"):
        (line,) = [one for one in text.splitlines() if one.startswith(f"| {row} ")]
        assert line.count(" / ") == 4, "the paper's and ours"
    assert "| Median | 17.76 / 0.690 / 0.190 |" in text
    # What is done is not done again.
    kept = (out / "simnfnd_l1" / "weights.safetensors").stat().st_mtime_ns
    monkeypatch.setattr(paper, "run", lambda w: here(w) if "name=simnfnd_l1" in w else 0)
    assert paper.main(words) == 0
    assert (out / "simnfnd_l1" / "weights.safetensors").stat().st_mtime_ns == kept
