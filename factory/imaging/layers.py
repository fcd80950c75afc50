"""What lies behind each pixel of a picture: optional layers that no noise touches.

A picture has lost the elevation, and the object that an echo came from.  Both are known here: each
range bin of each beam tells of the strongest echo in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..errors import FrameError
from ..sonar import polar
from ..sonar.polar import Echoes
from ..sonar.settings import SonarSettings
from ..sonar.surface import LitSurface
from ..sonar.window import Window

Picture = npt.NDArray[np.generic]

_OF_ECHOES = {"range", "azimuth", "elevation", "elevation_min", "elevation_max", "segmentation"}


def pictures(requested: Sequence[str], surface: LitSurface) -> dict[str, Picture]:
    """(range_bins, beams) pictures of the requested layers, by the names of `OPTIONAL_LAYERS`.

    requested: of range, azimuth, elevation, elevation_min, elevation_max, valid_azimuth,
        segmentation (which brings instance); other names are ignored.
    Raises FrameError when labels are requested of a frame that has none.
    """
    frame, sonar = surface.frame, surface.sonar
    made: dict[str, Picture] = {}
    if "valid_azimuth" in requested:
        beams = polar.seen_beams(surface.window, sonar)
        made["valid_azimuth"] = np.repeat(beams[None], sonar.range_bins, axis=0)
    if not _OF_ECHOES.intersection(requested):
        return made
    echoes, pixel, _ = surface.insonified
    strongest = _strongest(echoes, surface.window, sonar)
    if "range" in requested:
        made["range"] = _lookup(echoes.range_m, strongest, np.nan)
    if "elevation" in requested:
        made["elevation"] = _lookup(echoes.elevation_rad, strongest, np.nan)
    for name, take in (("elevation_min", np.fmin), ("elevation_max", np.fmax)):
        if name in requested:
            bins = polar.bin_index(echoes, surface.window, sonar)
            limit = np.full(strongest.size + 1, np.nan, np.float32)
            take.at(limit, bins, echoes.elevation_rad)
            made[name] = limit[:-1].reshape(strongest.shape)
    if "azimuth" in requested:
        made["azimuth"] = _lookup(_azimuth_rad(surface), strongest, np.nan)
    if "segmentation" in requested:
        if frame.segmentation is None or frame.instance is None:
            raise FrameError(
                f"{frame.ref.name}: has no labels; leave segmentation out of dataset.layers"
            )
        made["segmentation"] = _lookup(frame.segmentation.ravel()[pixel], strongest, 0)
        made["instance"] = _lookup(frame.instance.ravel()[pixel], strongest, 0)
    return made


def _azimuth_rad(surface: LitSurface) -> npt.NDArray[np.float32]:
    echoes = surface.insonified.echoes
    if not surface.conical:
        return echoes.azimuth_rad
    # Echoes are laid out by the cones of the beams, whose sine has the elevation in it.
    sine = np.sin(echoes.azimuth_rad) / np.cos(echoes.elevation_rad)
    return np.asarray(np.arcsin(np.clip(sine, -1, 1)))


def _strongest(echoes: Echoes, window: Window, sonar: SonarSettings) -> npt.NDArray[np.intp]:
    """(range_bins, beams) number of the strongest echo of each bin, -1 where none is."""
    order = np.argsort(echoes.strength, kind="stable")
    number = np.full(sonar.range_bins * sonar.beams, -1, np.intp)
    # Of several echoes in a bin the last one assigned stays: the strongest.
    number[polar.bin_index(echoes, window, sonar)[order]] = order
    return number.reshape(sonar.range_bins, sonar.beams)


def _lookup(
    values: npt.NDArray[np.generic], number: npt.NDArray[np.intp], nothing: float
) -> Picture:
    """`values` of the numbered echoes, `nothing` where the number is -1."""
    return np.where(number >= 0, values[number], values.dtype.type(nothing))
