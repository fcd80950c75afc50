"""Trained weights as a function that denoises one picture."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.sonar.geometry import FanGeometry
from ..recordings.presentation import presentation_of
from ..removal import averaged
from .pictures import Gray
from .runtime import open_runtime
from .sizes import Maps, by_scales, tiled

TILE, OVERLAP = 1024, 96
_SEVERAL = 1.5
"""From so many frames on average on, grain is the scene's: the picture is not halved first."""
_LIT, _LIT_SHARE = 0.1, 0.01
"""Grey value, and part of what is around a fan with more: a page, or panels of a screen."""


class Denoiser:
    """Trained weights as a function of a picture.

    name: of the weights file.  digest: its SHA-256.  runtime: what computes it.
    tile, overlap: see `simnfnd.models.denoise.sizes`.
    """

    def __init__(
        self,
        weights: Path,
        device: str,
        tile: int,
        overlap: int,
        strength: float = 1.0,
    ) -> None:
        """strength: part of the change that a picture gets, 0 to 1.

        Raises FactoryError for a file that holds no weights and a GPU that is not there.
        """
        self.runtime = open_runtime(weights, device)
        self.name = weights.name if weights.stem == "weights" else weights.stem
        self.digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        self.tile, self.overlap, self.strength = tile, overlap, np.float32(strength)

    @property
    def knows_frames(self) -> bool:
        """Whether the weights know how many frames were averaged; else `frames` changes nothing."""
        return "frames" in self.runtime.extras

    def __call__(
        self,
        gray: Gray,
        geometry: FanGeometry | None = None,
        *,
        frames: float | Gray | None = None,
    ) -> Gray:
        """(H, W) float32 in 0..1 -> the same, denoised.

        geometry: where range and bearing are, if that is known.  frames: how many were averaged in
        the picture, 1 or more, or (H, W) float32 of how many in each pixel: one over the sum of the
        squared weights, where these add up to 1; None: a single frame.
        The weights get the picture by its `presentation_of`, and one of wide grain `by_scales`.
        """
        given = presentation_of(gray, geometry)
        told = None
        if frames is not None and self.knows_frames:
            told = np.broadcast_to(np.asarray(frames, np.float32), gray.shape)
            told = averaged(np.rot90(told, given.quarter_turns))
        return given.undone(self._denoise(given.shown(gray), given.geometry, told))

    def _denoise(self, gray: Gray, geometry: FanGeometry | None, frames: Gray | None) -> Gray:
        network = self.runtime
        maps: dict[str, Gray] = {}
        if geometry is not None and network.extras:
            found = geometry.maps(0, 0, *gray.shape)
            maps = {name: found[name] for name in network.extras if name in found}
        widest = network.wide_grain
        if frames is not None:
            maps["frames"] = np.ascontiguousarray(frames, np.float32)
            widest = 1.0 if frames.mean() > averaged(_SEVERAL) else widest
        outside = _surroundings(gray, maps)
        shown = gray if outside is None else np.where(outside, np.float32(0), gray)
        denoised = by_scales(shown, maps, self._denoise_whole, widest)
        if outside is not None:
            denoised = np.where(outside, gray, denoised)
        if self.strength == 1:
            return denoised
        return np.asarray(np.clip(gray + self.strength * (denoised - gray), 0, 1), np.float32)

    def _denoise_whole(self, gray: Gray, maps: Maps) -> Gray:
        weights: list[float] = []
        areas: list[int] = []

        def denoise_tile(part: Gray, maps: Maps) -> Gray:
            denoised, weight = self.runtime.run(part, maps)
            weights.append(weight)
            areas.append(part.size)
            return denoised

        denoised = tiled(denoise_tile, gray, maps, self.tile, self.overlap)
        # One weight for the whole picture: single tiles with less change would be visible.
        weight = np.float32(np.average(weights, weights=areas))
        if "frames" in maps and maps["frames"].mean() > averaged(_SEVERAL):
            # The head that weighs knows single frames; of means it takes too little.
            weight = np.float32(1)
        return np.asarray(np.clip(gray + weight * (denoised - gray), 0, 1), np.float32)


def _surroundings(gray: Gray, maps: Maps) -> npt.NDArray[np.bool_] | None:
    """(H, W) outside the sector, where that is not black: weights have seen black ones alone."""
    if "sector" not in maps:
        return None
    outside = maps["sector"] <= 0
    return outside if outside.any() and (gray[outside] > _LIT).mean() > _LIT_SHARE else None


def load_denoiser(
    weights: str | Path | None = None,
    device: str = "auto",
    *,
    tile: int = TILE,
    overlap: int = OVERLAP,
    strength: float = 1.0,
) -> Denoiser:
    """A function that denoises one gray image.

    weights: a file that training wrote, the name of weights that ship, or None for the default of
    these.  strength: see `Denoiser`.
    Raises FactoryError when there are none, and as `Denoiser` does.
    """
    from ..pretrained import find_weights

    return Denoiser(find_weights(weights), device, tile, overlap, strength)
