"""`simnfnd status --failed`, and the run that tries such frames again."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.command import main


def words_for(folder: Path) -> list[str]:
    return [
        *("scenes=csv_list", f"scenes.file={folder}/scene/list.csv", "render=analytic"),
        *("scenes.intrinsics=[100,100,60,40]", "dataset.preview_pairs=0", "scheduler=serial"),
        *(f"cache.dir={folder}/cache", f"dataset.dir={folder}/out"),
    ]


@pytest.fixture
def failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A dataset of two frames, one of which had no depth; its file is whole by now."""
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "scene"
    folder.mkdir()
    depth = np.linspace(4000, 1500, 80 * 120).reshape(80, 120).astype(np.uint16)
    for name, picture in (("good", depth), ("bad", depth * 0)):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((80, 120, 3), 120, np.uint8))
        cv2.imwrite(str(folder / f"{name}_d.png"), picture)
    (folder / "list.csv").write_text("good.png,good_d.png\nbad.png,bad_d.png\n")
    assert main(["make", *words_for(tmp_path)]) == 1
    cv2.imwrite(str(folder / "bad_d.png"), depth)
    return tmp_path / "out"


def test_failed_frames_are_listed_and_tried_by_the_same_command(failed: Path, capfd) -> None:
    """What a file of the dataset says is shown, without what a terminal would obey."""
    path = failed / "failed.jsonl"
    item = json.loads(path.read_text())
    assert item["frame"] == "list/bad"
    path.write_text(json.dumps({**item, "command": "x; touch stolen \x1b[2J"}) + "\n")
    assert main(["status", str(failed), "--failed"]) == 1
    assert "x; touch stolen ?[2J" in capfd.readouterr().out
    assert main(["make", *words_for(failed.parent)]) == 0
    assert main(["status", str(failed), "--failed"]) == 0
    assert "no frame failed" in capfd.readouterr().out
