"""Trained weights as a function that denoises one image.

Large ones go in overlapping tiles, and those with wide grain at half their size first.  A display
that enlarges makes grain wider than any that a network has learned from, which then takes it for
ground.  At half the size the grain is as it should be.  The change found there is enlarged and
added, and the image with less noise denoised as it is, which finds edges and what is left.
Weights for the polar grid have another way, `wide_cells`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s, Float64s
from ...factory.common.errors import FactoryError
from ...factory.common.files import sha256_of
from ...factory.dataset.fan_geometry import FanGeometry
from ..networks import averaged
from ..networks.bearing_view import bearing_view, remaining_share, sector_of, share_at
from ..pretrained import find_weights
from ..recordings.views import presentation_of
from .grain_width import grain_correlation
from .images import block_means
from .left_detail import corrected_by_detail
from .polar import Maps
from .runtime import open_runtime
from .saturated import with_saturated
from .wide_cells import by_cells

Work = Callable[[Float32s, Maps], Float32s]

_SEVERAL = 1.5
"""Mean number of frames from which on grain belongs to the scene: the image is not halved."""
_LIT = 0.1
_LIT_SHARE = 0.01
"""Around a fan, the grey value of lit pixels and their share from which on it is a lit page."""
_RAMP = 0.02  # of the correlation: from nothing to the whole change of the smaller image
_BLACK_SIDE_PX = 5
_LEAST_INTERFERENCE = 0.5 / 255  # half a grey value of 8 bits
_LEAST_SIDE = 96  # of an image that may still be halved, pixels


class _GeometryMaps(NamedTuple):
    """The maps of a geometry in an image of a shape, (H, W)."""

    geometry: FanGeometry
    shape: tuple[int, int]
    maps: Maps


class Denoiser:
    """Trained weights as a function of an image.

    name: of the weights file.  digest: its SHA-256.  runtime: what computes it.
    knows_frames: whether the weights know how many frames were averaged; else `frames` changes
    nothing.  tile, overlap: see `tiled`.
    """

    tile = 1024
    overlap = 96

    def __init__(self, weights: str | Path | None = None, device: str = "auto") -> None:
        """weights: a file, or a name, as `pretrained.find_weights` takes it.

        Raises FactoryError for weights that are not there and a GPU that is not.
        """
        path = find_weights(weights)
        self.runtime = open_runtime(path, device)
        self.name = path.name if path.stem == "weights" else path.stem
        self.digest = sha256_of(path)
        self._last_maps: _GeometryMaps | None = None
        self.knows_frames = "frames" in self.runtime.extras

    def __call__(
        self,
        grey: Float32s,
        geometry: FanGeometry | None = None,
        *,
        frames: float | Float32s | None = None,
    ) -> Float32s:
        """(H, W) float32 in 0..1 -> the same, denoised.

        geometry: where range and bearing are, if that is known.  frames: how many were averaged in
        the image, 1 or more, or (H, W) float32 of how many in each pixel: one over the sum of the
        squared weights, where these add up to 1; None, or 1 everywhere: a single frame.
        The weights get the image by its `presentation_of`, and where their model says so, one of
        wide grain `by_scales` and one of wide cells `by_cells`.
        """
        if frames is not None and np.max(frames) <= 1:
            frames = None
        presentation = presentation_of(grey, geometry)
        shape = grey.shape
        grey = presentation.shown(grey)
        extras = self.runtime.extras
        widest = self.runtime.wide_grain
        maps: dict[str, Float32s] = {}
        if presentation.geometry is not None and extras:
            known_maps = self._maps_of(presentation.geometry, *grey.shape)
            maps = {name: known_maps[name] for name in extras if name in known_maps}
        if frames is not None and self.knows_frames:
            frame_counts = np.broadcast_to(np.asarray(frames, np.float32), shape)
            frame_counts = averaged(np.rot90(frame_counts, presentation.quarter_turns))
            maps["frames"] = np.ascontiguousarray(frame_counts, np.float32)
            widest = 1.0 if frame_counts.mean() > averaged(_SEVERAL) else widest
        # Weights have seen black surroundings of a sector alone.
        outside = maps.get("sector", np.ones_like(grey)) <= 0
        bright = bool(outside.any()) and (grey[outside] > _LIT).mean() > _LIT_SHARE
        shown = np.where(outside, np.float32(0), grey) if bright else grey
        if "bearings" in extras and presentation.geometry is not None:
            shown = self._without_interference(shown, presentation.geometry, maps)
        if self.runtime.average_cells:
            denoised = by_cells(shown, maps, self._denoise_whole)
        else:
            denoised = by_scales(shown, maps, self._denoise_whole, widest)
        if frames is None and self.knows_frames:
            denoised = with_saturated(corrected_by_detail(shown, denoised), shown)
            denoised = np.where(_surroundings_are_black(grey), np.float32(0), denoised)
        if bright:
            denoised = np.where(outside, grey, denoised)
        return presentation.undone(denoised)

    def _without_interference(self, grey: Float32s, geometry: FanGeometry, maps: Maps) -> Float32s:
        """The image without the interference along whole bearings."""
        sector = sector_of(geometry)
        width_rad = sector.right_rad - sector.left_rad
        view = bearing_view(grey, geometry)
        nodes = self.runtime.interference(view, width_rad)
        if nodes.max() < _LEAST_INTERFERENCE:
            return grey
        shares = remaining_share(nodes, view)
        share = share_at(shares, sector, maps["range_fraction"], maps["azimuth_rad"])
        return np.where(maps["sector"] > 0, share * grey, grey)

    def _maps_of(self, geometry: FanGeometry, height: int, width: int) -> Maps:
        """The maps of a geometry, the same arrays for every frame of a recording."""
        last = self._last_maps
        if last is None or last.shape != (height, width) or last.geometry != geometry:
            last = _GeometryMaps(geometry, (height, width), geometry.maps(0, 0, height, width))
            self._last_maps = last
        return last.maps

    def _denoise_whole(self, grey: Float32s, maps: Maps) -> Float32s:
        tiles: list[tuple[float, int]] = []
        # The head that weighs knows single frames; of means it takes too little.
        weighs = "frames" not in maps or maps["frames"].mean() <= averaged(_SEVERAL)

        def denoise_tile(part: Float32s, maps: Maps) -> Float32s:
            denoised, weight = self.runtime.run(part, maps, weighs=bool(weighs))
            tiles.append((1.0 if weight is None else weight, part.size))
            return denoised

        denoised = tiled(denoise_tile, grey, maps, self.tile, self.overlap)
        # One weight for the whole image: single tiles with less change would be visible.
        weights, areas = zip(*tiles, strict=True)
        weight = np.float32(np.average(weights, weights=areas) if weighs else 1)
        result = np.asarray(np.clip(grey + weight * (denoised - grey), 0, 1), np.float32)
        if not np.isfinite(result).all():
            raise FactoryError(f"weights={self.name}: make NaN of this image; train again")
        return result


def _surroundings_are_black(grey: Float32s) -> Bools:
    """(H, W): where a square around the pixel holds no echo at all; in grain some pixel does."""
    square = np.ones((_BLACK_SIDE_PX, _BLACK_SIDE_PX), np.uint8)
    return np.asarray(cv2.dilate(grey, square, borderType=cv2.BORDER_REPLICATE) <= 0)


def by_scales(grey: Float32s, maps: Maps, denoise: Work, widest: float) -> Float32s:
    """`denoise` of an image, (H, W) in 0..1, first at smaller sizes while its grain is wide.

    maps: planes of the image for `denoise`, (H, W), some perhaps `sector`.
    widest: correlation of the grain of neighbouring pixels from which on it is wide; 1: never.
    """
    part = np.float32(0)
    if widest < 1 and min(grey.shape) >= 2 * _LEAST_SIDE:
        part = np.float32(np.clip((grain_correlation(grey) - widest) / _RAMP, 0, 1))
    if part == 0:
        return denoise(grey, maps)
    small = block_means(grey, 2)
    below = {name: block_means(plane, 2) for name, plane in maps.items()}
    if "sector" in below:
        below["sector"] = (below["sector"] > 0.5).astype(np.float32)
    change = by_scales(small, below, denoise, widest) - small
    height, width = grey.shape
    size = 2 * change.shape[1], 2 * change.shape[0]
    enlarged = cv2.resize(change, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    if "sector" in maps:
        enlarged = enlarged * (maps["sector"] > 0)
    return denoise(np.clip(grey + part * enlarged, 0, 1).astype(np.float32), maps)


def tiled(work: Work, image: Float32s, maps: Maps, tile: int, overlap: int) -> Float32s:
    """`work` on tiles of at most `tile` pixels a side, put together again.

    image, and each of maps: (H, W).  Where tiles overlap, their weights rise and fall linearly over
    the `overlap` nearest the edge, half a tile at most.  An image that fits one tile goes through
    as it is.
    """
    height, width = image.shape
    if height <= tile and width <= tile:
        return work(image, maps)
    total = np.zeros(image.shape, np.float64)
    weights = np.zeros(image.shape, np.float64)
    for top in _starts(height, tile, overlap):
        for left in _starts(width, tile, overlap):
            window = np.s_[top : top + tile, left : left + tile]
            part = work(image[window], {name: values[window] for name, values in maps.items()})
            weight = np.outer(*(_ramp(side, overlap) for side in part.shape))
            total[window] += weight * part
            weights[window] += weight
    return (total / weights).astype(np.float32)


def _starts(size: int, tile: int, overlap: int) -> list[int]:
    """First pixels of tiles that cover `size`, evenly spread, each sharing >= `overlap` pixels."""
    if size <= tile:
        return [0]
    count = math.ceil((size - overlap) / (tile - overlap))
    return [round(number * (size - tile) / (count - 1)) for number in range(count)]


def _ramp(size: int, overlap: int) -> Float64s:
    """(size,) weights that rise from both edges over `overlap` pixels, and are never quite 0."""
    edge = np.minimum(np.arange(size), np.arange(size)[::-1]) + 1.0
    return np.minimum(edge / (overlap + 1), 1.0)
