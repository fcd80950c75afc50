"""Echoes -> polar image: range bins x beams; elevation is integrated and lost."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from factory.echoes import Echoes
from factory.sonar.settings import SonarSettings
from factory.sonar.window import Window

Polar = npt.NDArray[np.float32]


def beam_index(azimuth_rad: npt.NDArray[np.floating], sonar: SonarSettings) -> npt.NDArray[np.intp]:
    """(N,) beam of each azimuth; -1 or `beams` outside the sector.

    Uniform beams: floor((azimuth + hfov/2) / dtheta).  Tabled beams: the nearest direction.
    """
    if sonar.beam_azimuths_deg is None:
        half = np.float32(np.deg2rad(sonar.hfov_deg) / 2)
        scale = np.float32(sonar.beams / (2 * half))
        return np.asarray(np.floor((azimuth_rad + half) * scale), dtype=np.intp)
    centres = sonar.beam_centres_rad()
    beam = np.searchsorted((centres[1:] + centres[:-1]) / 2, azimuth_rad, side="right")
    outside = np.abs(azimuth_rad) > np.deg2rad(sonar.hfov_deg) / 2
    return np.where(outside, -1, beam)


def bin_index(echoes: Echoes, window: Window, sonar: SonarSettings) -> npt.NDArray[np.intp]:
    """(N,) flat index range_bin * beams + beam, or -1 for an echo outside the window or sector."""
    row = np.floor(window.range_fraction(echoes) * np.float32(sonar.range_bins)).astype(np.intp)
    beam = beam_index(echoes.azimuth_rad, sonar)
    inside = (row >= 0) & (row < sonar.range_bins) & (beam >= 0) & (beam < sonar.beams)
    return np.where(inside, row * sonar.beams + beam, -1)


def accumulate(echoes: Echoes, window: Window, sonar: SonarSettings) -> Polar:
    """(range_bins, beams) float32 echo level: mean, max or sum of the strengths in each bin."""
    index = bin_index(echoes, window, sonar)
    kept = (index >= 0) & (echoes.strength > 0)
    index, strength = index[kept], echoes.strength[kept]
    size = sonar.range_bins * sonar.beams
    level: npt.NDArray[np.floating]
    if sonar.accumulate == "max":
        level = np.zeros(size, np.float32)
        np.maximum.at(level, index, strength)
    else:
        level = np.bincount(index, weights=strength, minlength=size).astype(np.float64)
        if sonar.accumulate == "mean":
            level /= np.maximum(np.bincount(index, minlength=size), 1)
    return np.asarray(level.reshape(sonar.range_bins, sonar.beams), dtype=np.float32)


def spread_points(level: Polar, sonar: SonarSettings) -> Polar:
    """Blur by the device's point-spread; echo energy is kept except at the picture's border."""
    sigma = (sonar.point_spread.range_bins, sonar.point_spread.beams)
    return np.asarray(ndimage.gaussian_filter(level, sigma, mode="constant", truncate=3.0))


def covered(echoes: Echoes, window: Window, sonar: SonarSettings) -> npt.NDArray[np.bool_]:
    """(range_bins, beams) bool: bins that some insonified surface fills.

    Asked of the full-density cloud.  Bins smaller than the pixel grid of the camera leave pinholes
    that are no shadow: they are closed.
    """
    index = bin_index(echoes, window, sonar)
    hit = np.zeros(sonar.range_bins * sonar.beams, np.bool_)
    hit[index[(index >= 0) & (echoes.strength > 0)]] = True
    grid = np.pad(hit.reshape(sonar.range_bins, sonar.beams), 3)
    closed = ndimage.binary_closing(grid, structure=np.ones((5, 3), np.bool_))
    return np.asarray(closed[3:-3, 3:-3])


def seen_beams(window: Window, sonar: SonarSettings) -> npt.NDArray[np.bool_]:
    """(beams,) bool: beams within the part of the sector that the camera saw."""
    centres = sonar.beam_centres_rad()
    half = np.deg2rad(sonar.hfov_deg) / sonar.beams / 2
    return np.asarray(
        (centres + half > window.azimuth_min_rad) & (centres - half < window.azimuth_max_rad)
    )
