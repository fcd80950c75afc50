"""Pictures of what a network does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from models.data import SampleRef, Shards
from models.quality import psnr_db


def denoise_array(network: nn.Module, noisy: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(H, W) float32 in 0..1 -> the same, denoised and clipped to 0..1."""
    device = next(network.parameters()).device
    with torch.inference_mode():
        batch = torch.from_numpy(np.ascontiguousarray(noisy))[None, None].to(device)
        result = network(batch).float().clamp(0, 1)
    return np.asarray(result[0, 0].cpu().numpy(), dtype=np.float32)


def write_samples(path: Path, network: nn.Module, samples: tuple[SampleRef, ...]) -> None:
    """A sheet of noisy | denoised | clean, one row a sample, with the PSNR of each."""
    from matplotlib.figure import Figure  # slow to import, and needed at the very end only

    shards = Shards()
    figure = Figure(figsize=(9.6, 3.35 * len(samples)), layout="constrained", facecolor="white")
    axes = figure.subplots(len(samples), 3, squeeze=False)
    for row, sample in zip(axes, samples, strict=True):
        noisy, clean = shards.pair(sample)
        denoised = denoise_array(network, noisy)
        panels = {
            f"noisy, {_psnr(noisy, clean):.2f} dB": noisy,
            f"denoised, {_psnr(denoised, clean):.2f} dB": denoised,
            f"clean - {sample.scene} {sample.frame}": clean,
        }
        for axis, (title, image) in zip(row, panels.items(), strict=True):
            axis.imshow(image, cmap="gray", vmin=0, vmax=1)
            axis.set_title(title, fontsize=9)
            axis.set_axis_off()
    figure.savefig(path, dpi=110)


def _psnr(image: npt.NDArray[np.float32], clean: npt.NDArray[np.float32]) -> float:
    return float(psnr_db(torch.from_numpy(image)[None, None], torch.from_numpy(clean)[None, None]))
