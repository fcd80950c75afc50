"""Speckle in even windows: ENL, CV, scintillation index and which family the grey values follow."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import special

Values = npt.NDArray[np.float64]

SIDE = 16
"""Edge of a window in cells of the polar grid."""
_PART = 4
_SHARE = 0.2
_DARKEST = 0.02
FAMILIES = ("rayleigh", "weibull", "gamma", "lognormal", "k")
_PARAMETERS = {"rayleigh": 1, "weibull": 2, "gamma": 2, "lognormal": 2, "k": 2}
# Grey values are steps of 1/255: zero stands for anything below half a step.
_SMALLEST = 0.5 / 255


def even_windows(polar: npt.NDArray[np.floating]) -> Values:
    """(N, SIDE * SIDE) grey values of the evenest fifth of the windows; (0, ...) if all is black.

    Windows lie on a grid without overlap; those with a mean below 2 % of full scale (clipped to
    black) do not count, nor do constant ones.  A window is even when the means of its 4x4 parts
    differ little for the scatter within the parts: that asks for a flat bottom, and not for weak
    speckle, as the lowest std/mean would.
    """
    rows, columns = (size // SIDE for size in polar.shape)
    cut = np.asarray(polar[: rows * SIDE, : columns * SIDE], dtype=np.float64)
    blocks = cut.reshape(rows, SIDE, columns, SIDE).transpose(0, 2, 1, 3).reshape(-1, SIDE, SIDE)
    parts = blocks.reshape(-1, SIDE // _PART, _PART, SIDE // _PART, _PART).mean(axis=(2, 4))
    mean = blocks.mean(axis=(1, 2))
    between = parts.var(axis=(1, 2))
    within = blocks.var(axis=(1, 2)) - between
    usable = np.flatnonzero((mean >= _DARKEST) & (within > 1e-9))
    unevenness = between[usable] / within[usable]
    count = max(1, round(_SHARE * usable.size)) if usable.size else 0
    chosen = usable[np.argsort(unevenness, kind="stable")[:count]]
    return np.asarray(blocks[chosen].reshape(count, SIDE * SIDE))


def speckle(windows: Values) -> tuple[float, float, float]:
    """Medians over the windows of ENL, scintillation index and CV; NaN without windows.

    Grey values g are taken as amplitude: CV = std(g) / mean(g), ENL = 1 / CV^2 and
    SI = <g^4> / <g^2>^2 - 1.  Rayleigh amplitude has ENL 3.66, SI 1 and CV 0.523; what a display
    makes of it (compression) has other values, the same on both sides of the comparison.
    """
    if not len(windows):
        return float("nan"), float("nan"), float("nan")
    cv = windows.std(axis=1) / windows.mean(axis=1)
    power = windows**2
    index = (power**2).mean(axis=1) / power.mean(axis=1) ** 2 - 1
    median_cv = float(np.median(cv))
    enl = float(np.median(1 / np.maximum(cv, 1e-6) ** 2))
    return enl, float(np.median(index)), median_cv


def family_costs(windows: Values) -> Values:
    """(5,) AIC per pixel of each of `FAMILIES`, less the least; NaN without windows.

    Fitted to grey values over their window's mean, pooled: Rayleigh, Weibull, gamma and log-normal
    by maximum likelihood, K by the method of moments on the intensity (SI = 1 + 2 / nu).  0 marks
    the best family; d means its likelihood is exp(d / 2) times that of the other, for each pixel.
    """
    if not len(windows):
        return np.full(len(FAMILIES), np.nan)
    scaled = np.maximum(windows, _SMALLEST) / windows.mean(axis=1, keepdims=True)
    x = scaled.ravel()
    costs = [2 * _PARAMETERS[name] / x.size - 2 * _mean_log_density(name, x) for name in FAMILIES]
    return np.asarray(np.asarray(costs) - min(costs))


def _mean_log_density(name: str, x: Values) -> float:
    log = np.log(x)
    if name == "rayleigh":
        power = float((x**2).mean()) / 2
        return float((log - np.log(power) - x**2 / (2 * power)).mean())
    if name == "weibull":
        k = _weibull_shape(x, log)
        scale = float((x**k).mean()) ** (1 / k)
        z = x / scale
        return float((np.log(k / scale) + (k - 1) * np.log(z) - z**k).mean())
    if name == "gamma":
        k = _gamma_shape(float(np.log(x.mean()) - log.mean()))
        scale = float(x.mean()) / k
        logs = (k - 1) * log - x / scale - k * np.log(scale) - special.gammaln(k)
        return float(logs.mean())
    if name == "lognormal":
        variance = max(float(log.var()), 1e-12)
        return float(-(log.mean() + 0.5 * np.log(2 * np.pi * variance) + 0.5))
    return float(_log_k(x, log).mean())


def _weibull_shape(x: Values, log: Values) -> float:
    """Newton's method on the likelihood equation, from the log-moments' start."""
    k = 1.2 / max(float(log.std()), 1e-3)
    for _ in range(30):
        power = x**k
        total = power.sum()
        first, second = (power * log).sum() / total, (power * log**2).sum() / total
        value = first - 1 / k - log.mean()
        step = value / (second - first**2 + 1 / k**2)
        k = max(k - step, k / 2)
        if abs(step) < 1e-6 * k:
            break
    return float(k)


def _gamma_shape(s: float) -> float:
    """Minka's generalised Newton steps; s = log of the mean - mean of the log."""
    s = max(s, 1e-9)
    k = (3 - s + np.sqrt((s - 3) ** 2 + 24 * s)) / (12 * s)
    for _ in range(5):
        slope = 1 / k - special.polygamma(1, k)
        k = 1 / (1 / k + (np.log(k) - special.digamma(k) - s) / (k**2 * slope))
    return float(k)


def _log_k(x: Values, log: Values) -> Values:
    """Log density of the K distribution of an amplitude.

    With intensity mean m: p(x) = 4 / Gamma(nu) (nu / m)^((nu + 1) / 2) x^nu K_{nu-1}(2 x
    sqrt(nu / m)) (Abraham & Lyons 2002).  Where the intensity scatters less than Rayleigh's, nu
    is at its limit and K is Rayleigh.
    """
    power = x**2
    m = float(power.mean())
    excess = float((power**2).mean()) / m**2 - 2
    nu = float(np.clip(2 / excess, 0.1, 60)) if excess > 2 / 60 else 60.0
    z = 2 * x * np.sqrt(nu / m)
    bessel = np.log(np.maximum(special.kve(nu - 1, z), 1e-300)) - z
    head = np.log(4) - special.gammaln(nu) + (nu + 1) / 2 * np.log(nu / m)
    return np.asarray(head + nu * log + bessel)
