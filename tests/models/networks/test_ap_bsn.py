"""The blind-spot network: what it does not see, and that it denoises grain without clean images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from simnfnd.factory.errors import FactoryError
from simnfnd.models.data.sources import open_data
from simnfnd.models.networks.ap_bsn import APBSN
from simnfnd.models.training.blind_spots import log_scale
from simnfnd.models.training.train import train
from tests.models.networks.tiny_networks import stirred, tiny
from tests.models.training.small_training import config_for
from tests.small_dataset import write_dataset


def network(**changes: int) -> APBSN:
    found = stirred(tiny("ap_bsn", **changes))
    assert isinstance(found, APBSN)
    return found


def seen_by(predicted: Tensor, image: Tensor, row: int, column: int) -> Tensor:
    """(H, W): whether the prediction of a pixel depends on each pixel."""
    (slope,) = torch.autograd.grad(predicted[0, 0, row, column], image, retain_graph=True)
    return slope[0, 0] != 0


@pytest.mark.parametrize("stride", [1, 2, 5])
@pytest.mark.parametrize("size", [(37, 28), (40, 40)])
def test_no_pixel_is_predicted_from_itself_or_its_grain(stride: int, size: tuple[int, int]) -> None:
    image = torch.rand(1, 1, *size, requires_grad=True)
    predicted = network(train_stride=stride, modules=2).predict_blind(image)
    assert predicted.shape == image.shape
    for row, column in ((0, 0), (17, 11), (size[0] - 1, size[1] - 1), (size[0] - 2, 3)):
        seen = seen_by(predicted, image, row, column)
        near = np.s_[
            max(0, row - stride + 1) : row + stride, max(0, column - stride + 1) : column + stride
        ]
        assert not seen[near].any()
        assert seen.sum() > 8


def test_in_training_it_is_blind_and_in_use_refined() -> None:
    made, image = network(train_stride=5, use_stride=2, passes=3), torch.rand(2, 1, 23, 31)
    blind = made.predict_blind(image)
    assert torch.equal(made.train()(image), blind)
    used = made.eval()(image)
    assert not torch.allclose(used, blind, atol=1e-3)
    assert torch.equal(made(image), used), "nothing is drawn"
    assert torch.equal(made.predict_blind(image), blind)
    # Without passes: the pictures of every second pixel, each for itself.
    plain = network(train_stride=5, use_stride=2, passes=0)
    part = plain(image[..., :22, :30])[..., 1::2, 0::2]
    torch.testing.assert_close(part, plain.blind(image[..., 1:22:2, 0:30:2]))
    with pytest.raises(TypeError, match="UNet sees the pixels that it predicts"):
        tiny("unet").predict_blind(image)


def test_it_learns_to_denoise_grain_from_noisy_pictures_alone() -> None:
    rng = np.random.default_rng(0)
    clean = np.stack([ndimage.gaussian_filter(rng.random((40, 40)), 5) for _ in range(6)])
    clean = 0.15 + 0.5 * (clean - clean.min()) / np.ptp(clean)
    # Grain as wide as two pixels.
    grain = ndimage.gaussian_filter(rng.normal(size=clean.shape), (0, 0.8, 0.8))
    noisy = torch.tensor(clean * np.exp(0.35 * grain / grain.std()), dtype=torch.float32)[:, None]
    torch.manual_seed(0)
    made = tiny("ap_bsn", train_stride=4, use_stride=2, passes=4).train()
    optimizer = torch.optim.AdamW(made.parameters(), lr=0.01)
    for _ in range(120):
        left = log_scale(made(noisy), 20) - log_scale(noisy, 20)
        optimizer.zero_grad()
        left.abs().mean().backward()
        optimizer.step()
    with torch.inference_mode():
        denoised = made.eval()(noisy)[:, 0].numpy()
    before, after = (np.square(x - clean).mean() for x in (noisy[:, 0].numpy(), denoised))
    assert 10 * np.log10(before / after) > 3


SMALL = (
    *("data=self_supervised", "model=ap_bsn", "model.width=4", "model.modules=1"),
    *("model.passes=1", "data.method=blind_network", "data.patch=32", "data.batch=2"),
    *("data.crops=2", "train.steps=2", "train.check_every=1", "train.warmup=1"),
    *("tensorboard=false", "pictures=0", "device=cpu"),
)


def test_it_trains_on_the_noisy_pictures_of_a_dataset(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data", train=4, test=0, size=48)
    words = (*SMALL, f"data.folder='{folder}'")
    settings, values = config_for(tmp_path, tmp_path / "out", *words)
    data = open_data(settings)
    assert len(data.learning) + len(data.validation) == 4, "pairs, and not preview.png"
    row = train(settings, values)
    assert row["step"] in (1, 2)
    assert np.isfinite(row["validation_loss"])
    assert (tmp_path / "out" / "weights.safetensors").is_file()


def test_other_networks_are_refused(tmp_path: Path) -> None:
    folder = write_dataset(tmp_path / "data", train=4, test=0, size=48)
    words = [word for word in SMALL if not word.startswith("model")]
    with pytest.raises(FactoryError, match=r"kind=unet sees .*take model=ap_bsn") as told:
        train(
            *config_for(tmp_path, tmp_path / "o", *words, f"data.folder='{folder}'", "model=unet")
        )
    assert "\n" not in str(told.value)
