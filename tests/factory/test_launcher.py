"""Points of a sweep as jobs of submitit, in processes of this machine."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from simnfnd.command import main


def test_without_slurm_its_launcher_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    words = ["-m", "hydra/launcher=submitit_slurm", "noise.background.density=0.1,0.4"]
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["make", *words, f"hydra.sweep.dir={tmp_path / 'sweep'}"]) == 2
    said = capfd.readouterr().err.strip().splitlines()
    assert said[-1].startswith("error: hydra/launcher=submitit_slurm: no srun here; ")
    assert not any("Traceback" in line for line in said)


@pytest.mark.slow
def test_submitit_runs_the_points_of_a_sweep(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    words = [
        *("make", "-m", "hydra/launcher=submitit_local", "render=analytic", "scheduler=serial"),
        *("dataset.preview_pairs=0", "scenes.locations=2", "scenes.frames_per_location=1"),
        *("scenes.width=240", "scenes.height=160", "noise.background.density=0.1,0.4"),
        *(f"hydra.sweep.dir={tmp_path / 'sweep'}", f"cache.dir={tmp_path / 'cache'}"),
        f"dataset.dir={tmp_path}/set-${{hydra:job.num}}",
    ]
    assert main(words) == 0
    manifests = sorted(tmp_path.glob("set-*/manifest.json"))
    assert len(manifests) == 2
    totals = [json.loads(path.read_text())["totals"]["train"]["samples"] for path in manifests]
    assert totals == [1, 1]
    table = (tmp_path / "sweep" / "sweep.csv").read_text().splitlines()
    assert len(table) == 3
