"""What the network is taught: centres, sides and classes of the objects in an image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ...factory.common.array_types import Float32s, Int64s
from .boxes import Boxes
from .detector import STRIDE
from .images import UNKNOWN
from .network import Outputs

_SPREAD = 0.13  # standard deviation of a centre's peak, as a share of the side of the box
_TAUGHT = 0.45  # cells with at least this heat teach the sides and the class
_SIDES_WEIGHT = 2.0
_CLASS_WEIGHT = 0.3


class Targets(NamedTuple):
    """Targets of the network for N images of h x w cells.

    heat: (N, 1, h, w), 1 at centres, falling to 0.  sides: (N, 4, h, w) in cells.  weight:
    (N, 1, h, w), 0 where no object teaches its sides.  label: (N, h, w), UNKNOWN likewise.
    """

    heat: Tensor
    sides: Tensor
    weight: Tensor
    label: Tensor


def draw_targets(
    boxes: Boxes, labels: Int64s, height: int, width: int
) -> tuple[Float32s, Float32s, Float32s, Int64s]:
    """heat, sides, weight and label of one image of height x width pixels, as in `Targets`."""
    rows = height // STRIDE
    columns = width // STRIDE
    y = np.arange(rows, dtype=np.float32)[:, None] + 0.5
    x = np.arange(columns, dtype=np.float32)[None] + 0.5
    heat = np.zeros((1, rows, columns), np.float32)
    sides = np.ones((4, rows, columns), np.float32)
    weight = np.zeros((1, rows, columns), np.float32)
    label = np.full((rows, columns), UNKNOWN, np.int64)

    # Small objects come last, so that they own the cells that they share with large ones.
    extents = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    for number in np.argsort(-extents, kind="stable"):
        left, top, right, bottom = boxes[number] / STRIDE
        spread_x = max(0.6, _SPREAD * (right - left))
        spread_y = max(0.6, _SPREAD * (bottom - top))
        centre_x = min(int((left + right) / 2), columns - 1) + 0.5
        centre_y = min(int((top + bottom) / 2), rows - 1) + 0.5
        # A normal peak is the product of one along x and one along y.
        peak_x = np.exp(-((x - centre_x) ** 2) / (2 * spread_x**2))
        peak = np.exp(-((y - centre_y) ** 2) / (2 * spread_y**2)) * peak_x
        np.maximum(heat[0], peak, out=heat[0])
        is_taught = (peak >= _TAUGHT) & (x > left) & (x < right) & (y > top) & (y < bottom)
        distances = np.broadcast_arrays(x - left, y - top, right - x, bottom - y)
        sides[:, is_taught] = np.stack(distances)[:, is_taught]
        # Every object has the same say, whatever its size.
        weight[0, is_taught] = peak[is_taught] / max(1e-6, float(peak[is_taught].sum()))
        label[is_taught] = labels[number]
    return heat, sides, weight, label


def detection_loss(outputs: Outputs, targets: Targets) -> Tensor:
    """Scalar: penalty-reduced focal loss of centres, generalised IoU of sides, cross entropy."""
    object_count = (targets.heat == 1).sum().clamp(min=1)
    centre_loss = _centre_loss(outputs.centre, targets.heat) / object_count
    weight = targets.weight[:, 0]
    weight_sum = weight.sum().clamp(min=1e-6)
    sides_loss = (_sides_loss(outputs.sides, targets.sides) * weight).sum() / weight_sum
    loss = centre_loss + _SIDES_WEIGHT * sides_loss
    if outputs.classes.shape[1] < 2:
        return loss
    entropy = functional.cross_entropy(
        outputs.classes, targets.label, ignore_index=UNKNOWN, reduction="none"
    )
    return loss + _CLASS_WEIGHT * (entropy * weight).sum() / weight_sum


def _centre_loss(logits: Tensor, heat: Tensor) -> Tensor:
    """Focal loss with less weight near a centre (Law & Deng 2018, eq. 1), summed."""
    probability = torch.sigmoid(logits)
    at_centre = -functional.logsigmoid(logits) * (1 - probability) ** 2
    elsewhere = -functional.logsigmoid(-logits) * probability**2 * (1 - heat) ** 4
    return torch.where(heat == 1, at_centre, elsewhere).sum()


def _sides_loss(sides: Tensor, truth: Tensor) -> Tensor:
    """1 - generalised IoU (Rezatofighi et al. 2019) of boxes around one cell, (N, h, w)."""
    least = torch.minimum(sides, truth)
    most = torch.maximum(sides, truth)
    shared = (least[:, 0] + least[:, 2]) * (least[:, 1] + least[:, 3])
    hull = (most[:, 0] + most[:, 2]) * (most[:, 1] + most[:, 3])
    own_area = (sides[:, 0] + sides[:, 2]) * (sides[:, 1] + sides[:, 3])
    true_area = (truth[:, 0] + truth[:, 2]) * (truth[:, 1] + truth[:, 3])
    union = own_area + true_area - shared
    overlap = shared / union.clamp(min=1e-6)
    return 1 - overlap + (hull - union) / hull.clamp(min=1e-6)
