"""Denoising of single images, and pictures of the results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ..data.pairs import Batch
from ..networks.network import Network

_GAP = 4


def denoise_batch(network: nn.Module, batch: Batch) -> npt.NDArray[np.float32]:
    """(H, W) float32 in 0..1: the image of a batch of one, denoised and clipped."""
    image, weight = denoise_with_weight(network, batch)
    noisy = np.asarray(batch["noisy"][0, 0].numpy(), np.float32)
    return np.asarray(np.clip(noisy + np.float32(weight) * (image - noisy), 0, 1), np.float32)


def denoise_with_weight(network: nn.Module, batch: Batch) -> tuple[npt.NDArray[np.float32], float]:
    """(H, W) float32 with the whole change, and the part of it that the picture should get.

    The part is 1 of a network without heads.
    """
    device = next(network.parameters()).device
    known = {n: batch[n].to(device) for n in getattr(network, "extras", ()) if n in batch}
    noisy, weight = batch["noisy"].to(device), 1.0
    with torch.inference_mode():
        if isinstance(network, Network) and network.has_heads:
            output = network.with_heads(noisy, **known)
            result, weight = output.image, float(output.weight[0])
        else:
            result = network(noisy, **known)
    return np.asarray(result[0, 0].float().cpu().numpy(), dtype=np.float32), weight


def contact_sheet(network: nn.Module, batches: Sequence[Batch]) -> npt.NDArray[np.uint8]:
    """(H, W) uint8: noisy | denoised (| clean), one row a batch of one, all of the first's size."""
    lines = []
    for batch in batches:
        known = [batch[name][0, 0].numpy() for name in ("noisy", "clean") if name in batch]
        images = [known[0], denoise_batch(network, batch), *known[1:]]
        gap = np.full((len(images[0]), _GAP), 0.5, np.float32)
        line = np.concatenate([part for image in images for part in (gap, image)][1:], axis=1)
        lines += [np.full((_GAP, line.shape[1]), 0.5, np.float32), line]
    width = lines[1].shape[1]
    sheet = np.concatenate([_fitted(line, width) for line in lines[1:]])
    return np.asarray(np.rint(np.clip(sheet, 0, 1) * 255), dtype=np.uint8)


def _fitted(line: npt.NDArray[np.float32], width: int) -> npt.NDArray[np.float32]:
    line = line[:, :width]
    return np.pad(line, ((0, 0), (0, width - line.shape[1])))


def write_grey(path: Path, image: npt.NDArray[np.uint8]) -> None:
    """Write a picture, whole or not at all."""
    done, content = cv2.imencode(path.suffix, image)
    if not done:
        raise FactoryError(f"{path}: cannot be encoded as a picture")
    write_atomically(path, content.tobytes(), durable=False, key="out")
