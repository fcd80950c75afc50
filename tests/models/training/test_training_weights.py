"""Weights that ship: 16 bits, a card, and a name instead of a file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.files import sha256_of
from simnfnd.models import pretrained
from simnfnd.models.exporting.export import export, main
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.pretrained.card import recipe_digest
from simnfnd.models.training.recipe import recipe_of
from tests.models.data.small_renders import composed

TINY = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 0, "decoder": [1]}
FACTS = {
    "loss.kind": "l1",
    "dataset.config_hash": "0123abcd",
    "seed": 3,
    "validation": {"step": 40, "psnr_noisy": 17.6, "psnr": 24.1, "ssim_noisy": 0.67, "ssim": 0.86},
}


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    torch.manual_seed(1)
    path = tmp_path / "weights.safetensors"
    save_weights(path, build_network(TINY), TINY, FACTS)
    return path


def test_exported_weights_are_half_the_size_and_denoise_the_same(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "shipped" / "small.safetensors"
    assert main([str(weights), "--out", str(out)]) == 0
    assert str(out) in capsys.readouterr().out
    before = load_weights(weights)
    after = load_weights(out)
    image = torch.rand(1, 1, 40, 40)
    with torch.inference_mode():
        torch.testing.assert_close(after.network(image), before.network(image), atol=2e-3, rtol=0)
    assert next(after.network.parameters()).dtype == torch.float32
    assert after.training == before.training
    count = sum(parameter.numel() for parameter in after.network.parameters())
    assert out.stat().st_size < 2 * count + 4000
    card = out.with_suffix(".md").read_text(encoding="utf-8")
    for words in (
        f"{count:,}",
        "GMAC",
        "`dataset.config_hash` | 0123abcd",
        "| `seed` | 3",
        '"psnr": 24.1',
    ):
        assert words in card
    first = out.read_bytes()
    export(weights, out)
    assert out.read_bytes() == first


def test_a_card_holds_recipe_curve_cost_and_figures(weights: Path, tmp_path: Path) -> None:
    head = "step,loss,learning_rate,psnr_noisy,psnr,ssim_noisy,ssim,gain_db"
    rows = [f"{step},0.1,0.001,17.6,{20 + step / 100},0.6,0.8,2.4" for step in range(10, 460, 10)]
    (tmp_path / "metrics.csv").write_text("\n".join([head, *rows]), encoding="utf-8")
    cost = {"cpu_s": 5400.0, "elapsed_s": 3600.0, "sittings": 2}
    (tmp_path / "cost.json").write_text(json.dumps(cost), encoding="utf-8")
    config = "# simnfnd train experiment=own\nseed: 3\n"
    (tmp_path / "config.yaml").write_text(config, encoding="utf-8")
    report = {
        "name": "lamprey2",
        "rows": [
            {"label": label, "kind": kind, "lost": None,
             "metrics": {"psnr": {"mean": psnr_db}, "ssim": {"mean": 0.7}}}
            for label, kind, psnr_db in (
                ("noisy", "noisy", 29.8), ("tv", "baseline", 32.8), ("median", "baseline", 31.0),
                ("own", "network", 33.6),
            )
        ],
    }  # fmt: skip
    (tmp_path / "real.json").write_text(json.dumps(report), encoding="utf-8")
    out = tmp_path / "own.safetensors"
    assert main([str(weights), "--out", str(out), "--figures", str(tmp_path / "real.json")]) == 0
    card = out.with_suffix(".md").read_text(encoding="utf-8")
    for words in (
        sha256_of(out),
        sha256_of(weights),
        recipe_digest(FACTS),
        "| 1.50, 1.00 h",
        "`simnfnd train experiment=own`",
    ):
        assert words in card
    assert "| own | 33.60 | 0.700 |" in card
    assert "median" not in card
    curve = card.split("## Learning curve")[1].split("## Figures")[0]
    assert 10 < curve.count("\n| ") < 25
    assert "| 450 | 0.1000 |" in curve
    (tmp_path / "real.json").write_text("{}", encoding="utf-8")
    with pytest.raises(FactoryError, match=r"--figures .*real\.json: "):
        main([str(weights), "--out", str(out), "--figures", str(tmp_path / "real.json")])


def test_a_recipe_is_known_by_its_settings_alone() -> None:
    digest = recipe_digest({**FACTS, "train.precision": "bf16-mixed", "dataset.pairs": 7})
    assert digest == recipe_digest(FACTS)
    assert recipe_digest({**FACTS, "loss.kind": "newloss"}) != digest
    assert recipe_digest({**FACTS, "seed": 4}) != digest


@pytest.mark.parametrize(
    ("name", "experiment"), [("simnfnd", "ship"), ("simnfnd-paper", "ship_paper")]
)
def test_recipe_card_and_file_belong_together(name: str, experiment: str) -> None:
    """The card names the file, and its recipe is the experiment of this version."""
    weights = pretrained.shipped()[name]
    card = weights.with_suffix(".md").read_text(encoding="utf-8")
    assert f"| SHA-256 | {sha256_of(weights)} |" in card
    digest = recipe_digest(load_weights(weights).training)
    assert f"| recipe digest | {digest} |" in card
    settings, _ = composed(f"experiment={experiment}")
    assert recipe_digest(recipe_of(settings)) == digest


def test_weights_that_ship_are_found_by_name(
    weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "ship"
    monkeypatch.setattr(pretrained, "_FOLDER", folder)
    export(weights, folder / "simnfnd.safetensors")
    export(weights, folder / "other.safetensors")
    assert pretrained.find_weights(None) == folder / "simnfnd.safetensors"
    assert pretrained.find_weights("other") == folder / "other.safetensors"
    assert pretrained.find_weights(weights) == weights
    assert pretrained.find_weights(weights.parent) == weights
    with pytest.raises(FactoryError, match="other, simnfnd"):
        pretrained.find_weights("third")


def test_weights_of_the_hub_are_named_by_their_repository(
    weights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    requests: list[tuple[str, str]] = []

    def fetched(repository: str, name: str) -> str:
        requests.append((repository, name))
        if repository == "nobody/nothing":
            raise OSError("401 Client Error\n\nRepository Not Found")
        return str(weights)

    monkeypatch.setattr("huggingface_hub.hf_hub_download", fetched)
    assert pretrained.find_weights("somebody/own-sonar") == weights
    assert requests == [("somebody/own-sonar", "weights.safetensors")]
    with pytest.raises(FactoryError, match=r"weights=nobody/nothing: .*401") as refusal:
        pretrained.find_weights("nobody/nothing")
    assert "\n" not in str(refusal.value)
    with pytest.raises(FactoryError, match="no such file"):
        pretrained.find_weights("outputs/weights.safetensors")


def test_everything_that_ships_has_a_card_and_is_small() -> None:
    for path in pretrained.shipped().values():
        assert path.with_suffix(".md").is_file()
        assert path.stat().st_size <= 8_000_000
        load_weights(path)
