"""`simnfnd status --rerun` runs frames, never words that a dataset's files hold."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from simnfnd.command import main

SERIAL = ("scheduler=serial",)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two frames, one of which had no depth; its file is whole by now."""
    root = tmp_path_factory.mktemp("made")
    folder = root / "scene"
    folder.mkdir()
    depth = np.linspace(4000, 1500, 80 * 120).reshape(80, 120).astype(np.uint16)
    for name, image in (("good", depth), ("bad", depth * 0)):
        cv2.imwrite(str(folder / f"{name}.png"), np.full((80, 120, 3), 120, np.uint8))
        cv2.imwrite(str(folder / f"{name}_d.png"), image)
    (folder / "list.csv").write_text("good.png,good_d.png\nbad.png,bad_d.png\n")
    out = root / "out"
    words = [
        *("scenes=csv_list", f"scenes.file={folder / 'list.csv'}", "render=analytic"),
        *("scenes.intrinsics=[100,100,60,40]", "dataset.preview_pairs=0", *SERIAL),
        *(f"cache.dir={root / 'cache'}", f"dataset.dir={out}"),
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["simnfnd"])
        assert main(["make", *words]) == 1
    cv2.imwrite(str(folder / "bad_d.png"), depth)
    return out


@pytest.fixture
def failed(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it."""
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copytree(made, tmp_path / "out"))


def rewrite(out: Path, **changes: str) -> None:
    path = out / "failed.jsonl"
    item = json.loads(path.read_text())
    path.write_text(json.dumps({**item, **changes}) + "\n")


@pytest.mark.slow
def test_a_forged_command_is_shown_and_not_run(failed: Path, capfd) -> None:
    stolen = failed.parent / "stolen"
    for command in (
        f"simnfnd make --config-dir {failed.parent} dataset.dir={stolen} render=analytic",
        f"x; touch {stolen} \x1b[2J",
    ):
        rewrite(failed, command=command)
        assert main(["status", str(failed), "--failed"]) == 1
        shown = capfd.readouterr().out
        assert command.replace("\x1b", "?") in shown
        assert main(["status", str(failed), "--rerun", *SERIAL]) == 0
        assert "1 of 1 frames work now" in capfd.readouterr().out
        assert not stolen.exists()


def test_a_forged_frame_is_refused(failed: Path, capfd) -> None:
    rewrite(failed, frame="../../other")
    assert main(["status", str(failed), "--rerun", *SERIAL]) == 2
    assert capfd.readouterr().err == "error: frames.only: no frame named ../../other\n"


def test_a_forged_configuration_chooses_no_folder_and_no_cluster(failed: Path, capfd) -> None:
    elsewhere = failed.parent / "elsewhere"
    path = failed / "config.yaml"
    text = path.read_text()
    values = yaml.safe_load(text)
    values["cache"]["dir"] = values["dataset"]["dir"] = str(elsewhere)
    values["scheduler"] |= {"backend": "dask", "address": "tcp://127.0.0.1:9"}
    path.write_text(yaml.safe_dump(values))
    assert main(["status", str(failed), "--rerun", *SERIAL]) == 0
    assert not elsewhere.exists()
    path.write_text("!!python/object/apply:os.system ['touch elsewhere']")
    assert main(["status", str(failed), "--rerun", *SERIAL]) == 2
    assert "config.yaml: cannot be read" in capfd.readouterr().err
    assert not elsewhere.exists()


def test_a_frame_that_still_fails_says_why(made: Path, failed: Path, capfd) -> None:
    """The last test here: what it changes stays."""
    depth = made.parent / "scene/bad_d.png"
    depth.write_bytes(b"no image")
    for _ in range(2):
        assert main(["status", str(failed), "--rerun", *SERIAL]) == 1
        printed = capfd.readouterr().out
        assert "list/bad: " in printed
        assert "0 of 1 frames work now" in printed
