"""Trained networks as rows of the report."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.evaluation import runner
from simnfnd.evaluation.methods import networks_of
from simnfnd.evaluation.metrics.fidelity import psnr
from simnfnd.evaluation.pairs import geometry_of, items_of, picture
from simnfnd.evaluation.runner import SECONDS, Task, measure_task
from simnfnd.factory.dataset.schema import Axis, Column, Pair, Provenance
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.dataset.writer import write_shard
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import SonarSettings
from tests.evaluation.evaluation_settings import measured, settings_for
from tests.small_dataset import COLUMNS, fan_images, write_dataset


def weights(path: Path, seed: int) -> Path:
    """The weights of a small untrained network."""
    import torch

    from simnfnd.models.networks import build_network
    from simnfnd.models.networks.weights import save_weights

    config = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 1, "decoder": [1]}
    torch.manual_seed(seed)
    network = build_network(config)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.05)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_weights(path, network, config, {})
    return path


def test_networks_are_rows_with_their_costs(tmp_path: Path) -> None:
    first = weights(tmp_path / "small" / "weights.safetensors", 1)
    second = weights(tmp_path / "other.safetensors", 2)
    dataset = write_dataset(tmp_path / "data", train=0, test=3, size=48)
    ablation = {"olddata_l1": None, "simnfnd_l1": str(second), "simnfnd_newloss": None}
    settings = settings_for(dataset, models=[str(first.parent)], ablation=ablation)
    methods = networks_of(settings)
    assert [(method.label, method.ablation) for method in methods] == [
        ("small", ""),
        ("other", "simnfnd_l1"),
    ]
    found = measured(dataset, methods, tmp_path / "out")
    psnr_db = found.wide()["psnr"]
    from simnfnd.models.denoise.denoiser import Denoiser

    pair = picture(items_of(dataset, "test")[1].place)
    expected = psnr(pair.clean, Denoiser(first)(pair.noisy).clip(0, 1), data_range=1.0)
    assert psnr_db["small"][1] == pytest.approx(expected, abs=1e-6)
    assert psnr_db["small"][1] != psnr_db["other"][1]
    assert (found.wide()[SECONDS]["small"] > 0).all()


def test_networks_are_told_where_range_is(tmp_path: Path) -> None:
    sonar = SonarSettings()
    window = {"range_min_m": 1.0, "range_max_m": 5.0, "azimuth_min_deg": -9, "azimuth_max_deg": 9}
    columns = (*COLUMNS, *(Column(name, "f8") for name in window))
    identity = {"location": "a", "scene": "b", "frame": "c", "variant": 0}
    record: dict[str, Any] = {**identity, **window}
    noisy, clean, shadow = fan_images(64, np.random.default_rng(0))
    axes = Axis("row", "px", np.arange(64.0)), Axis("column", "px", np.arange(64.0))
    provenance = Provenance({"sonar": asdict(sonar)}, "0123abcd", "tests")
    pair = Pair(noisy, clean, shadow, record)
    name = "test/shard-00000.h5"
    write_shard(tmp_path, name, [pair], axes, columns, provenance, DatasetSettings())
    (item,) = items_of(tmp_path, "test")
    known = geometry_of(item.place)
    assert known is not None
    assert known.far_px == pytest.approx(FanGeometry.from_sonar(sonar, 1.0, 5.0).far_px)


def test_paths_without_weights_are_named(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for path, words in (
        ("empty", "empty/weights.*: no such"),
        ("none", "models: weights=.*no such"),
    ):
        with pytest.raises(FactoryError, match=words):
            networks_of(settings_for(tmp_path / "data", models=[str(tmp_path / path)]))
    (tmp_path / "bad.safetensors").write_bytes(b"no weights")
    dataset = write_dataset(tmp_path / "data", train=0, test=2, size=48)
    settings = settings_for(dataset, models=[str(tmp_path / "bad.safetensors")])
    found = measured(dataset, networks_of(settings), tmp_path / "out")
    assert "not a safetensors file" in found.lost["bad"], "it loses its row"


def test_known_figures_are_those_of_this_code_these_libraries_and_this_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What changes how figures come about must not find the figures of before."""
    dataset = write_dataset(tmp_path / "data", train=0, test=2, size=48)
    ran: list[Task] = []

    def counting(task: Task) -> Any:
        ran.append(task)
        return measure_task(task)

    monkeypatch.setattr(runner, "measure_task", counting)

    def again() -> bool:
        ran.clear()
        runner.program_digest.cache_clear()
        measured(dataset, [], tmp_path / "out")
        return bool(ran)

    assert again()
    assert not again(), "all is known"
    for name in ("_device_kind", "sources_digest"):
        with monkeypatch.context() as patch:
            patch.setattr(runner, name, lambda *_: "another")
            assert again()
    assert not again(), "what was known before still is"
