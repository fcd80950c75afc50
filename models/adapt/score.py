"""How near a picture is to one that is nearly free of noise."""

from __future__ import annotations

import numpy as np

from ..data.pairs import Image


def psnr_after_levels(picture: Image, reference: Image) -> float:
    """PSNR in dB where the reference is known, after one gain and offset; at most 100 dB.

    picture, reference: (H, W) float32 in 0..1; the reference is NaN where it is unknown.  The gain
    and offset are those of least squares, so brightness and contrast do not count.
    """
    where = np.isfinite(reference)
    x, y = picture[where].astype(np.float64), reference[where].astype(np.float64)
    spread = float(x.var())
    gain = float(((x - x.mean()) * (y - y.mean())).mean()) / spread if spread > 1e-12 else 0.0
    fitted = np.clip(gain * (x - x.mean()) + y.mean(), 0, 1)
    return float(-10 * np.log10(max(float(np.square(fitted - y).mean()), 1e-10)))
