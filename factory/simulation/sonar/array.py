"""The water, and the device's point-spread: beam patterns with sidelobes, and the pulse.

A tapered aperture and a tapered spectrum have the same response, the Fourier transform of the
taper.  Its argument is 1 at the first null of the untapered one: (L / lambda) sin(theta) for an
array of length L, range / (c / 2B) for an unshaded pulse of bandwidth B.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import field
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s, Float64s
from ...common.limits import limited
from ...common.settings import STRICT

# Fewest elements of an array.  N of them repeat their response N nulls away (grating lobes), so
# there are more where a sector reaches further than half of that.
_ELEMENTS = 256
_CHUNK = 4096
# Mean level of the windows that are a cosine on a level.
_RAISED_COSINES = {"uniform": 1.0, "hann": 0.5, "hamming": 0.54}
_STEPS = 128
_DECIBELS_KEPT = 60.0
_PATTERN_STEPS = 4096


@dataclass(frozen=True, config=STRICT)
class Taper:
    """A shading window.

    window: uniform (sidelobes at -13.3 dB), hann (-31.5), hamming (-42.7), taylor or chebyshev.
    sidelobe_db: how far below the main lobe the sidelobes of taylor and chebyshev lie, dB.
    """

    window: Literal["uniform", "hann", "hamming", "taylor", "chebyshev"] = "hamming"
    sidelobe_db: Annotated[float, Field(ge=15, le=100)] = 35.0


@dataclass(frozen=True, config=STRICT)
class ArraySettings:
    """Keys of `sonar.array`: what the device resolves; for acoustics=coherent alone.

    bandwidth_khz: of the pulse; range resolution is c / 2B (B = 30 kHz resolves 2.5 cm).  A shaded
        spectrum is so much wider that the pulse's -3 dB width is that of the unshaded one, 0.886
        times the resolution.
    beamwidth_deg: -3 dB width of a receive beam straight ahead, one way; the vertical one is
        sonar.vfov_deg.
    source_level_db: dB re 1 uPa at 1 m; decides how far echoes stand above the receiver's noise.
    horizontal, vertical: shading of the array.  pulse: shading of the spectrum.
    beam_groups: how many groups of beams take turns within a ping, so that neighbours do not hear
        each other: beam b belongs to group b modulo their number.  Each waits for the farthest echo
        of the one before.  Moving objects alone are seen at these times.
    """

    bandwidth_khz: Annotated[float, limited(0.1, 2000, "kHz")] = 60.0
    beamwidth_deg: Annotated[float, limited(0.02, 90, "deg")] = 0.5
    source_level_db: Annotated[float, limited(100, 260, "dB")] = 205.0
    horizontal: Taper = field(default_factory=Taper)
    vertical: Taper = field(default_factory=lambda: Taper(window="uniform"))
    pulse: Taper = field(default_factory=Taper)
    beam_groups: Annotated[int, Field(ge=1, le=32)] = 1


@lru_cache(maxsize=32)
def weights(taper: Taper, elements: int = _ELEMENTS) -> Float64s:
    """(elements,) shading of the elements, sum 1."""
    if taper.window in _RAISED_COSINES:
        level = _RAISED_COSINES[taper.window]
        shading = level + (1 - level) * np.cos(np.linspace(-np.pi, np.pi, elements))
        return np.asarray(shading / shading.sum())

    from scipy.signal import windows  # half a second to import

    with warnings.catch_warnings():
        # Chebyshev's warns that it is no window for spectra, which this is not.
        warnings.simplefilter("ignore", UserWarning)
        if taper.window == "taylor":
            shading = windows.taylor(elements, 8, taper.sidelobe_db)
        else:
            shading = windows.chebwin(elements, taper.sidelobe_db)
    return np.asarray(shading / shading.sum())


def response(argument: npt.ArrayLike, taper: Taper) -> Float64s:
    """Amplitude response at (L / lambda) sin(theta), or range / (c / 2B); 1 at 0, real, even.

    Any shape.  For the uniform window it is the normalised sinc (Urick 1983, ch. 3).
    """
    magnitude = np.abs(np.asarray(argument, np.float64))
    elements = _elements(magnitude.max(initial=0))
    # The elements are symmetric, so half of them tell all.
    half = slice(elements // 2, None)
    position = ((np.arange(elements) + 0.5) / elements - 0.5)[half]
    shading = 2 * weights(taper, elements)[half]
    amplitude = np.empty(magnitude.size)
    for first in range(0, magnitude.size, _CHUNK):
        some = magnitude.reshape(-1)[first : first + _CHUNK, None]
        amplitude[first : first + _CHUNK] = np.cos(2 * np.pi * some * position) @ shading
    return amplitude.reshape(magnitude.shape)


def _elements(furthest: float) -> int:
    """Elements of an array whose response is asked for up to this argument."""
    elements = _ELEMENTS
    while elements < 2 * furthest:
        elements *= 2
    return elements


def _response_table(count: int, taper: Taper) -> Float64s:
    """(count,) the response at -1, 0, 1 ... steps of 1 / 128; whole chunks serve all devices."""
    steps = np.arange(-1, count - 1) / _STEPS
    whole = count // _CHUNK * _CHUNK
    whole_chunks = _whole_chunks(taper, _elements(steps[-1]))
    return np.concatenate([whole_chunks[:whole], response(steps[whole:], taper)])


@lru_cache(maxsize=8)
def _whole_chunks(taper: Taper, elements: int) -> Float64s:
    return response(np.arange(-1, elements // 2 * _STEPS - 1) / _STEPS, taper)


@lru_cache(maxsize=32)
def equivalent_width(taper: Taper) -> float:
    """Integral of the squared response over its argument; 1 for the uniform window (Parseval)."""
    return float(_ELEMENTS * (weights(taper) ** 2).sum())


@lru_cache(maxsize=32)
def half_power(taper: Taper) -> float:
    """The argument at which the intensity response has fallen to a half."""
    x = np.linspace(0, 3, 3001)
    below = int(np.argmax(response(x, taper) ** 2 < 0.5))
    high, low = response(x[below - 1 : below + 1], taper) ** 2
    return float(x[below - 1] + (high - 0.5) / (high - low) * (x[below] - x[below - 1]))


def aperture_wavelengths(width_deg: float, taper: Taper) -> float:
    """Length of the array, in wavelengths, whose -3 dB beam is `width_deg` wide."""
    return half_power(taper) / float(np.sin(np.deg2rad(width_deg) / 2))


def beam_mixing(beams_rad: Float64s, array: ArraySettings) -> Float32s:
    """(beams, beams) float32: amplitude that beam j receives of an echo in the direction of beam i.

    Its square mixes intensities; the squares of each row sum to 1, so no energy comes or goes.
    beams_rad: (beams,) azimuths; they need not be uniform.
    """
    sine = np.sin(beams_rad)
    length = aperture_wavelengths(array.beamwidth_deg, array.horizontal)
    apart = np.abs(sine[:, None] - sine[None, :]) * length
    # Cubic between 128 points a null: 3e-8 off, and a hundred times faster.
    table = _response_table(int(apart.max() * _STEPS) + 4, array.horizontal)
    step = (apart * _STEPS).astype(np.intp)
    u = apart * _STEPS - step
    before, middle, after, beyond = (table[step + by] for by in range(4))
    amplitude = middle * (1 - u * u) * (1 - u / 2) + after * u * (1 + u) * (1 - u / 2)
    amplitude += (before * (2 - u) + beyond * (1 + u)) * u * (u - 1) / 6
    amplitude /= np.sqrt((amplitude**2).sum(axis=1, keepdims=True))
    return np.asarray(amplitude, np.float32)


def range_kernel(bin_m: float, array: ArraySettings, speed_m_s: float) -> Float32s:
    """(2 n + 1,) float32 amplitudes along range, squares summing to 1.

    bin_m: length of a range bin.  Left out: what lies 60 dB below the peak.  A single 1 when the
    bins are far longer than the pulse.
    """
    null_m = _pulse_scale_m(array, speed_m_s)
    reach = max(int(np.ceil(6 * null_m / bin_m)), 1)
    amplitude = response(np.arange(-reach, reach + 1) * bin_m / null_m, array.pulse)
    audible_taps = np.flatnonzero(np.abs(amplitude) >= 10 ** (-_DECIBELS_KEPT / 20))
    # Taps at nulls lie within the kernel; only its ends are cut.
    amplitude = amplitude[audible_taps[0] : audible_taps[-1] + 1]
    return np.asarray(amplitude / np.sqrt((amplitude**2).sum()), np.float32)


def range_resolution_m(array: ArraySettings, speed_m_s: float) -> float:
    """Range resolution c / 2B, metres."""
    return speed_m_s / (2 * 1000 * array.bandwidth_khz)


def pulse_length_m(array: ArraySettings, speed_m_s: float) -> float:
    """Equivalent length of the compressed pulse along range, metres."""
    return _pulse_scale_m(array, speed_m_s) * equivalent_width(array.pulse)


def _pulse_scale_m(array: ArraySettings, speed_m_s: float) -> float:
    """Range at which the argument of the response is 1, metres: -3 dB as of an unshaded pulse."""
    wider = half_power(Taper(window="uniform")) / half_power(array.pulse)
    return range_resolution_m(array, speed_m_s) * wider


def beam_width_sine(array: ArraySettings) -> float:
    """Equivalent width of a receive beam, one way, in sines of the bearing."""
    length = aperture_wavelengths(array.beamwidth_deg, array.horizontal)
    return equivalent_width(array.horizontal) / length


def vertical_pattern(sine: Float64s, vfov_deg: float, array: ArraySettings) -> Float64s:
    """Two-way intensity pattern at the sine of the elevation; 1 straight ahead, 1/4 at vfov / 2.

    Transmitter and receiver have the same vertical pattern; each is at -3 dB there.
    """
    length = aperture_wavelengths(vfov_deg, array.vertical)
    return np.asarray(response(sine * length, array.vertical) ** 4)


def vertical_table(vfov_deg: float, array: ArraySettings) -> Float32s:
    """(4097,) `vertical_pattern` at equal steps of sin(elevation) from -1 to 1."""
    return _vertical_table(vfov_deg, array.vertical).astype(np.float32)


@lru_cache(maxsize=32)
def _vertical_table(vfov_deg: float, vertical: Taper) -> Float64s:
    sine = np.linspace(-1, 1, _PATTERN_STEPS + 1)
    return vertical_pattern(sine, vfov_deg, ArraySettings(vertical=vertical))


def vertical_width_rad(vfov_deg: float, array: ArraySettings) -> float:
    """Equivalent two-way width of the vertical beam, radians: its pattern's integral."""
    sine = np.linspace(-1, 1, _PATTERN_STEPS + 1)
    pattern = _vertical_table(vfov_deg, array.vertical)
    # By trapezia; NumPy's own function is called `trapz` before 2.0 and `trapezoid` from 2.0 on.
    return float(np.sum(np.diff(sine) * (pattern[1:] + pattern[:-1]) / 2.0))


def directivity_db(array: ArraySettings, vfov_deg: float) -> float:
    """Receive directivity index of one beam, dB: 4 pi over its equivalent solid angle."""
    upright = equivalent_width(array.vertical) / aperture_wavelengths(vfov_deg, array.vertical)
    return float(10 * np.log10(4 * np.pi / (beam_width_sine(array) * min(upright, 2))))


@dataclass(frozen=True, config=STRICT)
class WaterSettings:
    """Keys of the `water` group.

    temperature_c: degrees Celsius.  salinity_psu: practical salinity; 35 is sea, 0 is fresh.
    depth_m: of the sonar below the surface, metres.  ph: acidity.
    """

    temperature_c: Annotated[float, limited(-2, 40, "C")] = 10.0
    salinity_psu: Annotated[float, limited(0.05, 45, "psu", or_zero=True)] = 35.0
    depth_m: Annotated[float, limited(0, 11_000, "m")] = 5.0
    ph: Annotated[float, limited(6, 9)] = 8.0

    def sound_speed_m_s(self) -> float:
        """Speed of sound, m/s: the linear formula of Francois & Garrison (1982)."""
        return 1412 + 3.21 * self.temperature_c + 1.19 * self.salinity_psu + 0.0167 * self.depth_m

    def absorption_db_per_m(self, frequency_khz: float) -> float:
        """Absorption of sound, one way, dB/m.

        Francois & Garrison, J. Acoust. Soc. Am. 72 (1982), 896 and 1879: boric acid, magnesium
        sulphate and the water itself, each a relaxation with a strength, a pressure factor and a
        frequency.
        """
        t = self.temperature_c
        s = self.salinity_psu
        d = self.depth_m
        f2 = frequency_khz**2
        speed = self.sound_speed_m_s()

        boric = 8.86 / speed * 10 ** (0.78 * self.ph - 5)
        boric_khz = 2.8 * math.sqrt(s / 35) * 10 ** (4 - 1245 / (273 + t))

        sulphate = 21.44 * s / speed * (1 + 0.025 * t) * (1 - 1.37e-4 * d + 6.2e-9 * d**2)
        sulphate_khz = 8.17 * 10 ** (8 - 1990 / (273 + t)) / (1 + 0.0018 * (s - 35))

        if t <= 20:
            pure = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
        else:
            pure = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
        pure *= 1 - 3.83e-5 * d + 4.9e-10 * d**2

        db_per_km = (
            boric * boric_khz * f2 / (boric_khz**2 + f2)
            + sulphate * sulphate_khz * f2 / (sulphate_khz**2 + f2)
            + pure * f2
        )
        return db_per_km / 1000


def thermal_noise_db(frequency_khz: float, bandwidth_khz: float) -> float:
    """Thermal noise of the sea in a band, dB re 1 uPa: -15 + 20 log10 f + 10 log10 B.

    Mellen, J. Acoust. Soc. Am. 24 (1952), 478, as in Urick, Principles of Underwater Sound.
    frequency_khz, bandwidth_khz: kHz.
    """
    return -15 + 20 * math.log10(frequency_khz) + 10 * math.log10(1000 * bandwidth_khz)
