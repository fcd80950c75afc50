"""The losses: their formulas, and which of them have a gradient where."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from simnfnd.factory.errors import FactoryError
from simnfnd.models.losses import build_loss

NEW = {
    **{"kind": "newloss", "shadow": "literal", "weight": 1.0, "threshold": 0.1},
    **{"width": 0.02, "width_start": 0.02},
}
SURROGATES = ("ste", "sigmoid", "bce", "dice", "zone")


def image(*values: float) -> Tensor:
    return torch.tensor(values).reshape(1, 1, 1, -1)


def gradient(config: dict[str, Any], prediction: Tensor, clean: Tensor, **known: Tensor) -> Tensor:
    prediction = prediction.clone().requires_grad_()
    build_loss(config)(prediction, clean, known).backward()
    assert prediction.grad is not None
    return prediction.grad


def test_plain_losses_are_their_formulas() -> None:
    a, b = image(0.0, 0.5), image(0.3, 0.5)
    assert build_loss({"kind": "l1"})(a, b).item() == pytest.approx(0.15)
    smooth = {"kind": "charbonnier", "epsilon": 0.4}
    assert build_loss(smooth)(a, b).item() == pytest.approx((0.5 + 0.4) / 2)
    assert gradient(smooth, a, b).flatten().tolist() == pytest.approx([-0.3 / 0.5 / 2, 0])


def test_a_spoke_counts_by_the_mean_along_its_beam() -> None:
    """A faint spoke counts whole; noise of the same mean size that cancels along beams does not."""
    clean = torch.full((1, 1, 8, 12), 0.4)
    maps = {
        "azimuth_rad": torch.linspace(-1, 1, 12).expand(1, 1, 8, 12),
        "range_fraction": torch.linspace(0, 1, 8)[:, None].expand(1, 1, 8, 12),
    }
    spoke, grain = torch.zeros_like(clean), torch.zeros_like(clean)
    spoke[..., 4:6] = 0.06
    grain[..., ::2, :], grain[..., 1::2, :] = 0.01, -0.01
    kind = {"kind": "l1"}
    for noise, beams in ((spoke, 0.01), (grain, 0.0)):
        plain = build_loss(kind)(clean + noise, clean, maps)
        assert plain.item() == pytest.approx(0.01)
        more = build_loss({**kind, "beams": 3.0})(clean + noise, clean, maps) - plain
        assert more.item() == pytest.approx(3 * beams, abs=1e-6)
    unknown = build_loss({**kind, "beams": 3.0})(clean + spoke, clean)
    assert unknown.item() == pytest.approx(0.01), "there are no beams without a geometry"
    outside = torch.ones_like(clean)
    outside[..., 4:6] = 0
    loss = build_loss({**kind, "beams": 3.0})(clean + spoke, clean, {**maps, "sector": outside})
    assert loss.item() == pytest.approx(0.01), "nor outside the sector"


@pytest.mark.parametrize("kind", [{"kind": "l1"}, NEW])
def test_the_squared_difference_is_added_to_any(kind: dict[str, Any]) -> None:
    a, b = image(0.0, 0.5), image(0.3, 0.5)
    more = build_loss({**kind, "square": 2.0})(a, b) - build_loss(kind)(a, b)
    assert more.item() == pytest.approx(2 * 0.09 / 2)


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
    prediction, clean = image(0.05, 0.2, 0.2, 0.1), image(0.3, 0.0, 0.5, 0.1)
    # L1 of the images, and two of four pixels; a grey value of t itself is shadow.
    expected = (0.25 + 0.2 + 0.3) / 4 + 0.5 * 2 / 4
    for shadow in ("literal", "ste"):
        loss = build_loss({**NEW, "shadow": shadow, "weight": 0.5})
        assert loss(prediction, clean).item() == pytest.approx(expected)


@pytest.mark.parametrize("shadow", SURROGATES)
def test_every_surrogate_darkens_shadow_more_than_l1_does(shadow: str) -> None:
    """The first pixel is shadow in truth and just too light; the last is lit and right."""
    prediction, clean = image(0.12, 0.5, 0.6), image(0.0, 0.45, 0.6)
    mask = image(1.0, 0.0, 0.0)
    plain = gradient({"kind": "l1"}, prediction, clean)
    told = gradient({**NEW, "shadow": shadow}, prediction, clean, shadow=mask)
    assert told[..., 0] > plain[..., 0] + 1e-3
    if shadow != "ste":
        # Far from the threshold, or outside the zone, the term is silent.
        torch.testing.assert_close(told[..., 1:], plain[..., 1:], atol=1e-4, rtol=0)


def test_surrogates_are_their_formulas() -> None:
    prediction, clean = image(0.12, 0.09, 0.4), image(0.0, 0.3, 0.5)
    lit = np.array([0, 1, 1])
    chance = 1 / (1 + np.exp(-(np.array([0.12, 0.09, 0.4]) - 0.1) / 0.02))
    shown = 1 - chance
    wanted = {
        "sigmoid": np.abs(chance - lit).mean(),
        "bce": -np.log(np.where(lit, chance, 1 - chance)).mean(),
        "dice": 1 - (2 * shown[0] + 1) / (shown.sum() + 1 + 1),
        "zone": 0.12,
    }
    both = (0.12 + 0.21 + 0.1) / 3
    for shadow, term in wanted.items():
        loss = build_loss({**NEW, "shadow": shadow, "weight": 2.0})
        assert loss(prediction, clean).item() == pytest.approx(both + 2 * term, rel=1e-4), shadow


def test_the_zone_is_the_true_shadow_where_it_is_known() -> None:
    prediction, clean, mask = image(0.5, 0.5), image(0.0, 0.3), image(0.0, 1.0)
    zone = {**NEW, "shadow": "zone"}
    assert build_loss(zone)(prediction, clean).item() == pytest.approx(0.35 + 0.5)
    known = build_loss(zone)(prediction, clean, {"shadow": mask})
    assert known.item() == pytest.approx(0.35 + 0.2)
    nowhere = build_loss(zone)(prediction, clean, {"shadow": torch.zeros_like(mask)})
    assert nowhere.item() == pytest.approx(0.35)


def test_the_soft_threshold_hardens_while_training() -> None:
    """Half a width above the threshold: the gradient of the sigmoid says which width it has."""
    prediction, clean = image(0.11), image(0.0)
    config = {**NEW, "shadow": "sigmoid", "width": 0.01, "width_start": 0.16}
    for progress, width in ((0.0, 0.16), (0.5, 0.04), (1.0, 0.01), (None, 0.01)):
        known = {} if progress is None else {"progress": torch.tensor(progress)}
        chance = 1 / (1 + np.exp(-0.01 / width))
        slope = 1 + chance * (1 - chance) / width
        found = gradient(config, prediction, clean, **known)
        assert found.item() == pytest.approx(slope, rel=1e-4), progress


@pytest.mark.parametrize("kind", [{"kind": "l1"}, NEW])
def test_the_mask_head_learns_the_true_shadow(kind: dict[str, Any]) -> None:
    prediction, clean, mask = image(0.5, 0.5), image(0.5, 0.0), image(0.0, 1.0)
    logits = torch.zeros_like(mask).requires_grad_()
    known = {"shadow": mask, "shadow_logits": logits}
    without = build_loss({**kind, "mask": 0})(prediction, clean, known)
    loss = build_loss({**kind, "mask": 0.3})(prediction, clean, known)
    assert (loss - without).item() == pytest.approx(0.3 * np.log(2), rel=1e-5)
    loss.backward()
    assert logits.grad is not None
    assert logits.grad.flatten().tolist() == pytest.approx([0.3 / 4, -0.3 / 4])
    # Where nobody knows the shadow there is nothing to learn it from.
    unknown = build_loss({**kind, "mask": 0.3})(prediction, clean, {"shadow_logits": logits})
    assert unknown.item() == pytest.approx(without.item())


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
    plain = build_loss(kind)(prediction, clean)
    loss = build_loss({**kind, "decibels": 0.5})(prediction, clean)
    # 10 log10 of 0.0101 and of 0.0002: the floor of 40 dB is added.
    assert (loss - plain).item() == pytest.approx(0.5 * (-19.9568 - 36.9897) / 2, rel=1e-4)
    (slope,) = torch.autograd.grad(loss - plain, prediction)
    # An error ten times smaller pulls harder: 0.01 / 0.0002 against 0.1 / 0.0101.
    ratio = slope[1].mean() / slope[0].mean()
    assert ratio.item() == pytest.approx(50 / 9.901, rel=1e-3)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"kind": "l7"}, r"loss\.kind"),
        ({"kind": "l1", "epsilon": 1}, r"loss\.epsilon: unknown key"),
        ({"kind": "charbonnier"}, r"loss\.epsilon"),
        ({**NEW, "shadow": "hard"}, r"loss\.shadow"),
        ({**NEW, "width": 0}, r"loss\.width"),
        ({"kind": "l1", "mask": -1}, r"loss\.mask"),
    ],
)
def test_odd_losses_are_refused(config: dict[str, Any], words: str) -> None:
    with pytest.raises(FactoryError, match=words):
        build_loss(config)
