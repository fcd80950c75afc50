"""What runs through the receiver, and all that the effects may know of the ping."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt

from ...sonar import array
from ...sonar.acoustics import WaterSettings, thermal_noise_db
from ...sonar.settings import SonarSettings
from ...sonar.window import Window
from . import beams
from .beams import bin_centres_m
from .scatterers import Scatterers

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Signal:
    """Echoes before they are a picture.  Their intensity is power + |field|^2.

    Intensities are those at the receiver over the source level (1 m from the source).

    power: (range_bins, beams) float32, mean intensity of what has no speckle (yet).
    field: (looks, 2, range_bins, beams) float32, real and imaginary part of what has; the looks
        are averaged at the end.
    """

    power: Floats
    field: Floats

    @property
    def looks(self) -> int:
        """How many independent pictures are averaged."""
        return int(self.field.shape[0])


@dataclass(frozen=True, eq=False)
class Receiver:
    """The device in the water, set to a range window."""

    window: Window
    sonar: SonarSettings
    water: WaterSettings

    @property
    def shape(self) -> tuple[int, int]:
        """(range_bins, beams)."""
        return self.sonar.range_bins, self.sonar.beams

    @property
    def bin_m(self) -> float:
        """Length of a range bin, metres."""
        return self.window.range_span_m / self.sonar.range_bins

    @property
    def resolution_m(self) -> float:
        """Range resolution c / 2B, metres."""
        return array.range_resolution_m(self.sonar.array, self.water.sound_speed_m_s())

    @cached_property
    def range_m(self) -> Floats:
        """(range_bins,) centres of the range bins, metres."""
        return bin_centres_m(self.window, self.sonar)

    @property
    def absorption_db_per_m(self) -> float:
        """One way."""
        return self.water.absorption_db_per_m(self.sonar.frequency_khz)

    @cached_property
    def mixing(self) -> Floats:
        """See `simnfnd.factory.sonar.array.beam_mixing`."""
        return beams.mixing(self.sonar)

    @cached_property
    def kernel(self) -> Floats:
        """See `simnfnd.factory.sonar.array.range_kernel`."""
        return array.range_kernel(self.bin_m, self.sonar.array, self.water.sound_speed_m_s())

    @cached_property
    def noise_share(self) -> Floats:
        """(beams,) what noise of intensity 1 in a beam and pulse is in a bin of this field.

        The point-spread leaves the sum of the echoes as it is, so an echo that is the same
        everywhere is as strong as what a bin holds of it.  A device receives of it what its pulse
        and its beam hold.  Dividing the noise by their ratio keeps the signal to noise, whatever
        the sampling.
        """
        pulse_m = array.pulse_length_m(self.sonar.array, self.water.sound_speed_m_s())
        return self.beam_share * np.float32(self.bin_m / pulse_m)

    @cached_property
    def beam_share(self) -> Floats:
        """(beams,) distance to the next beam over the width of a beam."""
        sine = np.gradient(np.sin(self.sonar.beam_centres_rad()))
        return np.asarray(sine / array.beam_width_sine(self.sonar.array), np.float32)

    @property
    def thermal_noise(self) -> float:
        """Intensity of the sea's thermal noise in one beam, over the source level (Mellen)."""
        device = self.sonar.array
        level_db = thermal_noise_db(self.sonar.frequency_khz, device.bandwidth_khz)
        level_db -= array.directivity_db(device, self.sonar.vfov_deg) + device.source_level_db
        return float(10 ** (level_db / 10))


@dataclass(frozen=True, eq=False)
class Ping(Receiver):
    """One ping of the device at one frame; no randomness.

    gain: (range_bins,) float32, time-varying gain on intensity.
    full_scale: intensity, after that gain, which the picture shows as grey value 1.
    strongest: the largest expected intensity of the frame, before that gain.
    expected: (range_bins, beams) float32, expected intensity without noise, before that gain.
    """

    scatterers: Scatterers
    gain: Floats
    full_scale: float
    strongest: float
    expected: Floats


def sounds(plane: Floats) -> bool:
    """Whether anything is not 0; a tenth of the time of `plane.any()`."""
    return bool((plane != 0).any())


def beamform(field: Floats, receiver: Receiver) -> Floats:
    """The complex field after pulse compression and beamforming; same shape."""
    return beams.blurred(field, receiver.kernel, receiver.sonar, power=False)


def beamform_power(power: Floats, receiver: Receiver) -> Floats:
    """(range_bins, beams) expected intensity after both: what `beamform` does to speckle's mean."""
    blurred = beams.blurred(power, receiver.kernel**2, receiver.sonar, power=True)
    # Differences of mirrored beams round to below zero where there is next to nothing.
    return np.asarray(np.maximum(blurred, 0, out=blurred))


def white_noise(rng: np.random.Generator, looks: int, shape: tuple[int, int]) -> Floats:
    """(looks, 2, *shape) float32: complex circular Gaussian noise of intensity 1."""
    noise = np.zeros((looks, 2, *shape), np.float32)
    add_white_noise(noise, rng, np.ones(shape[0], np.float32))
    return noise


def add_white_noise(
    field: Floats, rng: np.random.Generator, along: Floats, across: Floats | None = None
) -> None:
    """Add such noise to a field in place, times amplitudes of the rows and of the beams.

    along: (range_bins,) float32; across: (beams,) float32, all 1 where left out.
    """
    from . import kernels

    if across is None:
        across = np.ones(field.shape[-1], np.float32)
    for look in field:
        kernels.add_white(int(rng.integers(2**32)), gaussian_table(), along, across, look)


def scattered(
    ping: Ping,
    rng: np.random.Generator,
    looks: float,
    points: tuple[npt.NDArray[np.int32], Floats, npt.NDArray[np.uint32]],
    shares: Floats = np.empty(0, np.float32),  # noqa: B008
    phases: npt.NDArray[np.uint16] = np.empty(0, np.uint16),  # noqa: B008
) -> Signal:
    """Speckle: the complex field of points instead of the mean power of the echoes.

    looks: independent fields (rounded).  points: flat polar bin, root of the power without
    absorption and cell of each of N.  shares, phases: see `kernels.scatter`.
    """
    from . import kernels

    rows, beams = ping.shape
    amplitude = np.sqrt(ping.scatterers.loss)[:, None]
    field = np.empty((max(round(looks), 1), 2, rows, beams), np.float32)
    for look in field:
        bins = np.zeros((rows * beams, 2), np.float32)
        key = int(rng.integers(2**32))
        kernels.scatter(*points, shares, phases, key, (gaussian_table(), _turns()), bins)
        np.multiply(bins.reshape(rows, beams, 2).transpose(2, 0, 1), amplitude, out=look)
    return Signal(np.zeros(ping.shape, np.float32), field)


@lru_cache(maxsize=1)
def _turns() -> Floats:
    """(65536, 2) float32 cosine and sine of equal steps of a turn."""
    angle = 2 * np.pi * np.arange(65_536) / 65_536
    return np.ascontiguousarray(np.stack([np.cos(angle), np.sin(angle)], axis=1), np.float32)


@lru_cache(maxsize=1)
def gaussian_table() -> Floats:
    """(65536, 2) float32: the complex circular Gaussian of intensity 1 as equally likely values.

    Intensities are the quantiles of the exponential distribution, phases go round by the golden
    ratio.  A number drawn at random and looked up here is five times as fast as a generator, and
    unlike a sample of the same size this has the moments of the distribution.
    """
    size = 65_536
    number = np.arange(size)
    radius = np.sqrt(-np.log1p(-(number + 0.5) / size))
    phase = 2 * np.pi * np.mod(number * (np.sqrt(5) - 1) / 2, 1)
    table = np.stack([radius * np.cos(phase), radius * np.sin(phase)], axis=1)
    return np.ascontiguousarray(table / np.sqrt((radius**2).mean()), np.float32)
