"""What lies behind each pixel of a picture: optional layers that no noise touches.

A picture has lost the elevation, and the object that an echo came from.  Both are known here: each
range bin of each beam tells of the strongest echo in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from simnfnd.factory.errors import FrameError
from simnfnd.factory.frame import Frame
from simnfnd.factory.sonar import polar
from simnfnd.factory.sonar.echoes import Echoes
from simnfnd.factory.sonar.settings import SonarSettings
from simnfnd.factory.sonar.window import Window

Picture = npt.NDArray[np.generic]


def pictures(
    asked: Sequence[str],
    frame: Frame,
    echoes: Echoes,
    pixel: npt.NDArray[np.int32],
    window: Window,
    sonar: SonarSettings,
) -> dict[str, Picture]:
    """(range_bins, beams) pictures of the asked layers, by the names of `format.schema`.

    asked: of range, elevation, valid_azimuth, segmentation (which brings instance); other names
        are left to others.
    echoes: every insonified surface point, none outside the window.  pixel: (N,) flat camera pixel
        of each.
    Raises FrameError when labels are asked of a frame that has none.
    """
    made: dict[str, Picture] = {}
    if "valid_azimuth" in asked:
        beams = polar.seen_beams(window, sonar)
        made["valid_azimuth"] = np.repeat(beams[None], sonar.range_bins, axis=0)
    if not {"range", "elevation", "segmentation"}.intersection(asked):
        return made
    strongest = _strongest(echoes, window, sonar)
    if "range" in asked:
        made["range"] = _lookup(echoes.range_m, strongest, np.nan)
    if "elevation" in asked:
        made["elevation"] = _lookup(echoes.elevation_rad, strongest, np.nan)
    if "segmentation" in asked:
        if frame.segmentation is None or frame.instance is None:
            raise FrameError(
                f"{frame.ref.name}: has no labels; leave segmentation out of dataset.layers"
            )
        made["segmentation"] = _lookup(frame.segmentation.ravel()[pixel], strongest, 0)
        made["instance"] = _lookup(frame.instance.ravel()[pixel], strongest, 0)
    return made


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
