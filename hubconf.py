"""`torch.hub.load(REPOSITORY, "denoiser")`: the denoiser that ships, or one by its weights."""

from __future__ import annotations

from simnfnd.models.denoise.denoiser import Denoiser

dependencies = ["numpy", "cv2", "scipy", "onnxruntime", "safetensors"]


def denoiser(weights: str | None = None, device: str = "auto") -> Denoiser:
    """(H, W) float32 in 0..1 -> the same, denoised.

    weights: the name of weights that ship, a file, or a repository of the Hugging Face Hub; None:
    `simnfnd`.  device: auto, cpu or gpu.
    """
    return Denoiser(weights, device)
