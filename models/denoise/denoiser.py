"""Trained weights as a function that denoises one picture."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise.files import Gray
from simnfnd.models.denoise.tile import Maps, tiled

TILE, OVERLAP = 1024, 96


class Denoiser:
    """Trained weights as a function of a picture.

    digest: SHA-256 of the weights file.  tile, overlap: see `simnfnd.models.denoise.tile`.
    pictures, unchanged: how many pictures it was given, and how many it returned unchanged.
    """

    def __init__(
        self, weights: Path, device: str, tile: int, overlap: int, always: bool = False
    ) -> None:
        """always: also denoise pictures for which the network expects too small a gain.

        Raises FactoryError for a file that holds no weights, and for a GPU that is not there.
        """
        import torch  # seconds; `--help` and typing errors need not wait for it

        from simnfnd.models.networks.weights import load_weights

        self.trained = load_weights(weights)
        self.digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        self.tile, self.overlap = tile, overlap
        self.pictures = self.unchanged = 0
        network = self.trained.network
        self._least_gain_db = None if always else network.least_gain_db
        # The limit is applied to whole pictures below: single unchanged tiles would be visible.
        network.disable_gain_limit()
        has_gpu = torch.cuda.is_available()
        if device == "gpu" and not has_gpu:
            raise FactoryError("--device gpu: no usable GPU here; use --device cpu")
        if has_gpu and device != "cpu":
            network.to("cuda")

    def __call__(
        self, gray: Gray, geometry: FanGeometry | None = None, *, layout: str | None = None
    ) -> Gray:
        """(H, W) float32 in 0..1 -> the same, denoised.

        geometry: where range and bearing are, if that is known; or layout `polar`: rows are ranges,
        near range first, and the columns span 30 degrees.
        """
        if geometry is None and layout == "polar":
            geometry = FanGeometry.polar().with_size(*gray.shape)
        extras = self.trained.network.extras
        maps = {}
        if geometry is not None and extras:
            found = geometry.maps(0, 0, *gray.shape)
            maps = {name: found[name] for name in extras if name in found}
        gains_db: list[float] = []
        areas: list[int] = []

        def denoise_tile(part: Gray, maps: Maps) -> Gray:
            denoised, gain_db = self._denoise_tile(part, maps)
            if gain_db is not None:
                gains_db.append(gain_db)
                areas.append(part.size)
            return denoised

        denoised = tiled(denoise_tile, gray, maps, self.tile, self.overlap)
        self.pictures += 1
        least_db = self._least_gain_db
        if least_db is not None and np.average(gains_db, weights=areas) < least_db:
            self.unchanged += 1
            return gray.copy()
        return denoised

    def _denoise_tile(self, gray: Gray, maps: Maps) -> tuple[Gray, float | None]:
        import torch

        from simnfnd.models.training.samples import denoise_with_gain

        images = {"noisy": gray, **maps}
        batch = {
            name: torch.from_numpy(np.ascontiguousarray(image))[None, None]
            for name, image in images.items()
        }
        return denoise_with_gain(self.trained.network, batch)


def load_denoiser(
    weights: str | Path | None = None,
    device: str = "auto",
    *,
    tile: int = TILE,
    overlap: int = OVERLAP,
    always: bool = False,
) -> Denoiser:
    """A function that denoises one gray image.

    weights: a file that training wrote, the name of weights that ship, or None for the default of
    these.  always: see `Denoiser`.
    Raises FactoryError when there are none, and as `Denoiser` does.
    """
    from simnfnd.models.pretrained import find_weights

    return Denoiser(find_weights(weights), device, tile, overlap, always)
