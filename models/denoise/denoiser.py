"""Trained weights as a function that denoises one picture."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ..recordings.presentation import presentation_of
from ..removal import DEFAULT, vector
from .pictures import Gray
from .scales import by_scales
from .tile import Maps, tiled

TILE, OVERLAP = 1024, 96
EXACT = "32-true"
PRECISIONS = ("auto", EXACT, "bf16-mixed")
"""Arithmetic of a denoiser, in the words of `train.precision`."""
_LIT, _LIT_SHARE = 0.1, 0.01
"""Grey value, and part of what is around a fan with more: a page, or panels of a screen."""


class Denoiser:
    """Trained weights as a function of a picture.

    digest: SHA-256 of the weights file.  tile, overlap: see `simnfnd.models.denoise.tile`.
    """

    def __init__(
        self,
        weights: Path,
        device: str,
        tile: int,
        overlap: int,
        remove: Sequence[str] | None = None,
        strength: float = 1.0,
        precision: str = EXACT,
    ) -> None:
        """remove: artefacts of `formation.contract.ARTEFACTS`; None: the usual ones.

        strength: part of the change that a picture gets, 0 to 1.
        precision: one of PRECISIONS; auto is bf16-mixed where the device has instructions for it.
        Raises FactoryError for a file that holds no weights, for a GPU that is not there, and for
        artefacts that there are not or that the network cannot be asked for.
        """
        import torch  # seconds; `--help` and typing errors need not wait for it

        from ..networks.weights import load_weights

        self.trained = load_weights(weights)
        self.digest = hashlib.sha256(weights.read_bytes()).hexdigest()
        self.tile, self.overlap, self.strength = tile, overlap, np.float32(strength)
        network = self.trained.network
        self._told = _told(network.extras, remove)
        has_gpu = torch.cuda.is_available()
        if device == "gpu" and not has_gpu:
            raise FactoryError("--device gpu: no usable GPU here; use --device cpu")
        self._device = "cuda" if has_gpu and device != "cpu" else "cpu"
        network.to(self._device)
        self._half = _is_half(precision, self._device)

    def __call__(
        self,
        gray: Gray,
        geometry: FanGeometry | None = None,
        *,
        layout: str | None = None,
        looks: Sequence[Gray] = (),
    ) -> Gray:
        """(H, W) float32 in 0..1 -> the same, denoised.

        geometry: where range and bearing are, if that is known; or layout `polar`: rows are ranges,
        near range first, and the columns span 30 degrees.  looks: an odd number of pictures of the
        same scene, itself in the middle, for weights that see several (`looks`).  The weights get
        the picture by its `presentation_of`, and one of wide grain `by_scales`.
        """
        given = presentation_of(gray, known_geometry(geometry, layout, gray))
        shown = [given.shown(look) for look in looks]
        return given.undone(self._denoise(given.shown(gray), given.geometry, shown))

    def _denoise(self, gray: Gray, geometry: FanGeometry | None, looks: Sequence[Gray]) -> Gray:
        network = self.trained.network
        maps: dict[str, Gray] = {}
        if geometry is not None and network.extras:
            found = geometry.maps(0, 0, *gray.shape)
            maps = {name: found[name] for name in network.extras if name in found}
        if self.looks > 1 and looks:
            maps["looks"] = np.stack(looks, axis=-1)  # tiles cut the first two axes
        outside = _surroundings(gray, maps)
        shown = gray if outside is None else np.where(outside, np.float32(0), gray)
        denoised = by_scales(shown, maps, self._denoise_whole, network.wide_grain)
        if outside is not None:
            denoised = np.where(outside, gray, denoised)
        if self.strength == 1:
            return denoised
        return np.asarray(np.clip(gray + self.strength * (denoised - gray), 0, 1), np.float32)

    def _denoise_whole(self, gray: Gray, maps: Maps) -> Gray:
        weights: list[float] = []
        areas: list[int] = []

        def denoise_tile(part: Gray, maps: Maps) -> Gray:
            denoised, weight = self._denoise_tile(part, maps)
            weights.append(weight)
            areas.append(part.size)
            return denoised

        denoised = tiled(denoise_tile, gray, maps, self.tile, self.overlap)
        # One weight for the whole picture: single tiles with less change would be visible.
        weight = np.float32(np.average(weights, weights=areas))
        return np.asarray(np.clip(gray + weight * (denoised - gray), 0, 1), np.float32)

    @property
    def looks(self) -> int:
        """How many pictures of a scene the weights see at once."""
        return self.trained.network.looks

    def _denoise_tile(self, gray: Gray, maps: Maps) -> tuple[Gray, float]:
        import torch

        from ..training.samples import denoise_with_weight

        images = {"noisy": gray, **maps}
        batch = {
            name: torch.from_numpy(np.ascontiguousarray(image))[None, None]
            for name, image in images.items()
            if name != "looks"
        }
        if "looks" in maps:
            looks = np.ascontiguousarray(np.moveaxis(maps["looks"], -1, 0))
            batch["looks"] = torch.from_numpy(looks)[None]
        if self._told is not None:
            batch["remove"] = torch.from_numpy(self._told)[None]
        with torch.autocast(self._device, torch.bfloat16, enabled=self._half):
            return denoise_with_weight(self.trained.network, batch)


def _surroundings(gray: Gray, maps: Maps) -> npt.NDArray[np.bool_] | None:
    """(H, W) outside the sector, where that is not black: weights have seen black ones alone."""
    if "sector" not in maps:
        return None
    outside = maps["sector"] <= 0
    return outside if outside.any() and (gray[outside] > _LIT).mean() > _LIT_SHARE else None


def known_geometry(
    geometry: FanGeometry | None, layout: str | None, gray: Gray
) -> FanGeometry | None:
    """The geometry of a picture, where it or its layout tells one; see `Denoiser.__call__`."""
    if geometry is None and layout == "polar":
        return FanGeometry.polar().with_size(*gray.shape)
    return geometry


def _is_half(precision: str, device: str) -> bool:
    """Whether to compute in bfloat16; FactoryError for an unknown precision."""
    from ..training.precision import cpu_has_bf16, gpu_has_bf16

    if precision not in PRECISIONS:
        raise FactoryError(f"--precision {precision}: is none of {', '.join(PRECISIONS)}")
    if precision == "auto":
        return cpu_has_bf16() if device == "cpu" else gpu_has_bf16()
    return precision != EXACT


def _told(extras: Sequence[str], remove: Sequence[str] | None) -> Gray | None:
    """What the network is told to remove, (6,); None where it cannot be told."""
    if "remove" not in extras:
        if remove is not None:
            raise FactoryError(
                "--remove: these weights always remove the same; use those that ship, or train "
                "model=sonarnet"
            )
        return None
    try:
        return vector(DEFAULT if remove is None else remove)
    except ValueError as error:
        raise FactoryError(f"--remove: {error}") from error


def load_denoiser(
    weights: str | Path | None = None,
    device: str = "auto",
    *,
    tile: int = TILE,
    overlap: int = OVERLAP,
    remove: Sequence[str] | None = None,
    strength: float = 1.0,
    precision: str = EXACT,
) -> Denoiser:
    """A function that denoises one gray image.

    weights: a file that training wrote, the name of weights that ship, or None for the default of
    these.  remove, strength, precision: see `Denoiser`.
    Raises FactoryError when there are none, and as `Denoiser` does.
    """
    from ..pretrained import find_weights

    return Denoiser(find_weights(weights), device, tile, overlap, remove, strength, precision)
