"""What lies behind each pixel of an image: optional layers that no noise touches.

An image has lost the elevation, and the object that an echo came from.  Both are known here: each
range bin of each beam tells of the strongest echo in it, and of the object with most of its power.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...common.array_types import Array, Float32s, Int32s, UInt8s, UInt16s
from ...common.errors import FrameError
from ..sonar import polar
from ..sonar.surface import LitSurface

_OF_ECHOES = {"range", "azimuth", "elevation", "elevation_min", "elevation_max", "segmentation"}


def layer_images(requested: Sequence[str], surface: LitSurface) -> dict[str, Array]:
    """(range_bins, beams) images of the requested layers, by the names of `OPTIONAL_LAYERS`.

    requested: of range, azimuth, elevation, elevation_min, elevation_max, valid_azimuth,
        segmentation (which brings instance); other names are ignored.
    Raises FrameError when labels are requested of a frame that has none.
    """
    frame = surface.frame
    sonar = surface.sonar
    layers = dict[str, Array]()
    shape = sonar.range_bins, sonar.beams
    if "valid_azimuth" in requested:
        beams = polar.seen_beams(surface.window, sonar)
        layers["valid_azimuth"] = np.repeat(beams[None], sonar.range_bins, axis=0)
    if not _OF_ECHOES.intersection(requested):
        return layers
    echoes, pixel, _ = surface.shown
    bins = polar.bin_index(echoes, surface.window, sonar)
    # Where several echoes share a bin, the last one assigned stays: the strongest.
    order = np.argsort(echoes.strength, kind="stable")
    strongest = np.full(sonar.range_bins * sonar.beams, -1, np.intp)
    strongest[bins[order]] = order

    def paint_strongest(values: Array, nothing: float) -> Array:
        shown = np.where(strongest >= 0, values[strongest], values.dtype.type(nothing))
        return shown.reshape(shape)

    for name, values in (("range", echoes.range_m), ("elevation", echoes.elevation_rad)):
        if name in requested:
            layers[name] = paint_strongest(values, np.nan)
    for name, take in (("elevation_min", np.fmin), ("elevation_max", np.fmax)):
        if name in requested:
            limit = np.full(strongest.size, np.nan, np.float32)
            take.at(limit, bins, echoes.elevation_rad)
            layers[name] = limit.reshape(shape)
    if "azimuth" in requested:
        azimuth_rad = echoes.azimuth_rad
        if surface.conical:
            azimuth_rad = echoes.azimuths_of_bearings()
        layers["azimuth"] = paint_strongest(azimuth_rad, np.nan)
    if "segmentation" in requested:
        if frame.segmentation is None or frame.instance is None:
            raise FrameError(
                f"{frame.ref.name}: has no labels; leave segmentation out of dataset.layers"
            )
        own = _loudest(
            bins, echoes.strength, frame.segmentation, frame.instance, pixel, strongest.size
        )
        has_echo = strongest >= 0
        shown_pixel = pixel[own[has_echo]]
        for name, plane in (("segmentation", frame.segmentation), ("instance", frame.instance)):
            labels = np.zeros(strongest.size, plane.dtype)
            labels[has_echo] = plane.ravel()[shown_pixel]
            layers[name] = labels.reshape(shape)
    return layers


def _loudest(
    bins: npt.NDArray[np.integer],
    strength: Float32s,
    segmentation: UInt8s,
    instance: UInt16s,
    pixel: Int32s,
    bin_count: int,
) -> npt.NDArray[np.intp]:
    """The echo of each flat bin whose object, or ground, has most of the bin's power.

    bins, strength, pixel: (N,) of the echoes.  Entries of bins without an echo mean nothing.
    """
    of_echo = instance.ravel()[pixel].astype(np.int64)
    # What has no number, ground and fittings, is told apart by its class.
    of_echo = of_echo * 256 + np.where(of_echo > 0, 0, segmentation.ravel()[pixel])
    key = bins.astype(np.int64) * (1 << 24) + of_echo
    keys, first, group = np.unique(key, return_index=True, return_inverse=True)
    power = np.bincount(group, strength)
    order = np.argsort(power, kind="stable")
    loudest = np.zeros(bin_count + 1, np.intp)
    # Where several objects share a bin, the last one assigned stays: the one with most power.
    loudest[keys[order] >> 24] = first[order]
    # The last is of what lies outside.
    return loudest[:bin_count]
