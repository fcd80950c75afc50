"""How far two sets of pictures are apart: real against simulated, and real against real."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.seeds import stream
from .measure import Measured

Values = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

_BLOCKS = 12
SMALLEST = 8
"""Pictures that each side needs: fewer leave no half to compare."""


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
    function: (samples, rows of the first set, rows of the second, name of the numbers) -> distance,
    NaN where undefined.  of: that name, where there are several.
    """

    name: str
    label: str
    unit: str
    what: str
    function: Callable[[Samples, Rows, Rows, str], float]
    of: str = ""

    def distance(self, samples: Samples, a: Rows, b: Rows) -> float:
        """Between rows of the two sets; NaN where undefined."""
        return self.function(samples, a, b, self.of)


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


def families(s: Samples, a: Rows, b: Rows, _: str = "") -> float:
    """Mean difference of the families' mean AIC per pixel."""
    one, other = s.first.families[a], s.second.families[b]
    one, other = (x[np.isfinite(x).all(axis=1)] for x in (one, other))
    if not (len(one) and len(other)):
        return float("nan")
    return float(np.abs(one.mean(axis=0) - other.mean(axis=0)).mean())


def kernel_inception(s: Samples, a: Rows, b: Rows, _: str = "") -> float:
    """Root of KID, the unbiased squared maximum mean discrepancy of the descriptions.

    Where KID is negative, as half of the estimates between equal sets are, it is 0.
    """
    shifted = b + len(s.first)

    def within(rows: Rows) -> float:
        block = s.gram[np.ix_(rows, rows)]
        return float((block.sum() - np.trace(block)) / (len(rows) * (len(rows) - 1)))

    between = float(s.gram[np.ix_(a, shifted)].mean())
    return float(np.sqrt(max(within(a) + within(shifted) - 2 * between, 0.0)))


def classifier(s: Samples, a: Rows, b: Rows, _: str = "") -> float:
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


_EVEN, _ACF = "in even windows", "half-width of the autocorrelation"
_SPECTRA = "mean power spectra"
STATISTICS = tuple(
    Statistic(*line)
    for line in (
        ("amplitude_ks", "amplitude, KS", "",
         "largest difference of the cumulative grey value distributions",
         kolmogorov_smirnov, "amplitude"),
        ("amplitude_emd", "amplitude, EMD", "grey",
         "earth mover's distance of the grey value distributions, of 255",
         earth_mover, "amplitude"),
        ("amplitude_js", "amplitude, JS", "",
         "Jensen-Shannon distance of the grey value distributions", jensen_shannon, "amplitude"),
        ("enl", "ENL", "looks", f"equivalent number of looks {_EVEN}", wasserstein, "enl"),
        ("si", "scintillation index", "", f"scintillation index {_EVEN}", wasserstein, "si"),
        ("cv", "CV", "", f"standard deviation over mean {_EVEN}", wasserstein, "cv"),
        ("families", "families, AIC", "per px",
         f"AIC of Rayleigh, Weibull, gamma, log-normal and K {_EVEN}, against the best",
         families),
        ("acf_range", "grain along range", "cells", _ACF, wasserstein, "acf_range"),
        ("acf_bearing", "grain along bearing", "cells", _ACF, wasserstein, "acf_bearing"),
        ("spectrum_radial", "spectrum, radial", "dB", _SPECTRA, spectrum, "radial"),
        ("spectrum_range", "spectrum, range", "dB", _SPECTRA, spectrum, "along"),
        ("spectrum_bearing", "spectrum, bearing", "dB", _SPECTRA, spectrum, "across"),
        ("spoke", "spoke index", "", "variance of the beams' means over the picture's",
         wasserstein, "spoke"),
        ("arc", "arc index", "", "variance of the range rows' means over the picture's",
         wasserstein, "arc"),
        ("slope", "range slope", "dB/window", "level from near to far", wasserstein, "slope"),
        ("slope_per_m", "range slope", "dB/m", "level along range", wasserstein, "slope_per_m"),
        ("highlight", "highlight contrast", "dB", "99.5th percentile over the median",
         wasserstein, "highlight"),
        ("shadow", "shadow contrast", "dB", "median over the 1st percentile",
         wasserstein, "shadow"),
        ("gradient_js", "gradient, JS", "",
         "Jensen-Shannon distance of the gradients' magnitudes", jensen_shannon, "gradient"),
        ("lbp_js", "local patterns, JS", "",
         "Jensen-Shannon distance of local binary patterns", jensen_shannon, "pattern"),
        ("kid", "KID, root", "", "kernel distance of fixed random features",
         kernel_inception),
        ("classifier", "classifier", "over chance",
         "accuracy of a linear classifier on the same features, less one half",
         classifier),
    )
)  # fmt: skip
"""The lines of the table."""


@dataclass(frozen=True)
class Interval:
    """Mean of the resamples and their 2.5 and 97.5 percentiles."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """One statistic.  baseline: real against real.  distance: simulation -> real against it."""

    statistic: Statistic
    baseline: Interval
    distance: Mapping[str, Interval]

    def ratio(self, name: str) -> float:
        """Distance over baseline: 1 is what a perfect simulation would reach.

        A baseline of 0 counts as the smallest number there is above it.
        """
        distance, baseline = self.distance[name].mean, self.baseline.mean
        if not (np.isfinite(distance) and np.isfinite(baseline)):
            return float("nan")
        return distance / max(baseline, 1e-9)


def compare(
    real: Measured,
    simulated: Mapping[str, Measured],
    *,
    resamples: int,
    halves: str,
    seed: int,
    statistics: Sequence[Statistic] = STATISTICS,
    progress: bool = True,
) -> list[Comparison]:
    """Every statistic that exists on both sides.

    Each resample halves the real pictures anew into A and B, and draws as many of each simulation
    as there are in A: baseline d(A, B), distance d(A, S).  All sets have one size, so a simulation
    that is no different has the baseline as its distance, however few pictures there are.  Half of
    each set without replacement: the spread of the resamples is that of the whole sets' figures
    (McCarthy 1969), which is the interval given.  Raises FactoryError for too few pictures.
    """
    size = half_size(real, simulated)
    found = {
        (statistic.name, name): np.empty(resamples)
        for statistic in statistics
        for name in ("", *simulated)
    }
    own = prepare(real, real)
    beside = {name: prepare(real, other) for name, other in simulated.items()}
    rng = stream(seed, "realism", "halves", halves)
    turns = range(resamples)
    for turn in progress_bar(turns, desc="distances", unit="resample") if progress else turns:
        first, second = _halves(len(real), size, halves, rng)
        drawn = {name: rng.permutation(len(m))[:size] for name, m in simulated.items()}
        for statistic in statistics:
            found[statistic.name, ""][turn] = statistic.distance(own, first, second)
            for name, rows in drawn.items():
                distance = statistic.distance(beside[name], first, rows)
                found[statistic.name, name][turn] = distance
    result = []
    for statistic in statistics:
        intervals = {name: _interval(found[statistic.name, name]) for name in ("", *simulated)}
        if any(np.isfinite(interval.mean) for interval in intervals.values()) and np.isfinite(
            intervals[""].mean
        ):
            result.append(Comparison(statistic, intervals.pop(""), intervals))
    return result


def half_size(real: Measured, simulated: Mapping[str, Measured]) -> int:
    """Pictures in every half.  Raises FactoryError when a side has too few."""
    for name, measured in {"real": real, **simulated}.items():
        if len(measured) < SMALLEST:
            raise FactoryError(
                f"{name}: {len(measured)} pictures; at least {SMALLEST} are needed to compare "
                "halves (more make narrower intervals)"
            )
    return min(len(real), *(len(measured) for measured in simulated.values())) // 2


def _halves(count: int, size: int, how: str, rng: np.random.Generator) -> tuple[Rows, Rows]:
    """Rows of two sets of `size` that have none in common."""
    if how == "random":
        order = rng.permutation(count)
        return order[:size], order[size : 2 * size]
    blocks = np.array_split(np.arange(count), min(_BLOCKS, count // 2))
    order = rng.permutation(len(blocks))
    joined = np.concatenate([blocks[number] for number in order])
    # At most one block is cut: that where the halves meet.
    first, second = joined[: count // 2], joined[count // 2 :]
    return rng.permutation(first)[:size], rng.permutation(second)[:size]


def _interval(values: npt.NDArray[np.float64]) -> Interval:
    known = values[np.isfinite(values)]
    # A figure that only some resamples have is no figure.
    if known.size < values.size:
        return Interval(float("nan"), float("nan"), float("nan"))
    low, high = np.quantile(known, [0.025, 0.975])
    return Interval(float(known.mean()), float(low), float(high))


def overall(comparisons: Sequence[Comparison], name: str) -> dict[str, float]:
    """The whole table in three numbers.

    geometric_mean_ratio: geometric mean of max(ratio, 1).  within_2: part of the statistics with a
    ratio up to 2.  median_ratio.
    """
    ratios = np.array([item.ratio(name) for item in comparisons])
    ratios = ratios[np.isfinite(ratios)]
    if not ratios.size:
        return dict.fromkeys(("geometric_mean_ratio", "median_ratio", "within_2"), float("nan"))
    return {
        "geometric_mean_ratio": float(np.exp(np.log(np.maximum(ratios, 1)).mean())),
        "median_ratio": float(np.median(ratios)),
        "within_2": float((ratios <= 2).mean()),
    }
