"""`simnfnd evaluate realism`: the distances as Markdown, as JSON and as a page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from ...factory.common.array_types import Array, Float64s
from ...factory.common.errors import FactoryError
from ...factory.common.files import real_path
from ...factory.common.progress import Bar
from ...factory.common.seeds import stream
from ...factory.dataset.fan_geometry import FanGeometry
from ...factory.dataset.reader import Split
from ..judging.pairs import JudgedPair, items_of
from ..judging.recorded import GEOMETRY_FILE, RecordedImage, open_real
from ..judging.settings import Grid, RealismSettings
from ..metrics.features import FEATURES, features_of
from ..metrics.measure import Grey
from ..metrics.statistics import evenly
from ..report.document import ComparedImages, Section, publish
from ..report.tables import as_table, plain, written

if TYPE_CHECKING:
    import pandas as pd

_RULE = (
    "Kolmogorov-Smirnov distances of the images' features, 0 to 1. `real` is that of two "
    "halves of the real images, which a perfect simulation would reach. Overall: geometric "
    "mean of the earth mover's distances over those of the halves, each at least 1."
)


def evaluate(settings: RealismSettings) -> None:
    """Measure, compare, print the table and write the report.  Raises FactoryError."""
    real = real_images(settings.real).at_most(settings.limit)
    collections = {REAL: real, **_simulations(settings)}
    measured = {
        name: described(collection, settings.grid) for name, collection in collections.items()
    }
    table, overall = distances(measured.pop(REAL), measured, settings.seed)

    rows = [
        [FEATURES[str(name)], *(written(value, 2) for value in row)]
        for name, row in zip(table.index, table.to_numpy(), strict=True)
    ]
    rows.append(["overall", "1", *(f"{value:.1f}" for value in overall.values())])
    shown = as_table(["real against", *table], rows)
    counts = {name: len(collection.sources) for name, collection in collections.items()}
    notes = [note for collection in collections.values() for note in collection.notes]
    facts = {
        "schema": "simnfnd-realism/2",
        "real": real.name,
        "images": counts,
        "notes": notes,
        "grid": asdict(settings.grid),
        "seed": settings.seed,
        "overall": overall,
        "distances": {
            name: {key: plain(value) for key, value in column.items()}
            for name, column in table.to_dict().items()
        },
    }

    out = Path(settings.out or Path("outputs", "realism", next(iter(measured))))
    title = f"Simulated against real: {real.name}"
    about = ", ".join(f"{count} images of {name}" for name, count in counts.items())
    sections = [Section("Distances", [shown], [_RULE, *notes], printed=True)]
    examples = _examples_of(collections, settings.grid)
    publish(out, "realism", title, f"{about}.", sections, facts=facts, examples=examples)


def _examples_of(collections: Mapping[str, Collection], grid: Grid) -> list[ComparedImages]:
    """Polar images of all collections beside each other, far range on top."""
    columns = [collection.at_most(SMALLEST).sources for collection in collections.values()]
    examples = []
    for number, sources in enumerate(zip(*columns, strict=False), start=1):
        images = {}
        for name, source in zip(collections, sources, strict=True):
            image, geometry = source.read()
            assert geometry is not None
            images[name] = to_polar(image, geometry, grid)[::-1]
        examples.append(ComparedImages(f"images {number}", images))
    return examples


def _simulations(settings: RealismSettings) -> dict[str, Collection]:
    """Name -> images; the second folder of a name goes by its path."""
    collections: dict[str, Collection] = {}
    for folder in settings.sim:
        path = Path(folder).expanduser()
        if (path / GEOMETRY_FILE).is_file():
            opened = real_images(path)
        else:
            opened = open_dataset(path, "all")
        name = opened.name if opened.name not in (REAL, *collections) else folder
        collections[name] = opened.at_most(settings.limit)
    return collections


REAL = "real"
"""What tables call the distance between two halves of the real images."""
SMALLEST = 8
"""Images that each side needs: fewer leave no half to compare."""
RESAMPLES = 20
_FAR = 1e3


def described(collection: Collection, grid: Grid) -> pd.DataFrame:
    """(images x features) of a collection.  Raises FactoryError when an image is unreadable."""
    import pandas as pd

    rows = []
    with Bar(total=len(collection.sources), unit="image", desc=collection.name) as bar:
        for source in collection.sources:
            image, geometry = source.read()
            assert geometry is not None
            rows.append(features_of(to_polar(image, geometry, grid), geometry.range_span_m))
            bar.update()
    return pd.DataFrame(rows)


def distances(
    real: pd.DataFrame, simulated: Mapping[str, pd.DataFrame], seed: int
) -> tuple[pd.DataFrame, dict[str, float]]:
    """(features x sets) Kolmogorov-Smirnov distances; and set -> the overall number.

    Sets: REAL, between two halves of the real images, and each simulation.  Features that the
    real images lack are left out.  The overall number is the geometric mean over the features of
    max(1, earth mover's distance over that of the halves): it goes on where a Kolmogorov-Smirnov
    distance has reached 1, so that a search has somewhere to go.  1 is a perfect simulation.
    Means over RESAMPLES draws.  Raises FactoryError for too few images.
    """
    import pandas as pd

    sets = {REAL: real, **simulated}
    for name, features_of_set in sets.items():
        if len(features_of_set) < SMALLEST:
            raise FactoryError(
                f"{name}: {len(features_of_set)} images; at least {SMALLEST} are needed to "
                "compare halves"
            )
    size = min(map(len, sets.values())) // 2
    # Ranges in metres are not always known.
    metric = all(features_of_set["slope_per_m"].notna().any() for features_of_set in sets.values())
    features = [n for n in FEATURES if real[n].notna().any() and (metric or n != "slope_per_m")]
    rng = stream(seed, "realism", "halves")
    sums = {name: np.zeros((2, len(features))) for name in sets}
    for _ in range(RESAMPLES):
        order = rng.permutation(len(real))
        first = real.iloc[order[:size]]
        drawn = {
            name: features_of_set.iloc[rng.permutation(len(features_of_set))[:size]]
            for name, features_of_set in simulated.items()
        }
        for name, second in {REAL: real.iloc[order[size : 2 * size]], **drawn}.items():
            sums[name] += _feature_distances(first, second, features)
    table = pd.DataFrame(
        {name: sums_of_set[0] / RESAMPLES for name, sums_of_set in sums.items()}, features
    )
    overall = {}
    for name in simulated:
        ratios = sums[name][1] / np.maximum(sums[REAL][1], 1e-9)
        # A feature that the simulation lacks counts as far away.
        bounded = np.nan_to_num(ratios, nan=_FAR).clip(1, _FAR)
        overall[name] = float(np.exp(np.log(bounded).mean()))
    return table, overall


def _feature_distances(
    first: pd.DataFrame, second: pd.DataFrame, features: Sequence[str]
) -> Float64s:
    """(2, features) Kolmogorov-Smirnov and earth mover's distances; NaN where a set lacks one."""
    from scipy.stats import ks_2samp, wasserstein_distance

    distances_of_features = np.full((2, len(features)), np.nan)
    for number, feature in enumerate(features):
        pair = [part[feature].dropna().to_numpy(float) for part in (first, second)]
        if all(map(len, pair)):
            statistic = ks_2samp(*pair, method="asymp").statistic
            distances_of_features[:, number] = statistic, wasserstein_distance(*pair)
    return distances_of_features


# Images with data in less of the sector than this say too little along the bearing.
_LEAST_SECTOR_SHARE = 0.25


@dataclass(frozen=True)
class Collection:
    """Images that belong together, each with its geometry.

    name: what tables call them.  notes: for the report.
    """

    name: str
    sources: Sequence[JudgedPair | RecordedImage]
    notes: tuple[str, ...] = ()

    def at_most(self, limit: int | None) -> Collection:
        """The collection, of which `limit` evenly spread images are kept where it has more."""
        return Collection(self.name, evenly(self.sources, limit), self.notes)


def to_polar(image: Array, geometry: FanGeometry, grid: Grid) -> Grey:
    """(H, W) grey values -> (range_bins, beams with data) float32, near range and left first.

    Inverse mapping: each cell of the grid looks up its place in the image, bilinear.  Only whole
    cells within `geometry.data_fraction` are kept.
    """
    columns, rows = _lookup(geometry, grid, image.shape[:2])
    grey = np.ascontiguousarray(image, dtype=np.float32)
    return np.asarray(
        cv2.remap(grey, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )


@lru_cache(maxsize=16)
def _lookup(geometry: FanGeometry, grid: Grid, shape: tuple[int, int]) -> tuple[Grey, Grey]:
    """Column and row in the image of each cell of the grid."""
    start, end = geometry.data_fraction
    first = math.ceil(round(start * grid.beams, 6))
    last = max(math.floor(round(end * grid.beams, 6)), first + 1)
    along = (np.arange(grid.range_bins) + 0.5)[:, None] / grid.range_bins
    across = (np.arange(first, last) + 0.5)[None, :] / grid.beams
    range_fraction = geometry.near_fraction + along * (1 - geometry.near_fraction)
    azimuth_rad = (across - 0.5) * geometry.sector_rad
    rows, columns = np.broadcast_arrays(
        *geometry.with_size(*shape).pixels(range_fraction, azimuth_rad)
    )
    return np.ascontiguousarray(columns, np.float32), np.ascontiguousarray(rows, np.float32)


def real_images(folder: str | Path) -> Collection:
    """The real images at a path; see `open_real`."""
    shots, notes = open_real(folder)
    return Collection(real_path(Path(folder).expanduser()).name, shots, notes)


def open_dataset(folder: str | Path, split: Split) -> Collection:
    """The images of a dataset folder.  Raises FactoryError when there are none to compare."""
    root = Path(folder).expanduser()
    items = items_of(root, split)
    sources = []
    for item in items:
        geometry = item.geometry()
        if geometry is None:
            raise FactoryError(f"sim={root}: {item.shard} does not say how its images are laid out")
        first, last = geometry.data_fraction
        if last - first >= _LEAST_SECTOR_SHARE:
            sources.append(item)
    narrow = f"the camera saw less than {_LEAST_SECTOR_SHARE:.0%} of the sector"
    if not sources:
        raise FactoryError(f"sim={root}: {narrow} in every image; use a narrower sonar.hfov_deg")
    notes = [f"{len(sources)} noisy images of {root.name}"]
    if left := len(items) - len(sources):
        notes.append(f"{left} left out: {narrow}")
    return Collection(real_path(root).name, sources, tuple(notes))
