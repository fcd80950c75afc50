"""What runs through the receiver, and all that the effects may know of the ping."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from ...common.array_types import Float32s, Float64s
from ..sonar import array, polar, transfer
from ..sonar.array import ArraySettings, WaterSettings, thermal_noise_db
from ..sonar.settings import SonarSettings
from ..sonar.surface import LitSurface
from ..sonar.window import Window
from .grain import PointEchoes, grain_points
from .scatterers import Scatterers, bin_centres_m, scatterers
from .settings import CoherentSettings

# What factors leave out, as a part of the largest number of a matrix.
_LEFT_OUT = 1e-6
# Modes a beam up to which two multiplications by factors are less work than one by the half.
_WORTH_IT = 0.4


@dataclass(frozen=True, eq=False)
class Signal:
    """Echoes before they are an image.  Their intensity is power + |field|^2.

    Intensities are those at the receiver over the source level (1 m from the source).
    power: (range_bins, beams) float32, mean intensity of what has no speckle (yet).
    field: (looks, 2, range_bins, beams) float32, real and imaginary part of what has; the looks
        are averaged at the end.
    """

    power: Float32s
    field: Float32s


@dataclass(frozen=True, eq=False)
class Ping:
    """One ping of the device at one frame, at its raw samples; no randomness.

    surface: what it looks at; the sonar of it has the range bins of the image.
    """

    surface: LitSurface
    water: WaterSettings
    acoustics: CoherentSettings

    @property
    def window(self) -> Window:
        """The range window."""
        return self.surface.window

    @cached_property
    def sonar(self) -> SonarSettings:
        """The device with a range bin for each raw sample."""
        sonar = self.surface.sonar
        bins = sonar.samples_per_bin * sonar.range_bins
        return replace(sonar, range_bins=bins, samples_per_bin=1)

    @cached_property
    def scatterers(self) -> Scatterers:
        """All that echoes; raises FrameError when nothing does."""
        raw = replace(self.surface, sonar=self.sonar)
        return scatterers(raw, self.water, self.acoustics)

    @cached_property
    def grain(self) -> PointEchoes:
        """The points whose echoes make its grain, without phases; see `grain_points`."""
        return grain_points(self, 0.0)

    @cached_property
    def phased_grain(self) -> PointEchoes:
        """The same points with the phases of their two-way paths."""
        return grain_points(self, 2000 * self.sonar.frequency_khz / self.water.sound_speed_m_s())

    @property
    def shape(self) -> tuple[int, int]:
        """Number of range bins and of beams."""
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
    def range_m(self) -> Float32s:
        """(range_bins,) centres of the range bins, metres."""
        return bin_centres_m(self.window, self.sonar)

    @property
    def absorption_db_per_m(self) -> float:
        """Absorption of the water, one way, dB/m."""
        return self.water.absorption_db_per_m(self.sonar.frequency_khz)

    @cached_property
    def kernel(self) -> Float32s:
        """See `simnfnd.factory.simulation.sonar.array.range_kernel`."""
        return array.range_kernel(self.bin_m, self.sonar.array, self.water.sound_speed_m_s())

    @cached_property
    def noise_share(self) -> Float32s:
        """(beams,) what noise of intensity 1 in a beam and pulse is in a bin of this field.

        The point-spread leaves the sum of the echoes as it is: an echo that is the same everywhere
        is as strong as what a bin holds of it, and a device receives what its pulse and its beam
        hold.  Dividing the noise by their ratio keeps the signal to noise, whatever the sampling.
        """
        pulse_m = array.pulse_length_m(self.sonar.array, self.water.sound_speed_m_s())
        return self.beam_share * np.float32(self.bin_m / pulse_m)

    @cached_property
    def beam_share(self) -> Float32s:
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

    @cached_property
    def gain(self) -> Float32s:
        """(range_bins,) time-varying gain on intensity: k log10 r + 2 a r, `CoherentSettings`."""
        range_m = np.maximum(self.range_m.astype(np.float64), 1e-3)
        gain_db = self.acoustics.tvg_log * np.log10(range_m)
        if self.acoustics.tvg_absorption:
            gain_db += 2 * self.absorption_db_per_m * range_m
        return np.asarray(10 ** (gain_db / 10), np.float32)

    @cached_property
    def expected(self) -> Float32s:
        """(range_bins, beams) expected intensity without noise, before that gain."""
        return beamform_power(self.scatterers.power, self)

    @cached_property
    def strongest(self) -> float:
        """The largest amplitude."""
        return float((self.expected * polar.seen_beams(self.window, self.sonar)).max())

    @cached_property
    def full_scale(self) -> float:
        """Intensity, after that gain, which the image shows as grey value 1."""
        curve = self.sonar.transfer
        if curve.full_scale_db is not None:
            return float((10 ** (curve.full_scale_db / 20)) ** 2)
        # Only bins with an echo decide how bright the image is; the blur around them does not.
        has_echo = (self.scatterers.power > 0) & polar.seen_beams(self.window, self.sonar)
        level = np.where(has_echo, np.sqrt(self.expected * self.gain[:, None]), np.float32(0))
        return transfer.full_scale(self.averaged(level), curve) ** 2

    def averaged(self, amplitude: Float32s) -> Float32s:
        """(rows, beams) of the image: the root of the mean intensity of its raw samples."""
        samples = self.surface.sonar.samples_per_bin
        return amplitude if samples == 1 else np.sqrt(averaged(amplitude**2, samples))


def averaged(intensity: Float32s, samples: int) -> Float32s:
    """(rows, beams) float32: the mean of each `samples` rows of (samples * rows, beams)."""
    rows, beams = intensity.shape
    mean = intensity.reshape(rows // samples, samples, beams).mean(axis=1, dtype=np.float32)
    return np.ascontiguousarray(mean)


def is_audible(plane: Float32s) -> bool:
    """Whether anything is not 0; a tenth of the time of `plane.any()`."""
    return bool((plane != 0).any())


def beamform(field: Float32s, ping: Ping) -> Float32s:
    """The complex field after pulse compression and beamforming; same shape."""
    return blurred(field, ping.kernel, ping.sonar, power=False)


def beamform_power(power: Float32s, ping: Ping) -> Float32s:
    """(range_bins, beams) expected intensity after both: what `beamform` does to speckle's mean."""
    intensity = blurred(power, ping.kernel**2, ping.sonar, power=True)
    # Differences of mirrored beams round to below zero where there is next to nothing.
    return np.asarray(np.maximum(intensity, 0, out=intensity))


def white_noise(rng: np.random.Generator, looks: int, shape: tuple[int, int]) -> Float32s:
    """(looks, 2, *shape) float32: complex circular Gaussian noise of intensity 1."""
    noise = np.zeros((looks, 2, *shape), np.float32)
    add_white_noise(noise, rng, *(np.ones(side, np.float32) for side in shape))
    return noise


def add_white_noise(
    field: Float32s, rng: np.random.Generator, along: Float32s, across: Float32s
) -> None:
    """Add such noise to a field in place, times float32 amplitudes of the rows and the beams."""
    from . import kernels

    for look in field:
        kernels.add_white(int(rng.integers(2**32)), gaussian_table(), along, across, look)


def scattered(ping: Ping, rng: np.random.Generator, looks: float, points: PointEchoes) -> Signal:
    """Return speckle: the complex field of points instead of the mean power of the echoes.

    looks: number of independent fields (rounded).
    """
    from . import kernels

    rows, beams = ping.shape
    amplitude = np.sqrt(ping.scatterers.loss)[:, None]
    field = np.empty((max(round(looks), 1), 2, rows, beams), np.float32)
    for look in field:
        bins = np.zeros((rows * beams, 2), np.float32)
        key = int(rng.integers(2**32))
        kernels.scatter(*points, key, (gaussian_table(), _turns()), bins)
        np.multiply(bins.reshape(rows, beams, 2).transpose(2, 0, 1), amplitude, out=look)
    return Signal(np.zeros(ping.shape, np.float32), field)


@lru_cache(maxsize=1)
def _turns() -> Float32s:
    """(65536, 2) float32 cosine and sine of equal steps of a turn."""
    angle = 2 * np.pi * np.arange(65_536) / 65_536
    return np.ascontiguousarray(np.stack([np.cos(angle), np.sin(angle)], axis=1), np.float32)


@lru_cache(maxsize=1)
def gaussian_table() -> Float32s:
    """(65536, 2) float32: the complex circular Gaussian of intensity 1 as equally likely values.

    Intensities are the quantiles of the exponential distribution, phases go round by the golden
    ratio.  To look up a random number here is five times as fast as a generator.
    """
    size = 65_536
    number = np.arange(size)
    radius = np.sqrt(-np.log1p(-(number + 0.5) / size))
    phase = 2 * np.pi * np.mod(number * (np.sqrt(5) - 1) / 2, 1)
    table = np.stack([radius * np.cos(phase), radius * np.sin(phase)], axis=1)
    return np.ascontiguousarray(table / np.sqrt((radius**2).mean()), np.float32)


# --- the device's beams as matrices -----------------------------------------------------------


def mixing(sonar: SonarSettings) -> Float32s:
    """The device's beam mixing; see `simnfnd.factory.simulation.sonar.array.beam_mixing`."""
    return _mixing(_receive_beams(sonar))


def _receive_beams(sonar: SonarSettings) -> SonarSettings:
    """The device without all that leaves its receive beams as they are, for caches."""
    array_settings = ArraySettings(
        beamwidth_deg=sonar.array.beamwidth_deg, horizontal=sonar.array.horizontal
    )
    return SonarSettings(
        hfov_deg=sonar.hfov_deg,
        beams=sonar.beams,
        beam_azimuths_deg=sonar.beam_azimuths_deg,
        array=array_settings,
    )


@lru_cache(maxsize=8)
def _mixing(sonar: SonarSettings) -> Float32s:
    return array.beam_mixing(sonar.beam_centres_rad(), sonar.array)


class HalfMixing(NamedTuple):
    """The mixing of one half of the beams, as a product of one or two matrices.

    into: (n, m), or (n, modes) where `out_of`, (modes, m), follows.
    """

    into: Float32s
    out_of: Float32s | None = None

    @property
    def is_factored(self) -> bool:
        """Whether two matrices make the product."""
        return self.out_of is not None


class BeamMixing(NamedTuple):
    """The device's mixing of its beams.

    A device whose left is the mirror of its right mixes the sums of mirrored beams with one matrix
    and their differences with another, each of half the size.  Other devices have no differences:
    `sums` is then the whole matrix.
    """

    sums: HalfMixing
    differences: HalfMixing | None = None


def matrices(sonar: SonarSettings, power: bool) -> BeamMixing:
    """The mixing of a device; see `_matrices`."""
    return _matrices(_receive_beams(sonar), power)


@lru_cache(maxsize=16)
def _matrices(sonar: SonarSettings, power: bool) -> BeamMixing:
    """The mixing of amplitudes or, squared, of intensities.

    Halves cost an error of 2e-7 of the row's strongest number.

    An aperture of L wavelengths tells apart about 2 L sin(hfov / 2) directions.  With more beams
    than that, each half is (beams / 2, modes) times (modes, beams / 2), of amplitudes, where this
    saves work (errors: 1e-5).  Rows and columns are filled up with zeros to multiples of 4.
    """
    halves = _halves(mixing(sonar).astype(np.float64) ** (2 if power else 1))
    whole = [HalfMixing(_filled_up(half)) for half in halves]
    if len(halves) == 1 or power:
        return BeamMixing(*whole)

    factored = [factors(half, int(_WORTH_IT * len(half))) for half in halves]
    products = [HalfMixing(*map(_filled_up, both)) for both in factored if both is not None]
    return BeamMixing(*(products if len(products) == len(halves) else whole))


def factors(matrix: Float64s, most: int) -> tuple[Float64s, Float64s] | None:
    """(n, r) and (r, m) whose product is the (n, m) matrix to 1e-6 of its largest number.

    Gauss's elimination with complete pivoting, ended where nothing is left.  Unlike singular values
    it needs no library whose rounding depends on the processor.  None if r would be above `most`.
    """
    left = matrix.copy()
    columns: list[Float64s] = []
    rows: list[Float64s] = []
    least = _LEFT_OUT * np.abs(matrix).max()
    for _ in range(most + 1):
        row, column = divmod(int(np.abs(left).argmax()), matrix.shape[1])
        pivot = left[row, column]
        if abs(pivot) <= least:
            return (np.stack(columns, axis=1), np.stack(rows)) if rows else None
        columns.append(left[:, column] / pivot)
        rows.append(left[row].copy())
        left -= columns[-1][:, None] * rows[-1]
    return None


def _halves(matrix: Float64s) -> list[Float64s]:
    turned = matrix[::-1, ::-1]
    if np.abs(matrix - turned).max() > 1e-6 * matrix.max():
        return [matrix]
    middle = (len(matrix) + 1) // 2  # of an odd number that beam is its own mirror
    matrix = (matrix + turned) / 2
    upper = matrix[:middle, :middle]
    lower = matrix[::-1][:middle, :middle]
    return [(upper + lower) / 2, (upper - lower) / 2]


def _filled_up(matrix: Float64s) -> Float32s:
    return np.pad(matrix, [(0, -side % 4) for side in matrix.shape]).astype(np.float32)


def blurred(planes: Float32s, kernel: Float32s, sonar: SonarSettings, *, power: bool) -> Float32s:
    """Planes (..., range_bins, beams) after pulse compression and beamforming.

    kernel: range response.  power: whether the planes are intensities, and not amplitudes.
    """
    rows, beams = planes.shape[-2:]
    mixing_of_beams = matrices(sonar, power)
    halves = [half for half in mixing_of_beams if half is not None]
    pairs = beams // 2 if mixing_of_beams.differences else 0
    out = np.empty_like(planes)
    for plane, blurred_plane in zip(
        planes.reshape(-1, rows, beams), out.reshape(-1, rows, beams), strict=True
    ):
        # There are fewer modes than beams, so the pulse goes between their factors.
        is_factored = halves[0].is_factored
        pulsed = plane if is_factored else along_range(plane, kernel)
        folded = _fold(pulsed, pairs, len(halves[0].into))
        mixed = [_mix_half(part, half, kernel) for part, half in zip(folded, halves, strict=True)]
        sums = mixed[0][:rows]
        differences = mixed[-1][:rows, :pairs]
        blurred_plane[:, :pairs] = sums[:, :pairs] + differences
        blurred_plane[:, beams - pairs :] = (sums[:, :pairs] - differences)[:, ::-1]
        blurred_plane[:, pairs : beams - pairs] = sums[:, pairs : beams - pairs]
    return out


def _mix_half(part: Float32s, half: HalfMixing, kernel: Float32s) -> Float32s:
    """Mix one half of the beams; applies the pulse, too, where the mixing has two factors."""
    modes = _times(part, half.into)
    return modes if half.out_of is None else _times(along_range(modes, kernel), half.out_of)


def along_range(plane: Float32s, kernel: Float32s) -> Float32s:
    """Rows of (rows, n) correlated with `kernel`; nothing comes from beyond the ends."""
    if len(kernel) == 1:
        return plane
    rows = len(plane)
    half = len(kernel) // 2
    out = np.zeros_like(plane)
    for tap, weight in enumerate(kernel):
        first = max(half - tap, 0)
        last = min(rows, rows + half - tap)
        if first < last:
            out[first:last] += weight * plane[first + tap - half : last + tap - half]
    return out


def _fold(plane: Float32s, pairs: int, width: int) -> list[Float32s]:
    """Sums (the middle beam as it is) and differences of mirrored beams, filled up with zeros."""
    rows, beams = plane.shape
    sums, differences = (np.zeros((rows + -rows % 4, width), np.float32) for _ in range(2))
    left = plane[:, :pairs]
    right = plane[:, beams - pairs :][:, ::-1]
    sums[:rows, :pairs] = left + right
    differences[:rows, :pairs] = left - right
    sums[:rows, pairs : beams - pairs] = plane[:, pairs : beams - pairs]
    return [sums, differences] if pairs else [sums]


def _times(rows: Float32s, matrix: Float32s) -> Float32s:
    from . import kernels  # loads numba

    out = np.empty((len(rows), matrix.shape[1]), np.float32)
    kernels.products(rows, matrix, out)
    return out
