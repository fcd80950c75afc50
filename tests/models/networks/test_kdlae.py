"""Several pictures of a scene: which frames are seen, the rate, and what training gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from simnfnd.factory.errors import FactoryError
from simnfnd.models.data.crops import Crops, Visit, whole_image_batch
from simnfnd.models.data.looks import amid, centred, variants_of
from simnfnd.models.data.pairs import PairSource, read_table
from simnfnd.models.networks import build_network
from simnfnd.models.networks.kdlae import KDLAE, frames_of
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.training.train import train
from tests.models.networks.tiny_networks import TINY, stirred, tiny
from tests.models.training.small_training import SMALL, config_for
from tests.small_dataset import write_dataset

KDLAE_WORDS = ("model=kdlae", "model.frames=3", "model.widths=[4,4]", "data.frames=3")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data"), train=12, test=0, size=48)


def kdlae(**changes: object) -> KDLAE:
    network = stirred(tiny("kdlae", **changes))
    assert isinstance(network, KDLAE)
    return network


def test_the_one_that_is_meant_is_in_the_middle() -> None:
    assert centred("abcde", 2, 3) == list("bcd")
    assert centred("abcde", 0, 5) == list("aaabc")
    assert centred("abcde", 4, 3) == list("dee")
    assert amid("x", "abcdefgh", 7) == list("abcxdef")
    assert amid("x", "ab", 7) == list("aaaxbbb")
    assert amid("x", "", 3) == list("xxx")
    assert amid("x", "ab", 1) == ["x"]
    seen = [variant for visit in range(100) for variant in variants_of(visit, 7)]
    assert len(set(seen)) == 700
    assert variants_of(3, 1) == (3,)


def test_ends_are_repeated_and_more_frames_left_out() -> None:
    looks = torch.arange(5.0)[None, :, None, None]
    assert frames_of(looks, 3).flatten().tolist() == [1, 2, 3]
    assert frames_of(looks, 9).flatten().tolist() == [0, 0, 0, 1, 2, 3, 4, 4, 4]
    assert frames_of(looks, 5) is looks
    with pytest.raises(ValueError, match="looks hold 4 pictures; expected an odd number"):
        frames_of(looks[:, :4], 3)


@pytest.mark.parametrize("frames", [1, 3, 7, 9])
def test_all_frames_and_no_others_decide_the_picture(frames: int) -> None:
    network, looks = kdlae(frames=frames), torch.rand(2, frames + 2, 16, 24)
    looks.requires_grad_()
    noisy = looks[:, frames // 2 + 1].detach()[:, None]
    network(noisy, looks=looks).sum().backward()
    assert looks.grad is not None
    moved = looks.grad.abs().amax(dim=(0, 2, 3)) > 0
    assert moved.tolist() == [False, *(True for _ in range(frames)), False]


def test_a_single_picture_is_seen_several_times() -> None:
    network, noisy = kdlae(), torch.rand(2, 1, 17, 30)
    same = noisy.expand(-1, network.looks, -1, -1)
    assert torch.equal(network(noisy), network(noisy, looks=same))
    assert torch.equal(network(noisy), network(noisy, looks=noisy))


def test_the_rate_is_the_part_of_its_change() -> None:
    network, noisy = kdlae(), torch.rand(2, 1, 16, 16)
    whole = network(noisy)
    rate = torch.tensor([[0.0], [0.25]])
    found = network(noisy, rate=rate)
    assert torch.equal(found[0], noisy[0])
    torch.testing.assert_close(found[1], noisy[1] + 0.25 * (whole[1] - noisy[1]))
    assert torch.equal(network(noisy, rate=torch.ones(2, 1)), whole)
    assert not torch.allclose(whole, noisy, atol=1e-3)


def test_more_looks_are_worth_more_to_one_that_learned_from_them() -> None:
    """Of noise that is independent from frame to frame several tell what one cannot."""
    network = tiny("kdlae").train()
    source = torch.Generator().manual_seed(3)
    clean = torch.rand(16, 1, 16, 16, generator=source)
    noise = 0.3 * torch.randn(16, 3, 16, 16, generator=source)
    looks = clean + noise
    noisy = looks[:, 1:2]
    optimizer = torch.optim.AdamW(network.parameters(), lr=0.01)
    for _ in range(60):
        loss = (network(noisy, looks=looks) - clean).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.inference_mode():
        several = (network(noisy, looks=looks) - clean).square().mean()
    # A third of the noise's variance is what the mean of three has.
    assert several < 0.6 * (noisy - clean).square().mean()


def test_pairs_see_the_other_variants_of_their_frame(dataset: Path) -> None:
    table = read_table(dataset, "train")
    alone = PairSource(table.samples, table.sonar)
    source = PairSource(table.samples, table.sonar, frames=3, among=table.samples)
    sample, other = source.sample(4, None), alone.sample(5, None)
    assert (table.samples[4].frame, table.samples[4].scene) == (
        table.samples[5].frame, table.samples[5].scene,
    )  # fmt: skip
    assert sample.looks is not None
    np.testing.assert_array_equal(sample.looks[1], sample.noisy)
    np.testing.assert_array_equal(sample.looks[2], other.noisy)
    assert alone.sample(4, None).looks is None
    whole = whole_image_batch(sample, ("looks",))
    assert torch.equal(whole["looks"][0, 1], whole["noisy"][0, 0])
    assert "looks" not in whole_image_batch(sample)


def test_crops_are_the_same_part_of_every_look(dataset: Path) -> None:
    table = read_table(dataset, "train")
    source = PairSource(table.samples, table.sonar, frames=3, among=table.samples, weaker=1.0)
    crops = Crops(source, crops=6, flip=True, seed=0, extras=("looks",))
    batch = crops[Visit(0, 2, 1, 16)]
    assert batch["looks"].shape == (6, 3, 16, 16)
    assert torch.equal(batch["looks"][:, 1:2], batch["noisy"])
    assert not torch.equal(batch["looks"][:, 2:], batch["noisy"])


def test_it_trains_and_again_the_same(dataset: Path, tmp_path: Path) -> None:
    small = [word for word in SMALL if not word.startswith("model")]
    done = ("train.steps=2", "train.check_every=1", "device=cpu", "data.weaker=0.5")
    for name in ("one", "two"):
        row = train(*config_for(dataset, tmp_path / name, *small, *KDLAE_WORDS, *done))
        assert row["step"] in (1, 2)
    one, two = (tmp_path / name / "weights.safetensors" for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    trained = load_weights(one)
    assert trained.network.looks == 3
    assert trained.training["data.frames"] == 3


def test_it_learns_from_a_teacher_of_single_pictures(dataset: Path, tmp_path: Path) -> None:
    teacher = tmp_path / "teacher.safetensors"
    config = {"kind": "unet", **TINY["unet"]}
    save_weights(teacher, build_network(config), config, {})
    small = [word for word in SMALL if not word.startswith("model")]
    done = ("train.steps=2", "train.check_every=1", "device=cpu", f"train.teacher={teacher}")
    train(*config_for(dataset, tmp_path / "out", *small, *KDLAE_WORDS, *done))
    assert "train.teacher" in load_weights(tmp_path / "out" / "weights.safetensors").training


def test_frames_for_a_network_of_one_are_refused(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match=r"^data\.frames=3: model\.kind=unet sees one picture"):
        train(
            *config_for(dataset, tmp_path / "out", "model=unet", "data.frames=3", "data.patch=32")
        )
    with pytest.raises(FactoryError, match=r"data\.frames: 4: give an odd number"):
        config_for(dataset, tmp_path / "out", "model=kdlae", "data.frames=4")
