"""How far two sets of pictures are apart: one function a statistic, and the table of all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from .measure import Measured

Values = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Samples:
    """Two sets of measured pictures, prepared for distances between any of their rows.

    first, second: the sets (the second may be the first itself).  described: their descriptions,
    scaled by mean and standard deviation of the first and bounded.  gram: cubic kernel of all.
    """

    first: Measured
    second: Measured
    described: tuple[Values, Values]
    gram: Values


@dataclass(frozen=True)
class Statistic:
    """One line of the table.

    label, unit: for readers.  what: one sentence that says what is compared.
    distance: (samples, rows of the first set, rows of the second) -> distance, NaN where undefined.
    """

    name: str
    label: str
    unit: str
    what: str
    distance: Callable[[Samples, Rows, Rows], float]


def prepare(first: Measured, second: Measured) -> Samples:
    """The two sets side by side."""
    centre, scale = first.description.mean(axis=0), first.description.std(axis=0)
    one, other = (
        _bounded((part.description - centre) / np.maximum(scale, 1e-6)) for part in (first, second)
    )
    both = np.concatenate([one, other])
    # The kernel of KID: Binkowski et al., "Demystifying MMD GANs", ICLR 2018.
    gram = (both @ both.T / both.shape[1] + 1) ** 3
    return Samples(first, second, (one, other), gram)


def _bounded(values: Values) -> Values:
    """Nearly the same up to two standard deviations, at most four: a black picture is far enough.

    The cubic kernel would make one such picture the whole of the distance.
    """
    return np.asarray(values / np.sqrt(1 + (values / 4) ** 2))


def _histograms(s: Samples, a: Rows, b: Rows, name: str) -> tuple[Values, Values]:
    return getattr(s.first, name)[a].mean(axis=0), getattr(s.second, name)[b].mean(axis=0)


def kolmogorov_smirnov(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Largest difference of the cumulative distributions, 0 to 1."""
    p, q = _histograms(s, a, b, name)
    return float(np.abs(np.cumsum(p - q)).max())


def earth_mover(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Earth mover's distance in bins."""
    p, q = _histograms(s, a, b, name)
    return float(np.abs(np.cumsum(p - q)).sum())


def jensen_shannon(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Jensen-Shannon distance, 0 to 1: the root of the divergence in bits, which is a metric."""
    from scipy.spatial.distance import jensenshannon

    # NaN where rounding makes the divergence of two equal histograms negative.
    return float(np.nan_to_num(jensenshannon(*_histograms(s, a, b, name), base=2)))


def wasserstein(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Earth mover's distance of the pictures' values of one number, in its unit."""
    from scipy.stats import wasserstein_distance

    one, other = s.first.scalar(name)[a], s.second.scalar(name)[b]
    one, other = one[np.isfinite(one)], other[np.isfinite(other)]
    if not (one.size and other.size):
        return float("nan")
    return float(wasserstein_distance(one, other))


def spectrum(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Root mean square difference of the mean spectra, dB."""
    p, q = _histograms(s, a, b, name)
    return float(np.sqrt(((p - q) ** 2).mean()))


def families(s: Samples, a: Rows, b: Rows) -> float:
    """Mean difference of the families' mean AIC per pixel."""
    one, other = s.first.families[a], s.second.families[b]
    one, other = (x[np.isfinite(x).all(axis=1)] for x in (one, other))
    if not (len(one) and len(other)):
        return float("nan")
    return float(np.abs(one.mean(axis=0) - other.mean(axis=0)).mean())


def kernel_inception(s: Samples, a: Rows, b: Rows) -> float:
    """Root of KID, the unbiased squared maximum mean discrepancy of the descriptions.

    Where KID is negative, as half of the estimates between equal sets are, it is 0.
    """
    shifted = b + len(s.first)

    def within(rows: Rows) -> float:
        block = s.gram[np.ix_(rows, rows)]
        return float((block.sum() - np.trace(block)) / (len(rows) * (len(rows) - 1)))

    between = float(s.gram[np.ix_(a, shifted)].mean())
    return float(np.sqrt(max(within(a) + within(shifted) - 2 * between, 0.0)))


def classifier(s: Samples, a: Rows, b: Rows) -> float:
    """How much better than chance a ridge classifier tells the two sets apart, 0 to 0.5.

    Of the descriptions, five-fold: accuracy on the fold left out less 0.5 (Lopez-Paz & Oquab,
    ICLR 2017, with a linear classifier).
    """
    x = np.concatenate([s.described[0][a], s.described[1][b]])
    y = np.concatenate([np.ones(len(a)), -np.ones(len(b))])
    # Every fifth of each set; rows come in random order.
    fold = np.concatenate([np.arange(len(a)), np.arange(len(b))]) % 5
    right = 0.0
    for left_out in range(5):
        train, test = fold != left_out, fold == left_out
        centre = x[train].mean(axis=0)
        known, asked = x[train] - centre, x[test] - centre
        kernel = known @ known.T
        ridge = kernel + 0.1 * np.trace(kernel) / len(kernel) * np.eye(len(kernel))
        weight = np.linalg.solve(ridge, y[train] - y[train].mean())
        right += float((np.sign(asked @ known.T @ weight) == y[test]).sum())
    return max(right / len(y) - 0.5, 0.0)


def _scalar(name: str, label: str, unit: str, what: str) -> Statistic:
    return Statistic(name, label, unit, what, partial(wasserstein, name=name))


def _pooled(name: str, label: str, unit: str, what: str, function: Callable, of: str) -> Statistic:
    return Statistic(name, label, unit, what, partial(function, name=of))


STATISTICS: tuple[Statistic, ...] = (
    _pooled(
        "amplitude_ks",
        "amplitude, KS",
        "",
        "largest difference of the cumulative grey value distributions",
        kolmogorov_smirnov,
        "amplitude",
    ),
    _pooled(
        "amplitude_emd",
        "amplitude, EMD",
        "grey",
        "earth mover's distance of the grey value distributions, of 255",
        earth_mover,
        "amplitude",
    ),
    _pooled(
        "amplitude_js",
        "amplitude, JS",
        "",
        "Jensen-Shannon distance of the grey value distributions",
        jensen_shannon,
        "amplitude",
    ),
    _scalar("enl", "ENL", "looks", "equivalent number of looks in even windows"),
    _scalar("si", "scintillation index", "", "scintillation index in even windows"),
    _scalar("cv", "CV", "", "standard deviation over mean in even windows"),
    Statistic(
        "families",
        "families, AIC",
        "per px",
        "AIC of Rayleigh, Weibull, gamma, log-normal and K in even windows, against the best",
        families,
    ),
    _scalar("acf_range", "grain along range", "cells", "half-width of the autocorrelation"),
    _scalar("acf_bearing", "grain along bearing", "cells", "half-width of the autocorrelation"),
    _pooled("spectrum_radial", "spectrum, radial", "dB", "mean power spectra", spectrum, "radial"),
    _pooled("spectrum_range", "spectrum, range", "dB", "mean power spectra", spectrum, "along"),
    _pooled(
        "spectrum_bearing", "spectrum, bearing", "dB", "mean power spectra", spectrum, "across"
    ),
    _scalar("spoke", "spoke index", "", "variance of the beams' means over the picture's"),
    _scalar("arc", "arc index", "", "variance of the range rows' means over the picture's"),
    _scalar("slope", "range slope", "dB/window", "level from near to far"),
    _scalar("slope_per_m", "range slope", "dB/m", "level along range"),
    _scalar("highlight", "highlight contrast", "dB", "99.5th percentile over the median"),
    _scalar("shadow", "shadow contrast", "dB", "median over the 1st percentile"),
    _pooled(
        "gradient_js",
        "gradient, JS",
        "",
        "Jensen-Shannon distance of the gradients' magnitudes",
        jensen_shannon,
        "gradient",
    ),
    _pooled(
        "lbp_js",
        "local patterns, JS",
        "",
        "Jensen-Shannon distance of local binary patterns",
        jensen_shannon,
        "pattern",
    ),
    Statistic("kid", "KID, root", "", "kernel distance of fixed random features", kernel_inception),
    Statistic(
        "classifier",
        "classifier",
        "over chance",
        "accuracy of a linear classifier on the same features, less one half",
        classifier,
    ),
)
