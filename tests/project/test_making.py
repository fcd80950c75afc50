"""Pairs and datasets from Python: in scripts, other applications of Hydra, threads and loaders."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import simnfnd
from simnfnd.command import main
from simnfnd.factory.common.progress import RunProgress
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.factory.simulation.config.compose import compose_config
from tests.project.test_face import PLACE, frame

SMALL = (
    "experiment=demo", "render=analytic", "scenes.locations=2", "scenes.frames_per_location=2",
    "scenes.width=160", "scenes.height=100", "dataset.preview_pairs=0",
)  # fmt: skip
# Without the guard that processes of `multiprocessing` need as a rule.
SCRIPT = """
import sys
from simnfnd import make_dataset

print("begun")
done = make_dataset(*sys.argv[2:], "scheduler.workers=2", "scheduler.shard_size=1", out=sys.argv[1])
print(done.pairs, len(done.failures))
"""
# An application whose configuration and version of Hydra's behaviour are its own.
APPLICATION = """
import hydra
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig
from simnfnd import make_pair
from tests.project.test_face import PLACE, frame

@hydra.main(config_path=None, version_base="1.2")
def application(config: DictConfig) -> None:
    pair = make_pair(*frame(), **PLACE)
    print(pair.noisy.sum(), hydra.version.getbase(), GlobalHydra.instance().is_initialized())

application()
"""


def outcome(code: str, *words: str, cwd: Path) -> str:
    """What a script prints that lies in a folder of its own."""
    (cwd / "script.py").write_text(code)
    done = subprocess.run(
        [sys.executable, "script.py", *words],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def contents(dataset: Path) -> dict[str, bytes]:
    """Relative path -> content of each shard."""
    return {
        path.relative_to(dataset).as_posix(): path.read_bytes() for path in dataset.glob("*/*.h5")
    }


@pytest.mark.slow
def test_a_dataset_is_that_of_the_command(tmp_path: Path, monkeypatch, capfd) -> None:
    observed: list[RunProgress] = []
    words = (*SMALL, "scheduler=serial")
    dataset = simnfnd.make_dataset(*words, out=tmp_path / "python", progress=observed.append)
    assert dataset.path == str(tmp_path / "python")
    assert (dataset.pairs, dataset.failures) == (4, ())
    assert any(note.startswith("frames: 4 of 2 scenes") for note in dataset.notes)
    assert observed[0].pairs_done == 0
    assert observed[-1][:4] == (4, 4, 4, 4)
    assert observed[-1].share == 1
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "frames" not in printed.err
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    assert main(["make", *words, f"dataset.dir={tmp_path / 'command'}"]) == 0
    assert contents(tmp_path / "python") == contents(tmp_path / "command")
    again = simnfnd.make_dataset(*words, out=tmp_path / "python")
    assert again.pairs == 4
    with pytest.raises(simnfnd.FactoryError, match=r"another configuration.*seed"):
        simnfnd.make_dataset(*words, "seed=9", out=tmp_path / "python")
    with pytest.raises(simnfnd.FactoryError, match=r"nois: no such key"):
        simnfnd.make_dataset("nois=none")


@pytest.mark.slow
def test_a_script_without_a_guard_makes_a_dataset_with_workers(tmp_path: Path) -> None:
    said = outcome(SCRIPT, str(tmp_path / "data"), *SMALL, cwd=tmp_path)
    assert said.splitlines() == ["begun", "4 0"]
    with simnfnd.PairDataset(tmp_path / "data", "all", trusted=True) as pairs:
        assert len(pairs) == 4


def test_frames_that_fail_are_named(tmp_path: Path) -> None:
    rgb, depth_m = frame()
    from PIL import Image

    for name in ("good", "bad"):
        Image.fromarray(rgb).save(tmp_path / f"{name}.png")
        metres = np.nan_to_num(depth_m) if name == "good" else np.zeros_like(depth_m)
        np.save(tmp_path / f"{name}.npy", metres.astype(np.float32))
    (tmp_path / "frames.csv").write_text("good.png,good.npy\nbad.png,bad.npy\n")
    words = (f"scenes.file={tmp_path / 'frames.csv'}", "scenes.intrinsics=[120,120,76,48]")
    dataset = simnfnd.make_dataset(
        "scenes=csv_list", *words, "render=analytic", "scheduler=serial",
        "dataset.preview_pairs=0", out=tmp_path / "out",
    )  # fmt: skip
    assert dataset.pairs == 1
    (failure,) = dataset.failures
    assert failure.ref.frame == "bad"
    assert "valid pixels" in failure.reason


@pytest.mark.slow
def test_inside_another_application_of_hydra(tmp_path: Path) -> None:
    pair = simnfnd.make_pair(*frame(), **PLACE)
    said = outcome(APPLICATION, cwd=tmp_path)
    assert said.split() == [str(pair.noisy.sum()), "1.2", "True"]


def test_threads_compose_and_make_the_same() -> None:
    def noise_sum(seed: int) -> int:
        pair = simnfnd.make_pair(*frame(), **PLACE, config=f"render=analytic seed={seed}")
        return int(pair.noisy.sum())

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(noise_sum, range(11, 17))) == list(map(noise_sum, range(11, 17)))


@pytest.mark.slow
def test_workers_of_a_loader_make_pairs() -> None:
    from torch.utils.data import DataLoader, Dataset

    class Pairs(Dataset[Any]):
        def __len__(self) -> int:
            return 4

        def __getitem__(self, number: int) -> Any:
            return simnfnd.make_pair(*frame(), **PLACE, seed=number).noisy

    loader = DataLoader(Pairs(), 2, num_workers=2, multiprocessing_context="fork")
    actual = np.concatenate([batch.numpy() for batch in loader])
    expected = np.stack(
        [simnfnd.make_pair(*frame(), **PLACE, seed=number).noisy for number in range(4)]
    )
    np.testing.assert_array_equal(actual, expected)


# --- arrays -------------------------------------------------------------------------------------


def test_arrays_of_other_kinds_give_the_same_pair() -> None:
    rgb, depth_m = frame()
    known = np.nan_to_num(depth_m)
    pair = simnfnd.make_pair(rgb, known, **PLACE)
    others: list[tuple[Any, Any]] = [
        (rgb, known[..., None]),
        (rgb.astype(np.int64), known.astype(np.float64)),
        (rgb.tolist(), known.tolist()),
        (rgb, np.ma.masked_array(np.where(known > 0, known, 7), mask=known == 0)),
    ]
    for colours, depths in others:
        again = simnfnd.make_pair(colours, depths, **PLACE)
        np.testing.assert_array_equal(again.noisy, pair.noisy)


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"depth_m": np.full((96, 152), 1500, np.uint16)}, "depth_m is uint16"),
        ({"depth_m": np.full((96, 152, 2), 1.5)}, "depth_m has shape"),
        ({"depth_m": "depth.png"}, "depth_m holds"),
        ({"depth_m": [[1.0], [1.0, 2.0]]}, "depth_m"),
        ({"rgb": np.zeros((96, 152, 4), np.uint8)}, "rgb has shape"),
        ({"rgb": np.full((96, 152, 3), 0.5)}, "rgb is float64"),
        ({"rgb": np.full((96, 152, 3), 300)}, "rgb is int64"),
        ({"fx": 0}, "fx=0"),
        ({"fy": -120}, "fy=-120"),
        ({"cx": float("nan")}, "cx=nan"),
    ],
)
def test_a_wrong_array_is_named(change: dict[str, Any], argument: str) -> None:
    rgb, depth_m = frame()
    with pytest.raises(ValueError, match=argument):
        simnfnd.make_pair(**{"rgb": rgb, "depth_m": depth_m, **PLACE, **change})


@pytest.mark.parametrize(("factor", "unit"), [(1000, "millimetres"), (1e-3, "divided twice")])
def test_depths_in_another_unit_are_told(factor: float, unit: str) -> None:
    rgb, depth_m = frame()
    with pytest.raises(simnfnd.FrameError, match=rf"depth_m: .*{unit}"):
        simnfnd.make_pair(rgb, depth_m * factor, **PLACE)


def test_layers_of_the_camera_are_the_arrays() -> None:
    rgb, depth_m = frame()
    words = ("render=analytic", "dataset.layers=[rgb,depth,range]")
    pair = simnfnd.make_pair(rgb, depth_m, **PLACE, config=words)
    assert set(pair.layers) == {"rgb", "depth", "range"}
    np.testing.assert_array_equal(pair.layers["rgb"], rgb)
    np.testing.assert_array_equal(pair.layers["depth"], depth_m)


# --- what a pair says of itself -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("experiment", "formation", "weights"),
    [("simnfnd", "pointwise", "simnfnd-paper"), ("physical", "coherent", "simnfnd")],
)
def test_a_pair_carries_what_chooses_its_weights(
    tmp_path: Path, experiment: str, formation: str, weights: str
) -> None:
    words = (f"experiment={experiment}", "render=analytic")
    pair = simnfnd.make_pair(*frame(), **PLACE, config=words)
    assert pair.formation == formation
    known = simnfnd.denoise(pair.noisy, weights=weights, geometry=pair.geometry)
    np.testing.assert_array_equal(simnfnd.denoise(pair), known)
    demo = "demo" if experiment == "simnfnd" else "demo_physical"
    recipe = (f"experiment={demo}", *SMALL[1:], "scheduler=serial")
    dataset = simnfnd.make_dataset(*recipe, out=tmp_path / "data")
    with simnfnd.PairDataset(dataset.path, trusted=True) as pairs:
        stored = pairs.pair(-1)
        sample = pairs[-1]
        assert stored.formation == formation
        np.testing.assert_array_equal(stored.noisy, sample["noisy"])
        assert stored.record["scene"] == pairs.meta()[-1]["scene"].decode()
        sonar = compose_config(recipe).sonar
        assert stored.geometry == FanGeometry.from_record(sonar, stored.record)


# --- choices in a folder of one's own -----------------------------------------------------------


@pytest.mark.slow
def test_every_verb_finds_choices_in_a_folder(tmp_path: Path, monkeypatch, capfd) -> None:
    (tmp_path / "mine/sonar").mkdir(parents=True)
    (tmp_path / "mine/sonar/tiny.yaml").write_text(
        "defaults: [camera_matched]\nrange_bins: 48\nimage: {layout: polar}\nbeams: 40\n"
    )
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    monkeypatch.chdir(tmp_path)
    words = (*SMALL, "sonar=tiny", "scheduler=serial")
    assert compose_config(("--config-dir=mine", *words)).sonar.range_bins == 48
    for option in (["--config-dir", "mine"], ["--config-dir=mine"]):
        assert main(["plan", *option, *words]) == 0
    assert main(["make", "--config-dir", "mine", *words, "dataset.dir=data"]) == 0
    with h5py.File(tmp_path / "data/train/shard-00000.h5") as shard:
        assert shard["noisy"].shape[1:] == (48, 40)
    capfd.readouterr()
    assert main(["make", "--config-dir=mine", *SMALL, "sonar=tinny"]) == 2
    assert "did you mean sonar=tiny" in capfd.readouterr().err
    assert main(["plan", "--config-dir=nowhere", *words]) == 2
    assert "--config-dir=nowhere: no such folder" in capfd.readouterr().err
    with pytest.raises(simnfnd.FactoryError, match="sonar=tiny: no such choice"):
        compose_config(words)
