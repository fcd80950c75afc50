"""Raw samples and the fewer range bins of the picture: intensities averaged (multi-look).

A receiver samples faster than its picture shows.  What it averages is alike by the pulse: k samples
whose fields have the correlations rho are worth k^2 / sum |rho|^2 independent looks (Goodman,
Speckle Phenomena in Optics, ch. 4).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ...sonar.settings import SonarSettings
from ..contract import Floats
from .expected import Expected


def raw(sonar: SonarSettings) -> SonarSettings:
    """The device with a range bin for each raw sample."""
    samples = sonar.samples_per_bin
    if samples == 1:
        return sonar
    return replace(sonar, range_bins=samples * sonar.range_bins, samples_per_bin=1)


def averaged(intensity: Floats, samples: int) -> Floats:
    """(rows, beams) float32: the mean of each `samples` rows of (samples * rows, beams)."""
    if samples == 1:
        return intensity
    rows, beams = intensity.shape
    mean = intensity.reshape(rows // samples, samples, beams).mean(axis=1, dtype=np.float32)
    return np.ascontiguousarray(mean)


def averaged_amplitude(amplitude: Floats, samples: int) -> Floats:
    """The same of amplitudes: the root of the mean intensity."""
    return amplitude if samples == 1 else np.sqrt(averaged(amplitude**2, samples))


def any_of(filled: npt.NDArray[np.bool_], samples: int) -> npt.NDArray[np.bool_]:
    """(rows, beams) bool: whether one of each `samples` rows is true."""
    rows, beams = filled.shape
    return np.asarray(filled.reshape(rows // samples, samples, beams).any(axis=1))


def looks(kernel: Floats, samples: int) -> float:
    """Independent looks that the average of neighbouring samples is worth.

    kernel: range response in raw samples, as `simnfnd.factory.sonar.array.range_kernel` gives it.
    """
    full = np.correlate(kernel.astype(np.float64), kernel.astype(np.float64), "full")
    alike = (full / full.max()) ** 2
    middle = len(kernel) - 1
    lags = np.arange(1, min(samples, len(kernel)))
    pairs = samples + 2 * float(((samples - lags) * alike[middle + lags]).sum())
    return samples**2 / pairs


def averaged_expected(state: Expected, kernel: Floats, samples: int) -> Expected:
    """The expected intensities of range bins, from those of raw samples."""
    if samples == 1:
        return state
    return replace(
        state,
        echo=averaged(state.echo, samples),
        noise=averaged(state.noise, samples),
        steady=averaged(state.steady, samples),
        textured=averaged(state.textured, samples),
        looks=state.looks * looks(kernel, samples),
    )
