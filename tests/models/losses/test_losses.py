"""The losses: their formulas, and which of them have a gradient where."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.quality import ssim
from simnfnd.models.training.losses import Loss

NEW = {"kind": "newloss", "shadow": "literal", "weight": 1.0, "threshold": 0.1}


def build_loss(config: dict[str, Any]) -> Loss:
    return build(Loss, config, "loss")


def image(*values: float) -> Tensor:
    return torch.tensor(values).reshape(1, 1, 1, -1)


def gradient(config: dict[str, Any], prediction: Tensor, clean: Tensor, **known: Tensor) -> Tensor:
    prediction = prediction.clone().requires_grad_()
    build_loss(config)(prediction, clean, known).backward()
    assert prediction.grad is not None
    return prediction.grad


def test_plain_losses_are_their_formulas() -> None:
    a, b = image(0.0, 0.5), image(0.3, 0.5)
    assert build_loss({"kind": "l1"})(a, b, {}).item() == pytest.approx(0.15)


@pytest.mark.parametrize("kind", [{"kind": "l1"}, NEW])
def test_the_squared_difference_is_added_to_any(kind: dict[str, Any]) -> None:
    a, b = image(0.0, 0.5), image(0.3, 0.5)
    more = build_loss({**kind, "square": 2.0})(a, b, {}) - build_loss(kind)(a, b, {})
    assert more.item() == pytest.approx(2 * 0.09 / 2)


def test_the_structural_similarity_is_that_of_the_reports() -> None:
    """But for its windows, every second one."""
    source = torch.Generator().manual_seed(0)
    clean = torch.rand(1, 1, 96, 80, generator=source)
    prediction = (clean + 0.2 * torch.rand(clean.shape, generator=source)).clamp(0, 1)
    more = build_loss({"kind": "l1", "ssim": 2.0})(prediction, clean, {})
    less = build_loss({"kind": "l1"})(prediction, clean, {})
    measured = ssim(clean[0, 0].numpy(), prediction[0, 0].numpy())
    assert (more - less).item() == pytest.approx(2 * (1 - measured), rel=0.05)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    weight=st.floats(0, 10),
    threshold=st.floats(0, 0.99),
    colours=st.sampled_from([1, 3]),
)
def test_the_loss_as_printed_trains_exactly_as_l1(
    seed: int, weight: float, threshold: float, colours: int
) -> None:
    """A threshold has no slope: bit for bit the gradients of L1."""
    source = torch.Generator().manual_seed(seed)
    prediction, clean = torch.rand(2, 2, colours, 5, 7, generator=source)
    literal = {**NEW, "weight": weight, "threshold": threshold}
    assert torch.equal(
        gradient(literal, prediction, clean), gradient({"kind": "l1"}, prediction, clean)
    )


def test_the_loss_as_printed_counts_the_pixels_on_the_wrong_side() -> None:
    prediction = image(0.05, 0.2, 0.2, 0.1)
    clean = image(0.3, 0.0, 0.5, 0.1)
    # L1 of the images, and two of four pixels; a grey value of t itself is shadow.
    expected = (0.25 + 0.2 + 0.3) / 4 + 0.5 * 2 / 4
    for shadow in ("literal", "ste"):
        loss = build_loss({**NEW, "shadow": shadow, "weight": 0.5})
        assert loss(prediction, clean, {}).item() == pytest.approx(expected)


def test_a_gradient_passes_the_threshold() -> None:
    """Every pixel, whichever side of the threshold it is on."""
    prediction = image(0.12, 0.5, 0.6)
    clean = image(0.0, 0.45, 0.6)
    plain = gradient({"kind": "l1"}, prediction, clean)
    passed = gradient({**NEW, "shadow": "ste", "weight": 0.3}, prediction, clean)
    assert passed[..., 0] - plain[..., 0] == pytest.approx(0.3 / 3)


@pytest.mark.parametrize("kind", [{"kind": "l1"}, NEW])
def test_the_mask_head_learns_the_true_shadow(kind: dict[str, Any]) -> None:
    prediction = image(0.5, 0.5)
    clean = image(0.5, 0.0)
    mask = image(0.0, 1.0)
    logits = torch.zeros_like(mask).requires_grad_()
    known = {"shadow": mask, "shadow_logits": logits}
    without = build_loss({**kind, "mask": 0})(prediction, clean, known)
    loss = build_loss({**kind, "mask": 0.3})(prediction, clean, known)
    assert (loss - without).item() == pytest.approx(0.3 * np.log(2), rel=1e-5)
    loss.backward()
    assert logits.grad is not None
    assert logits.grad.flatten().tolist() == pytest.approx([0.3 / 4, -0.3 / 4])


@pytest.mark.parametrize("kind", [{"kind": "l1"}, NEW])
def test_the_third_head_learns_how_much_of_the_change_is_right(kind: dict[str, Any]) -> None:
    clean = torch.full((3, 1, 1, 2), 0.5)
    # Half of the way, the wrong way, and nothing wrong in the first place.
    noisy = clean + torch.tensor([0.2, 0.1, 0.0])[:, None, None, None]
    prediction = clean + torch.tensor([0.1, 0.2, 0.2])[:, None, None, None]
    weight = torch.tensor([0.5, 0.5, 0.1], requires_grad=True)
    known = {"noisy": noisy, "weight": weight}
    without = build_loss({**kind, "blend": 0})(prediction, clean, known)
    loss = build_loss({**kind, "blend": 0.3})(prediction, clean, known)
    # Best are 1, 0 and 0; they count as change over noise, 0.01 / 0.0401, 0.01 / 0.0101 and 1.
    counts = (0.01 / 0.0401, 0.01 / 0.0101, 1)
    off = -(np.log(0.5) * (counts[0] + counts[1]) + np.log(0.9) * counts[2]) / 3
    assert (loss - without).item() == pytest.approx(0.3 * off, rel=1e-4)
    loss.backward()
    assert weight.grad is not None
    slopes = [0.1 * slope * count for slope, count in zip((-2, 2, 1 / 0.9), counts, strict=True)]
    assert weight.grad.tolist() == pytest.approx(slopes, rel=1e-3)


def test_decibels_count_every_image_alike() -> None:
    clean = torch.zeros(2, 1, 4, 4)
    prediction = torch.stack([torch.full((1, 4, 4), 0.1), torch.full((1, 4, 4), 0.01)])
    prediction.requires_grad_()
    kind = {"kind": "l1", "mask": 0, "blend": 0}
    plain = build_loss(kind)(prediction, clean, {})
    loss = build_loss({**kind, "decibels": 0.5})(prediction, clean, {})
    # 10 log10 of 0.0101 and of 0.0002: the floor of 40 dB is added.
    assert (loss - plain).item() == pytest.approx(0.5 * (-19.9568 - 36.9897) / 2, rel=1e-4)
    (slope,) = torch.autograd.grad(loss - plain, prediction)
    # An error ten times smaller pulls harder: 0.01 / 0.0002 against 0.1 / 0.0101.
    ratio = slope[1].mean() / slope[0].mean()
    assert ratio.item() == pytest.approx(50 / 9.901, rel=1e-3)


def test_the_blend_term_is_computed_outside_autocast(monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU refuses the cross entropy of probabilities under autocast; so does this stand-in."""
    entropy = torch.nn.functional.binary_cross_entropy

    def refusing(*tensors: Any) -> Tensor:
        if torch.is_autocast_enabled("cpu"):
            raise RuntimeError("binary_cross_entropy is unsafe to autocast")
        assert all(values.dtype == torch.float32 for values in tensors)
        return entropy(*tensors)

    monkeypatch.setattr("simnfnd.models.training.losses.functional.binary_cross_entropy", refusing)
    source = torch.Generator().manual_seed(0)
    prediction, clean, noisy = torch.rand(3, 2, 1, 5, 7, generator=source)
    batch = {"noisy": noisy, "weight": torch.tensor([0.3, 0.9])}
    loss = build_loss({"kind": "l1", "blend": 1.0})
    exact = loss(prediction, clean, batch)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = loss(prediction, clean, {**batch, "weight": batch["weight"].bfloat16()})
    assert mixed.item() == pytest.approx(exact.item(), rel=0.01)
