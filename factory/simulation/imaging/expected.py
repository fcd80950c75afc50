"""The expected displayed image: what the average of many noisy images of one scene shows.

A display of levels shows less than the level of the mean intensity: speckle of L looks is
gamma-distributed, and E[10 log10 I] lies psi(L) - ln L nepers below 10 log10 E[I], 2.51 dB for one
look (psi: digamma).  So every effect says what it makes of the expected intensities, and the
transfer curve is averaged over their distribution, clipping included.

Random effects (speckle, texture, spokes) average out; systematic ones (haze, a wrong gain, ghosts)
are there in every image: target mean_log keeps them, target restored has none of them.  The default
target, noise_free, has no effect of either kind, nor their bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ...common.array_types import Float32s
from ..sonar import transfer
from ..sonar.settings import TransferSettings
from .effect import DrawnEffect
from .signal import Ping, averaged, is_audible

# The table of expected grey values: levels over full scale, dB, and their fluctuation.
_BEYOND_DB = 30.0
_STEPS_PER_DB = 2
_VARIANCES = 9
_QUANTILES = 512
_SHIFTS = 33
_DARKEST_DB = -120.0
_FAINTEST = np.float32(1e-37)  # far below every level that is shown, and no subnormal number


@dataclass(eq=False)
class Expected:
    """Expected intensities of a ping, (range_bins, beams) float32 each; effects change them.

    echo: of speckle, which texture can modulate.  noise: of all else that fluctuates.
    steady: of what does not fluctuate.  textured: the part of echo and steady that texture varies.
    looks: independent fields whose intensities are averaged, whole or not.
    shape: nu of the texture.  standing: part of the speckle's power that stays from ping to ping.
    scintillation_nepers2: variance of the logarithm of the intensity that comes on top of all.
    """

    echo: Float32s
    noise: Float32s
    steady: Float32s
    textured: Float32s
    looks: float = 1
    shape: float = np.inf
    standing: float = 0.0
    scintillation_nepers2: float = 0.0

    def scale(self, factor: npt.NDArray[np.floating]) -> None:
        """Multiply all intensities; factor: of a shape that broadcasts."""
        factor = factor.astype(np.float32)
        for plane in (self.echo, self.noise, self.steady, self.textured):
            plane *= factor

    def averaged(self, kernel: Float32s, samples: int) -> Expected:
        """The expected intensities of range bins, from those of raw samples."""
        planes = (averaged(p, samples) for p in (self.echo, self.noise, self.steady, self.textured))
        echo, noise, steady, textured = planes
        more = self.looks * looks(kernel, samples)
        return replace(self, echo=echo, noise=noise, steady=steady, textured=textured, looks=more)

    def total(self) -> Float32s:
        """(range_bins, beams) expected intensity."""
        return self.echo + self.noise + self.steady


def looks(kernel: Float32s, samples: int) -> float:
    """Independent looks that the average of neighbouring samples is worth.

    k samples whose fields have the correlations rho are worth k^2 / sum |rho|^2 looks (Goodman,
    Speckle Phenomena in Optics, ch. 4).  kernel: `sonar.array.range_kernel` in raw samples.
    """
    full = np.correlate(kernel.astype(np.float64), kernel.astype(np.float64), "full")
    alike = (full / full.max()) ** 2
    middle = len(kernel) - 1
    lags = np.arange(1, min(samples, len(kernel)))
    pairs = samples + 2 * float(((samples - lags) * alike[middle + lags]).sum())
    return samples**2 / pairs


def expected(
    ping: Ping, effects: Sequence[DrawnEffect], *, realised: bool = False, standing: float = 0.0
) -> Expected:
    """The expected intensities after time-varying gain.

    realised: whether random effects act as in this one sample, where that is known, or on
        average.  standing: see `Expected`.
    """
    none = [np.zeros(ping.shape, np.float32) for _ in range(3)]
    state = Expected(none[0], none[1], ping.expected.copy(), none[2], standing=standing)
    for stage in ("echo", "beam", "image"):
        if stage == "image":
            state.scale(ping.gain[:, None])
        for effect in effects:
            if effect.stage == stage:
                effect.expect(state, ping, realised=realised)
    return state


def display(state: Expected, full_scale: float, settings: TransferSettings) -> Float32s:
    """(range_bins, beams) float32 expected grey values.

    full_scale: intensity that is shown as grey value 1.
    """
    # The power of the intensity that is displayed; 0 for its logarithm, soft or not.
    power = {"linear": 0.5, "power": 0.5 * settings.exponent}.get(settings.kind, 0.0)
    # E[x^p]^(1/p) of a log-normal x of median 1.
    full_scale /= float(np.exp(power * state.scintillation_nepers2 / 2))
    if not (is_audible(state.echo) or is_audible(state.noise)):
        return transfer.grey(np.sqrt(state.steady), float(np.sqrt(full_scale)), settings)
    unit = np.float32(1)
    total = state.total() + _FAINTEST
    level_db = np.float32(10) * np.log10(np.maximum(total / np.float32(full_scale), _FAINTEST))
    # Texture shifts the level; the shift is tabulated over the relative variance that it adds.
    textured_share = np.minimum(state.textured / total, unit)
    shifts_db = _texture_shifts_db(state.shape, power)
    shift_step = textured_share * textured_share * np.float32(_SHIFTS - 1)
    level_db += interpolate_table(shifts_db, shift_step)

    # The table is the same for all references, which are drawn anew for many images.
    low_db, table = _table(replace(settings, percentile=90, reference=1, full_scale_db=None))
    level_step = (level_db - np.float32(low_db)) * np.float32(_STEPS_PER_DB)
    # Relative variance: 1 / looks of what fluctuates, in steps of the table.
    steady_share = np.minimum(state.steady / total, unit)
    looks_share = unit / np.float32(state.looks)
    variance_step = (unit - steady_share * steady_share) * looks_share * np.float32(_VARIANCES - 1)
    return _interpolate_grey(table, level_step, variance_step)


def _interpolate_grey(table: Float32s, level_step: Float32s, variance_step: Float32s) -> Float32s:
    """Grey values between the four nearest of a table as of `_table`; steps count its entries."""
    levels = table.shape[1]
    row = np.minimum(variance_step.astype(np.intp), _VARIANCES - 2)
    column = np.clip(level_step, np.float32(0), np.float32(levels - 1.001))
    entries = table.ravel()
    grey_below = interpolate_table(entries, column, row * levels)
    grey_above = interpolate_table(entries, column, (row + 1) * levels)
    above_share = variance_step - row.astype(np.float32)
    return np.asarray(grey_below + above_share * (grey_above - grey_below), np.float32)


def interpolate_table(
    table: Float32s, place: Float32s, first: npt.NDArray[np.intp] | int = 0
) -> Float32s:
    """Values of a table at fractional places, linear in between; first: where it begins."""
    step = np.minimum(place.astype(np.intp), len(table) - 2)
    low = np.take(table, first + step)
    high = np.take(table, first + step + 1)
    return np.asarray(low + (place - step.astype(np.float32)) * (high - low), np.float32)


@lru_cache(maxsize=32)
def _table(settings: TransferSettings) -> tuple[float, Float32s]:
    """Lowest level, dB; (variances, levels) expected grey values of gamma-distributed intensities.

    variances: Var[I] / E[I]^2, 0 to 1.  Rician intensities are approximated by a gamma distribution
    of equal variance (Nakagami).
    """
    from scipy import special  # slow to import

    is_log = settings.kind in ("log", "soft_log")
    low_db = -settings.dynamic_range_db - _BEYOND_DB if is_log else _DARKEST_DB
    count = round((_BEYOND_DB - low_db) * _STEPS_PER_DB) + 1
    mean = 10 ** ((low_db + np.arange(count) / _STEPS_PER_DB) / 10)
    chance = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    rows = [transfer.grey(np.sqrt(mean), 1.0, settings)]
    for variance in np.linspace(0, 1, _VARIANCES)[1:]:
        quantiles = special.gammaincinv(1 / variance, chance) * variance
        shown = transfer.grey(np.sqrt(mean[:, None] * quantiles), 1.0, settings)
        rows.append(shown.mean(axis=1, dtype=np.float64).astype(np.float32))
    return low_db, np.ascontiguousarray(rows, np.float32)


@lru_cache(maxsize=64)
def _texture_shifts_db(shape: float, power: float) -> Float32s:
    """(33,) 10 / p log10 E[tau^p] of the displayed power p (10 E[log10 tau]), from none to all."""
    from scipy import special  # slow to import

    if not np.isfinite(shape):
        return np.zeros(_SHIFTS, np.float32)
    nu = shape / np.linspace(0, 1, _SHIFTS)[1:]
    if power:
        nepers = (special.gammaln(nu + power) - special.gammaln(nu)) / power - np.log(nu)
    else:
        nepers = special.digamma(nu) - np.log(nu)
    return np.asarray(np.concatenate([[0], 10 / np.log(10) * nepers]), np.float32)
