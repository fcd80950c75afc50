"""`torch.hub.load(REPOSITORY, "denoiser")`: the denoiser that ships, or one by its weights."""

from __future__ import annotations

from simnfnd.models.denoise.hub import HubDenoiser

dependencies = ["torch", "numpy", "cv2", "scipy", "safetensors"]


def denoiser(weights: str | None = None, device: str = "cpu") -> HubDenoiser:
    """An `nn.Module`: (N, 1, H, W) float in 0..1 -> the same, denoised.

    weights: the name of weights that ship, a file, or a repository of the Hugging Face Hub; None:
    `simnfnd`.  device: where the module is.
    """
    return HubDenoiser(weights).to(device).eval()
