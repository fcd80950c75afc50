"""How far two sets of pictures are apart: real against simulated, and real against real."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.seeds import stream
from .measure import Measured

if TYPE_CHECKING:
    import pandas as pd

Values = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]

REAL = "real"
"""What the table calls the distance between two halves of the real pictures."""
SMALLEST = 8
"""Pictures that each side needs: fewer leave no half to compare."""
_BLOCKS = 12


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


def prepare(first: Measured, second: Measured) -> Samples:
    """The two sets side by side."""
    own = first["description"]
    centre, scale = own.mean(axis=0), own.std(axis=0)
    one, other = (
        _bounded((part["description"] - centre) / np.maximum(scale, 1e-6))
        for part in (first, second)
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


def _means(s: Samples, a: Rows, b: Rows, name: str) -> tuple[Values, Values]:
    return s.first[name][a].mean(axis=0), s.second[name][b].mean(axis=0)


def kolmogorov_smirnov(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Largest difference of the cumulative distributions, 0 to 1."""
    p, q = _means(s, a, b, name)
    return float(np.abs(np.cumsum(p - q)).max())


def earth_mover(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Earth mover's distance in bins."""
    p, q = _means(s, a, b, name)
    return float(np.abs(np.cumsum(p - q)).sum())


def jensen_shannon(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Jensen-Shannon distance, 0 to 1: the root of the divergence in bits, which is a metric."""
    from scipy.spatial.distance import jensenshannon

    # NaN where rounding makes the divergence of two equal histograms negative.
    return float(np.nan_to_num(jensenshannon(*_means(s, a, b, name), base=2)))


def wasserstein(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Earth mover's distance of the pictures' values of one number, in its unit."""
    from scipy.stats import wasserstein_distance

    one, other = s.first[name][a], s.second[name][b]
    one, other = one[np.isfinite(one)], other[np.isfinite(other)]
    return float(wasserstein_distance(one, other)) if one.size and other.size else float("nan")


def spectrum(s: Samples, a: Rows, b: Rows, name: str) -> float:
    """Root mean square difference of the mean spectra, dB."""
    p, q = _means(s, a, b, name)
    return float(np.sqrt(((p - q) ** 2).mean()))


def kernel_inception(s: Samples, a: Rows, b: Rows, _: str) -> float:
    """Root of KID, the unbiased squared maximum mean discrepancy of the descriptions.

    Where KID is negative, as half of the estimates between equal sets are, it is 0.
    """
    shifted = b + len(s.described[0])

    def within(rows: Rows) -> float:
        block = s.gram[np.ix_(rows, rows)]
        return float((block.sum() - np.trace(block)) / (len(rows) * (len(rows) - 1)))

    between = float(s.gram[np.ix_(a, shifted)].mean())
    return float(np.sqrt(max(within(a) + within(shifted) - 2 * between, 0.0)))


def classifier(s: Samples, a: Rows, b: Rows, _: str) -> float:
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


@dataclass(frozen=True)
class Statistic:
    """One line of the table; `docs/realism.md` defines each.

    function: (samples, rows of the first set, rows of the second, of) -> distance, NaN where
    undefined.  of: name of the numbers that it compares.
    """

    label: str
    unit: str
    function: Callable[[Samples, Rows, Rows, str], float]
    of: str = ""

    def distance(self, samples: Samples, a: Rows, b: Rows) -> float:
        """Between rows of the two sets; NaN where undefined."""
        return self.function(samples, a, b, self.of)


STATISTICS = {
    "amplitude_ks": Statistic("amplitude, KS", "", kolmogorov_smirnov, "amplitude"),
    "amplitude_emd": Statistic("amplitude, EMD", "grey", earth_mover, "amplitude"),
    "amplitude_js": Statistic("amplitude, JS", "", jensen_shannon, "amplitude"),
    "enl": Statistic("ENL", "looks", wasserstein, "enl"),
    "si": Statistic("scintillation index", "", wasserstein, "si"),
    "cv": Statistic("CV", "", wasserstein, "cv"),
    "acf_range": Statistic("grain along range", "cells", wasserstein, "acf_range"),
    "acf_bearing": Statistic("grain along bearing", "cells", wasserstein, "acf_bearing"),
    "spectrum_radial": Statistic("spectrum, radial", "dB", spectrum, "radial"),
    "spectrum_range": Statistic("spectrum, range", "dB", spectrum, "along"),
    "spectrum_bearing": Statistic("spectrum, bearing", "dB", spectrum, "across"),
    "spoke": Statistic("spoke index", "", wasserstein, "spoke"),
    "arc": Statistic("arc index", "", wasserstein, "arc"),
    "slope": Statistic("range slope", "dB/window", wasserstein, "slope"),
    "slope_per_m": Statistic("range slope", "dB/m", wasserstein, "slope_per_m"),
    "highlight": Statistic("highlight contrast", "dB", wasserstein, "highlight"),
    "shadow": Statistic("shadow contrast", "dB", wasserstein, "shadow"),
    "gradient_js": Statistic("gradient, JS", "", jensen_shannon, "gradient"),
    "lbp_js": Statistic("local patterns, JS", "", jensen_shannon, "pattern"),
    "kid": Statistic("KID, root", "", kernel_inception),
    "classifier": Statistic("classifier", "over chance", classifier),
}
"""Name -> line of the table."""


def compare(
    real: Measured,
    simulated: Mapping[str, Measured],
    *,
    resamples: int,
    halves: str,
    seed: int,
    progress: bool = True,
) -> pd.DataFrame:
    """For each statistic that exists and each set: statistic, against, mean, low, high, ratio.

    against: REAL, or the name of a simulation.  mean, low, high: of the resamples and their 2.5 and
    97.5 percentiles, NaN where some resamples have no figure.  ratio: mean over that of REAL; 1 is
    what a perfect simulation would reach.

    Each resample halves the real pictures anew into A and B, and draws as many of each simulation
    as there are in A: baseline d(A, B), distance d(A, S).  All sets have one size, so a simulation
    that is no different has the baseline as its distance, however few pictures there are.  Half of
    each set without replacement: the spread of the resamples is that of the whole sets' figures
    (McCarthy 1969), which is the interval given.  Raises FactoryError for too few pictures.
    """
    import pandas as pd

    size = half_size(real, simulated)
    sides = {name: prepare(real, one) for name, one in {REAL: real, **simulated}.items()}
    found: dict[tuple[str, str], list[float]] = {
        (s, name): [] for s in STATISTICS for name in sides
    }
    rng = stream(seed, "realism", "halves", halves)
    turns = range(resamples)
    for _ in progress_bar(turns, desc="distances", unit="resample") if progress else turns:
        first, second = _halves(_count(real), size, halves, rng)
        drawn = {name: rng.permutation(_count(one))[:size] for name, one in simulated.items()}
        for (statistic, name), values in found.items():
            rows = second if name == REAL else drawn[name]
            values.append(STATISTICS[statistic].distance(sides[name], first, rows))
    lines = []
    for (statistic, name), values in found.items():
        mean, low, high = np.mean(values), *np.quantile(values, [0.025, 0.975])
        lines.append((statistic, name, float(mean), float(low), float(high)))
    table = pd.DataFrame(lines, columns=["statistic", "against", "mean", "low", "high"])
    baseline = table[table["against"] == REAL].set_index("statistic")["mean"]
    # A baseline of 0 counts as the smallest number there is above it.
    table["ratio"] = table["mean"] / table["statistic"].map(baseline).clip(lower=1e-9)
    return table[table["statistic"].isin(baseline[baseline.notna()].index)]


def half_size(real: Measured, simulated: Mapping[str, Measured]) -> int:
    """Pictures in every half.  Raises FactoryError when a side has too few."""
    counts = {name: _count(measured) for name, measured in {REAL: real, **simulated}.items()}
    for name, count in counts.items():
        if count < SMALLEST:
            raise FactoryError(
                f"{name}: {count} pictures; at least {SMALLEST} are needed to compare "
                "halves (more make narrower intervals)"
            )
    return min(counts.values()) // 2


def _count(measured: Measured) -> int:
    return len(measured["amplitude"])


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


def ratios(table: pd.DataFrame, name: str) -> pd.Series[float]:
    """Statistic -> ratio of a simulation."""
    return table[table["against"] == name].set_index("statistic")["ratio"]


def overall(table: pd.DataFrame, name: str) -> dict[str, float]:
    """The whole table in three numbers.

    geometric_mean_ratio: geometric mean of max(ratio, 1).  within_2: part of the statistics with a
    ratio up to 2.  median_ratio.
    """
    known = ratios(table, name).dropna()
    return {
        "geometric_mean_ratio": float(np.exp(np.log(known.clip(lower=1)).mean())),
        "median_ratio": float(known.median()),
        "within_2": float((known <= 2).mean()),
    }
